"""Robots at work without ports, processes or time: simulated microcontrollers, real bodies, real peers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from agent.driver import Driver, NoDriver
from agent.kinematics import ORION_CHASSIS
from agent.microcontroller import Microcontroller
from agent.own_session import OwnSession
from agent.page_tracks import Tracks
from agent.senses import NO_NOISE, Noise
from agent.serial_body import SerialBody
from agent.simulator import Simulator
from agent.team_mates import NoMates, TeamMates
from agent.world import World
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import Pose, QuantisedPose
from mapping.raster import raster
from mapping.scan import Scans
from mapping.sensor import Sensor, orion
from swarm.messages import Hello, Update
from swarm.peer import Listener, Peer
from swarm.session import Descriptor, Rules
from transport.mcu_frames import Drive

PERIOD_MS = 100


class FakeLink:
    """A line that loses nothing and takes no time; it keeps what it was told."""

    def __init__(self) -> None:
        self.inbox: list = []
        self.drives: list[Drive] = []
        self.closed = False

    def receive(self, timeout: float = 0.0) -> list:
        events, self.inbox = self.inbox, []
        return events

    def drive(self, left_mm_s: int, right_mm_s: int, *, valid_ms: int = 300, answers: int | None = None) -> bool:
        self.drives.append(Drive(answers or 0, left_mm_s, right_mm_s, valid_ms))
        return True

    def close(self) -> None:
        self.closed = True


class Robot:
    """One robot of the arena: its microcontroller, its body, its peer, its session."""

    def __init__(
        self,
        index: int,
        start: Pose | None,
        sensor: Sensor,
        rules: Rules,
        make_driver: Callable[[Robot], Driver],
        *,
        masks: bool,
    ) -> None:
        self.name = f"r{index + 1}"
        self.index = index
        self.sensor = sensor
        self.rules = rules
        self.link = FakeLink()
        self.mcu = Microcontroller(index, sensor, ORION_CHASSIS, PERIOD_MS)
        self.mates = TeamMates(self.name, sensor)
        self.peer = Peer(
            Hello(Hello.ROBOT, self.name.encode(), b"test"),
            rules,
            seed=self.name.encode(),
            mtu=60_000,
            now=0.0,
            listener=self.mates,
        )
        self.driver = make_driver(self)
        self.body = SerialBody(
            self.link,
            self.mcu.hello,
            driver=self.driver,
            max_range=10.0,
            unix_ms=lambda: 0,
            monotonic=lambda: 0.0,
        )
        self.own = OwnSession(
            self.peer,
            self.name,
            self.body,
            mates=self.mates if masks else NoMates(),
            start=None if start is None else QuantisedPose.of(start),
            publish="auto",
            kernel=raster,
        )

    @property
    def cells(self) -> dict:
        return self.own.writer.replica.state.cells


class Arena:
    """Walls, robots and their truth; everybody hears what the others say ``delay`` steps later.

    Robots stand at ``starts``, and start out believing to stand at ``believed``, or not knowing.
    """

    def __init__(
        self,
        walls: Sequence[Sequence[float]],
        starts: Sequence[Pose],
        make_driver: Callable[[Robot], Driver] = lambda robot: NoDriver(),
        *,
        sensor: Sensor | None = None,
        noise: Noise = NO_NOISE,
        masks: bool = True,
        delay: int = 0,
        cell_mm: int = 20,
        believed: Sequence[Pose | None] | None = None,
    ) -> None:
        sensor = orion() if sensor is None else sensor
        world = World("test", np.array(walls, float), tuple(starts), tuple(np.zeros((0, 2)) for _ in starts))
        self.world = world
        self.simulator = Simulator(world, 1, len(starts), sensor, noise=noise, period=PERIOD_MS / 1000)
        rules = Rules(Lattice(cell_mm), EvidenceModel())
        self.robots = [
            Robot(k, start, sensor, rules, make_driver, masks=masks)
            for k, start in enumerate(starts if believed is None else believed)
        ]
        self._delay = delay
        self._under_way: list[list[tuple[Robot, Robot, bytes]]] = [[] for _ in range(delay)]

    @property
    def now(self) -> float:
        return self.simulator.now_ms / 1000

    def step(self) -> None:
        """One sample of every robot, and all that follows from it."""
        readings = self.simulator.sense()
        for robot in self.robots:
            robot.link.inbox.append(robot.mcu.sample(readings))
            robot.link.drives.clear()
            robot.own.journal.append(robot.body.read(self.now))
            for drive in robot.link.drives:
                robot.mcu.hear(drive, self.simulator.now_ms)
        self.talk()
        for _ in range(PERIOD_MS // 10):
            now_ms = self.simulator.now_ms
            self.simulator.targets[:] = [robot.mcu.wheels(now_ms) for robot in self.robots]
            self.simulator.advance(now_ms + 10)

    def talk(self) -> None:
        """Everybody says what there is to say, and hears what was said ``delay`` steps ago."""
        said = []
        for robot in self.robots:
            robot.own.publish()
            out = robot.peer.poll(self.now)
            robot.own.correct(self.now)
            out += robot.peer.poll(self.now)
            said += [(robot, other, it.payload) for it in out for other in self._addressed(robot, it.to)]
        self._under_way.append(said)
        for sender, receiver, payload in self._under_way.pop(0):
            receiver.peer.receive(sender.name, payload, self.now)

    def _addressed(self, robot: Robot, to: str | None) -> list[Robot]:
        return [other for other in self.robots if other is not robot and to in {None, other.name}]

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        end = self.now + seconds
        while self.now < end and not until():
            self.step()

    def settle(self) -> None:
        """Let what is under way arrive, with everybody standing still."""
        for _ in range(self._delay + 20):
            self.simulator.now_ms += PERIOD_MS
            self.talk()


@pytest.fixture(scope="session")
def arena() -> type[Arena]:
    """Where robots meet."""
    return Arena


@pytest.fixture
def link() -> FakeLink:
    """A line."""
    return FakeLink()


# --- what an observer of robots knows, for its page


class Watched:
    """An observer and robots that it hears, without any network.

    Attributes:
        observer: the peer whose page it is.
        tracks: what its updates told.
        heard: payload bytes from each robot.
        now: seconds.
    """

    RULES = Rules(Lattice(50), EvidenceModel())

    def __init__(self) -> None:
        self.tracks = Tracks()
        self.heard: Counter[str] = Counter()
        self.now = 100.0
        self.listeners: list[Listener] = [self.tracks]
        self.observer = self._peer(Hello.OBSERVER, "observer", self._listen)
        self._robots: dict[str, Peer] = {}

    def _peer(self, role: int, name: str, listener: Listener = lambda descriptor, update: None) -> Peer:
        hello = Hello(role, name.encode(), b"test")
        return Peer(hello, self.RULES, seed=name.encode(), mtu=32768, now=self.now, listener=listener)

    def _listen(self, descriptor: Descriptor, update: Update) -> None:
        for listener in self.listeners:
            listener(descriptor, update)

    def robot(self, name: str, start: QuantisedPose | None = QuantisedPose(0, 0, 0)) -> bytes:  # noqa: B008 - a constant
        """A robot comes; gives its session's id."""
        session = (name.encode() * 8)[:8]
        self._robots[name] = self._peer(Hello.ROBOT, name)
        self._robots[name].open_session(Descriptor(name, session, self.RULES, orion(), start))
        return session

    def sense(self, name: str, scans: Scans) -> None:
        """A robot senses and publishes, and is heard."""
        self._robots[name].writer.sense(scans)
        self.talk()

    def talk(self, seconds: float = 1.0) -> None:
        """Everybody says what is to be said."""
        for _ in range(10):
            self.now += seconds / 10
            for name, robot in self._robots.items():
                for out in robot.poll(self.now):
                    if out.to in {None, "observer"}:
                        self.heard[name] += len(out.payload)
                        self.observer.receive(name, out.payload, self.now)
            for out in self.observer.poll(self.now):
                for name, robot in self._robots.items():
                    if out.to in {None, name}:
                        robot.receive("observer", out.payload, self.now)


@pytest.fixture
def watched() -> Watched:
    """An observer."""
    return Watched()


def straight_scans(count: int, *, stride_mm: int = 30, y_mm: int = 0, first_ms: int = 0) -> Scans:
    """A robot drives along x and sees walls on all sides at half a metre."""
    poses = np.zeros((count, 3), np.int32)
    poses[:, 0], poses[:, 1] = np.arange(count) * stride_mm, y_mm
    return Scans(first_ms + np.arange(count, dtype=np.int64) * 100, poses, np.full((count, 5), 500, np.uint16))


@pytest.fixture
def straight() -> Callable[..., Scans]:
    """``straight_scans``."""
    return straight_scans
