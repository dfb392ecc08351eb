"""Robots at work without ports, processes or time: simulated microcontrollers, real bodies, real peers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from agent.driver import Driver, NoDriver
from agent.kinematics import ORION_CHASSIS
from agent.microcontroller import Microcontroller
from agent.senses import NO_NOISE, Noise
from agent.serial_body import NoMask, SerialBody
from agent.simulator import Simulator
from agent.team_mates import TeamMates
from agent.world import World
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import Pose, QuantisedPose
from mapping.sensor import Sensor, orion
from swarm.messages import Hello
from swarm.peer import Peer
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
    """One robot of the arena: its microcontroller, its body, its peer."""

    def __init__(
        self,
        index: int,
        start: Pose,
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
        self.mates = TeamMates(self.name, sensor, rules.model, rules.lattice)
        self.peer = Peer(
            Hello(Hello.ROBOT, self.name.encode(), b"test"),
            rules,
            seed=self.name.encode(),
            mtu=60_000,
            now=0.0,
            listener=self.mates if masks else lambda descriptor, update: None,
        )
        pose = QuantisedPose.of(start)
        self.writer = self.peer.open_session(Descriptor(self.name, bytes([index] * 8), rules, sensor, pose))
        self.driver = make_driver(self)
        self.body = SerialBody(
            self.link,
            self.mcu.hello,
            pose,
            driver=self.driver,
            mask=self.mates if masks else NoMask(),
            max_range=10.0,
            unix_ms=lambda: 0,
            monotonic=lambda: 0.0,
        )

    @property
    def cells(self) -> dict:
        return self.writer.replica.state.cells

    def correct(self, now: float) -> None:
        for update, change in self.writer.correct(self.mates.corrections(self.cells)):
            self.peer._applied(self.writer.replica, update, change, now)
            self.peer._say(update)


class Arena:
    """Walls, robots and their truth; everybody hears what the others say ``delay`` steps later."""

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
    ) -> None:
        sensor = orion() if sensor is None else sensor
        world = World("test", np.array(walls, float), tuple(starts), tuple(np.zeros((0, 2)) for _ in starts))
        self.world = world
        self.simulator = Simulator(world, 1, len(starts), sensor, noise=noise, period=PERIOD_MS / 1000)
        rules = Rules(Lattice(cell_mm), EvidenceModel())
        self.robots = [Robot(k, start, sensor, rules, make_driver, masks=masks) for k, start in enumerate(starts)]
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
            robot.writer.sense(robot.body.read(self.now))
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
            out = robot.peer.poll(self.now)
            if not robot.writer.waiting:
                robot.correct(self.now)
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
