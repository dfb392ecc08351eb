"""A swarm of nodes under fake time: the code that ships, on the in-process network, watched by the laws.

What happens to it is a list of events (``tests.scenarios.events``); everything is decided by the schedule alone.
"""

from __future__ import annotations

import hashlib
import math
import random
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import partial
from itertools import count, permutations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from agent.keeper import Keeper, NoKeeper
from agent.node import Node
from agent.own_session import OwnSession
from agent.readings import Readings
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import Scans
from mapping.sensor import Beam, Sensor
from swarm.messages import Control, Hello, Update
from swarm.peer import Peer
from swarm.radio import PROFILES
from swarm.session import Descriptor, Rules, SessionId
from swarm.writer import Publish
from tests.scenarios import oracle
from tests.scenarios.damage import Damage, damaged, is_a_lie, kill, mutated
from tests.scenarios.laws import Broken, Chronicle, Laws, conserved
from tests.scenarios.oracle import Entry, Start
from transport.bus import Answers, Message
from transport.bus import Event as Heard
from transport.in_process import InProcessBus, Link, Network

if TYPE_CHECKING:
    from tests.scenarios.schedule import Schedule

SENSOR = Sensor(tuple(Beam(0, 0, bearing) for bearing in oracle.BEARINGS), oracle.MAX_RANGE_MM)
RULES = Rules(Lattice(oracle.CELL_MM), EvidenceModel(oracle.OCCUPIED, oracle.FREE))
TICK = 0.01
"""Seconds that a peer is busy before it listens again."""
STRANGER = "mallory"
REMEMBERED = 300
"""How many of the last payloads a hostile peer can say again."""


@dataclass(frozen=True)
class Role:
    """What a process is: an observer, or a robot with an id, a start pose (or none) and a form in which it publishes.

    With ``remembers`` it keeps its state in a file.
    """

    robot: str | None = None
    start: Start | None = oracle.ORIGIN
    publish: Publish = "auto"
    remembers: bool = False


class Eyes:
    """A robot's body: it sees what the schedule says, when it says so."""

    sensor = SENSOR
    patience = 0.02
    status = ""
    progress = (0, 0)
    done = False

    def __init__(self, arena: Arena) -> None:
        self._arena = arena
        self.coming: list[tuple[float, int]] = []
        self.journal: list[Entry] = []

    @property
    def wake_at(self) -> float:
        return self.coming[0][0] if self.coming else math.inf

    def place(self, start: QuantisedPose) -> None:
        """It sees the same wherever it is."""

    def read(self, until: float) -> Readings:
        now = self._arena.network.now
        seen = [number for at, number in self.coming if at <= now]
        if not seen:
            return _NOTHING
        del self.coming[: len(seen)]
        first = max(round(now * 1000), self.journal[-1].stamp_ms + 1 if self.journal else 0)
        self.journal += [Entry(first + k, number) for k, number in enumerate(seen)]
        sightings = [oracle.SIGHTINGS[number] for number in seen]
        poses = [(s.x_mm / 1000, s.y_mm / 1000, s.yaw_turn16 / 65536 * math.tau) for s in sightings]
        return Readings(
            np.arange(first, first + len(seen), dtype=np.int64),
            np.array(poses),
            np.array([[_METRES.get(mm, mm / 1000) for mm in sighting.ranges_mm] for sighting in sightings]),
        )

    def close(self) -> None:
        """Nothing moves."""


_NOTHING = Readings.empty(len(SENSOR.beams))
_METRES = {0: math.nan, 65535: math.inf}


class Hindsight:
    """What a robot learns of its scans afterwards (as of team-mates that stood in the way): some were wrong."""

    def __init__(self) -> None:
        self.withdrawn: set[int] = set()
        self._news: list[tuple[int, int]] = []

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Nobody's updates tell it."""

    def replaced(self, session: SessionId) -> None:
        """It does not ask whose session it was."""

    def withdraw(self, stamp_ms: int) -> None:
        self.withdrawn.add(stamp_ms)
        self._news.append((stamp_ms, stamp_ms))

    def news(self) -> list[tuple[int, int]]:
        news, self._news = self._news, []
        return news

    def masks(self, scans: Scans) -> NDArray[np.bool_]:
        wrong = np.isin(scans.stamps_ms, list(self.withdrawn))
        return np.repeat(wrong[:, None], scans.beams, axis=1)


class Tap:
    """A peer's bus, which also keeps account of what is given to it."""

    def __init__(self, arena: Arena, who: str, bus: InProcessBus) -> None:
        self.who = who
        self.bus = bus
        self.heard = 0
        self.peer = bus.peer
        self.mtu = bus.mtu
        self.counters = bus.counters
        self.bytes: Counter[str] = Counter()
        self.carried = 0
        self._arena = arena

    def publish(self, topic: str, payload: bytes) -> None:
        self._arena.given["copies"] += len(self._arena.taps) - 1
        self._count(topic, payload)
        self.bus.publish(topic, self._arrives(payload))

    def send(self, peer: str, payload: bytes) -> None:
        self._arena.given["copies"] += 1
        self._count("to", payload)
        self.bus.send(peer, self._arrives(payload))

    @property
    def waits(self) -> bool:
        """Whether there is something to receive."""
        return bool(self.bus.inbox._messages or self.bus.inbox._presence)

    def receive(self, timeout: float = 0.0) -> list[Heard]:
        events = self.bus.receive()
        self.heard += sum(isinstance(event, Message) for event in events)
        return events

    def serve(self, topic: str, answers: Answers) -> None:
        self.bus.serve(topic, answers)

    def close(self) -> None:
        self.bus.close()

    def _arrives(self, payload: bytes) -> bytes:
        payload = self._arena.on_the_way(payload)
        self.carried += len(payload)
        return payload

    def _count(self, topic: str, payload: bytes) -> None:
        self.bytes[topic] += len(payload)
        self._arena.remember(payload)


@dataclass
class Process:
    """One running node, and what a schedule can do to it."""

    role: Role
    node: Node
    tap: Tap
    eyes: Eyes | None
    keeper: Keeper | NoKeeper
    wake_at: float = 0.0

    @property
    def peer(self) -> Peer:
        return self.node.peer

    @property
    def session(self) -> SessionId | None:
        """The session that it writes now."""
        writer = self.peer.writer
        return None if writer is None else writer.replica.descriptor.session

    @property
    def written(self) -> OwnSession | None:
        """The session that it writes now, with its journal: its own, or an earlier run's."""
        mine = (each for each in (self.node.own, self.node._earlier) if each and each.writer is self.peer.writer)
        return next(mine, None)

    @property
    def busy(self) -> bool:
        """Whether something that it sensed or learnt is not published yet."""
        written = self.written
        if self.node._earlier is not None or (self.eyes is not None and self.eyes.coming):
            return True
        if written is None:
            return False
        start = self.peer.controls.start_pose(written.descriptor.robot)
        placed = written.descriptor.start == (start.pose if start else self.configured)
        return not (placed and written.settled)

    @property
    def configured(self) -> QuantisedPose | None:
        return None if self.role.start is None else QuantisedPose(*self.role.start.pose)


class Arena:
    """A swarm in the hands of a schedule.

    Attributes:
        network: the air between the peers, which also keeps the time.
        processes: who is there, by name.
        roles: what each that ever was there is.
        laws: what must hold.
        given: what was given to the network.
        hindsight: what each robot knows of its scans by now.
        folder: where state files are.
        said: the last payloads that were given to it.
        moved: whether anybody has done anything since somebody set this to False.
    """

    def __init__(self, schedule: Schedule, folder: Path) -> None:
        self.network = Network(
            schedule.seed,
            loss=schedule.loss,
            duplicate=schedule.duplicate,
            delay=schedule.delay,
            mtu=schedule.mtu,
            lease=schedule.lease,
        )
        self.processes: dict[str, Process] = {}
        self.roles: dict[str, Role] = {}
        self.taps: dict[str, Tap] = {}
        self.laws = Laws()
        self.given: Counter[str] = Counter()
        self.said: list[bytes] = []
        self.moved = False
        self.hindsight: defaultdict[str, Hindsight] = defaultdict(Hindsight)
        self.folder = folder
        self._profile = PROFILES[schedule.radio]
        self._journals: dict[SessionId, list[Entry]] = {}  # of each run
        self._lives_on_disk: Counter[str] = Counter()
        self._damaged: set[str] = set()  # whose files were once
        self._said: dict[SessionId, int] = {}  # how much of each run's journal is in updates
        self._silent: set[frozenset[str]] = set()
        self._islands: list[list[str]] = []
        self._lives: Counter[str] = Counter()
        self._seed = schedule.seed
        self._chance = random.Random(schedule.seed)
        self.corrupted = 0.0

    # --- what schedules do

    def join(self, who: str, role: Role) -> None:
        """A process starts, a robot's with a new session; with what is in its state file, if it keeps one."""
        if who in self.processes:
            return
        self.roles[who] = role
        tap = self._tap(who, f"{who}.{self._lives[who]}")
        kind = Hello.OBSERVER if role.robot is None else Hello.ROBOT
        eyes = None if role.robot is None else Eyes(self)
        keeper = Keeper(self._file(who).parent, who, "swarm", RULES) if role.remembers else NoKeeper()

        process: Process | None = None

        def listen(descriptor: Descriptor, update: Update) -> None:
            if process is not None and descriptor.session == process.session:  # else its file tells it
                self._chronicle(process)
                self.laws.written(descriptor.session, update.n, process.peer.replicas[descriptor.session].state)

        node = Node(
            tap,
            RULES,
            Hello(kind, who.encode(), b"test"),
            now=self.network.now,
            body=eyes,
            profile=self._profile,
            listener=listen,
            keeper=keeper,
        )
        process = self.processes[who] = Process(role, node, tap, eyes, keeper)
        self.laws.watch(tap.peer, process.peer)
        if role.remembers and who not in self._damaged:
            self.laws.kept(who, process.peer, self._held_by_others(who))
        if role.robot is not None and eyes is not None:
            ids = count()

            def new_id() -> SessionId:
                return hashlib.blake2b(f"{self._seed} {tap.peer} {next(ids)}".encode(), digest_size=8).digest()

            node.open_session(role.robot, process.configured, role.publish, self.hindsight[who], new_id)
            assert node.own is not None
            self._journals[node.own.run] = eyes.journal
            self._chronicle(process)

    def _chronicle(self, process: Process) -> None:
        """Begin to keep account of the session that a robot writes now."""
        writer = process.peer.writer
        if writer is not None and process.session not in self.laws.chronicles:
            descriptor = writer.replica.descriptor
            start = None if descriptor.start is None else Start.at(*descriptor.start)
            self.laws.chronicles[descriptor.session] = Chronicle(process.tap.who, start)

    def crash(self, who: str, damage: Damage = "none", seed: int = 0) -> None:
        """A process is killed: what it had not said is lost; its file is as it was then, or damaged."""
        if (process := self.processes.pop(who, None)) is None:
            return
        self._account(who, process)
        self._gone(process.tap)
        if damage != "none" or not process.role.remembers:
            self.laws.forget_decisions_of(who)
        self.network.crash(process.tap.peer)
        if isinstance(process.keeper, Keeper):
            self._lives_on_disk[who] += 1
            kill(process.keeper, self._file(who).parent)
            self._damaged |= {who} if damage != "none" else set()
            damaged(self._file(who), damage, random.Random(seed))

    def _file(self, who: str) -> Path:
        return self.folder / f"{who}.{self._lives_on_disk[who]}" / f"{who}.sqlite"

    def _held_by_others(self, who: str) -> dict[SessionId, int]:
        """How much of each session somebody else holds."""
        held: dict[SessionId, int] = {}
        for process in self.processes.values():
            if process.tap.who != who:
                for session, replica in process.peer.replicas.items():
                    held[session] = max(held.get(session, 0), replica.state.n)
        return held

    def sense(self, who: str, sightings: tuple[int, ...], every: float) -> None:
        """A robot will see these, one each ``every`` seconds."""
        process = self.processes.get(who)
        if process is not None and process.eyes is not None:
            now = self.network.now
            coming = [(now + k * every, number) for k, number in enumerate(sightings)]
            process.eyes.coming = sorted(process.eyes.coming + coming)
            process.wake_at = now

    def withdraw(self, who: str, nth: int) -> None:
        """A robot learns that one of the scans that it made since it started was wrong."""
        process = self.processes.get(who)
        if process is not None and process.eyes is not None and process.eyes.journal:
            journal = process.eyes.journal
            self.hindsight[who].withdraw(journal[nth % len(journal)].stamp_ms)
            process.wake_at = self.network.now

    def set_start(self, by: str, robot: str, start: Start) -> None:
        """Somebody decides where a robot started."""
        if (process := self.processes.get(by)) is not None:
            process.peer.set_start_pose(robot, QuantisedPose(*start.pose), self.network.now)
            self._decided(process, Control.START_POSE, robot.encode())

    def evict(self, by: str, nth: int, *, readmit: bool) -> None:
        """Somebody decides about the nth session that it knows."""
        process = self.processes.get(by)
        if process is None or not process.peer.replicas:
            return
        peer, now = process.peer, self.network.now
        session = sorted(peer.replicas)[nth % len(peer.replicas)]
        (peer.readmit if readmit else peer.evict)(session, now)
        self._decided(process, Control.EVICT, session)

    def _decided(self, process: Process, setting: int, subject: bytes) -> None:
        control = process.peer.controls.get(setting, subject)
        assert control is not None
        self.laws.controls.append((process.tap.who, control))
        process.wake_at = self.network.now

    def corrupt(self, share: float) -> None:
        """From now on every so many payloads arrive with a few bytes changed."""
        self.corrupted = share

    def silence(self, one: str, other: str) -> None:
        """Two never hear each other, though they may see each other."""
        self._silent.add(frozenset((one, other)))
        self._cut_silent()

    def partition(self, *islands: tuple[str, ...]) -> None:
        """Only peers on one island hear each other; none heals."""
        self._islands = [list(island) for island in islands]
        self._part()

    def weather(self, link: Link) -> None:
        """All links behave differently from now on."""
        self.network.link = link

    def stranger(self) -> Tap:
        """A hostile peer, whom nobody can keep out."""
        return self.taps.get(STRANGER) or self._tap(STRANGER, STRANGER)

    def on_the_way(self, payload: bytes) -> bytes:
        """What arrives of a payload."""
        if self.corrupted and self._chance.random() < self.corrupted:
            changed = mutated(payload, self._chance)
            return payload if is_a_lie(changed) else changed
        return payload

    def remember(self, payload: bytes) -> None:
        """What was said can be said again, by anybody."""
        self.said.append(payload)
        if len(self.said) > 2 * REMEMBERED:
            del self.said[:REMEMBERED]

    # --- time

    def run_until(self, end: float) -> None:
        """Let time pass."""
        self._turns()
        while self.network.now < end:
            self._step(end)

    def _step(self, end: float) -> None:
        """Go to the next moment at which somebody has something to do, ``end`` at the latest."""
        following = self.network.next_event()
        wakes = [process.wake_at for process in self.processes.values()]
        soonest = min([*wakes, end if following is None else following])
        self.network.advance(min(end, max(soonest, self.network.now + TICK)))
        self._turns()

    def _turns(self) -> None:
        now = self.network.now
        for process in self.processes.values():
            if not process.tap.waits and process.wake_at > now:
                continue
            events = process.tap.receive()
            self.moved, written = True, self.laws.updates
            process.node.turn(now, events)
            self._chronicle(process)
            wrote = self.laws.updates > written
            if events or wrote:
                self.laws.watch(process.tap.peer, process.peer)
            busy = process.busy
            if wrote:
                self._published(process)
            process.wake_at = min(
                process.peer.wake_at,
                math.inf if process.eyes is None else process.eyes.wake_at,
                now + Eyes.patience if busy else math.inf,
            )

    def _published(self, process: Process) -> None:
        """If a robot has said all that is in its journal: is it that?"""
        own, who = process.written, process.tap.who
        if own is not None and own.settled:
            journal = self._journals[own.run][: len(own.journal)]
            self.laws.published(own.descriptor.session, journal, self.hindsight[who].withdrawn)
            if len(journal) < self._said.get(own.run, 0) and who not in self._damaged:
                raise Broken("what is said is kept", f"{who} published {self._said[own.run]} scans, now {len(journal)}")
            self._said[own.run] = len(journal)

    # --- the end

    def heal(self) -> None:
        """Nothing disturbs the swarm any more, but that its links are what they are."""
        self.partition()
        self.corrupt(0.0)
        if (tap := self.taps.get(STRANGER)) is not None:
            self._gone(tap)
            tap.close()

    def circles(self) -> list[dict[str, Process]]:
        """Those who can hear each other, be it through others: they owe each other agreement."""
        circles: list[dict[str, Process]] = []
        for who, process in self.processes.items():
            near = [circle for circle in circles if any(frozenset((who, each)) not in self._silent for each in circle)]
            circles = [circle for circle in circles if circle not in near]
            circles.append({who: process} | {name: each for circle in near for name, each in circle.items()})
        return circles

    def agree(self) -> bool:
        """Whether all have all updates of the same sessions as those they can hear, and nothing is unpublished."""
        for circle in self.circles():
            if len({process.peer.controls.check for process in circle.values()}) > 1:
                return False
            if len({frozenset(process.peer.replaced) for process in circle.values()}) > 1:
                return False
            first, *others = (process.peer.replicas for process in circle.values())
            for held in others:
                if held.keys() != first.keys() or any(held[key].state.n != first[key].state.n for key in first):
                    return False
        return not any(process.busy for process in self.processes.values())

    def settle(self, limit: float) -> float:
        """Let time pass until all agree; gives how much did.

        Raises:
            Broken: it was more than the limit.
        """
        begin, self.moved = self.network.now, True
        self._turns()  # what has just happened is known to whom it happened
        while not (self.moved and self.agree()):
            if self.network.now >= begin + limit:
                raise Broken("all agree", f"not within {limit:g} s: {self._positions()}")
            self.moved = False
            self._step(begin + limit)
        return self.network.now - begin

    def check(self) -> None:
        """The laws that hold when all agree."""
        for circle in self.circles():
            alive = {process.session for process in circle.values() if process.session is not None}
            self.laws.agreed({who: process.peer for who, process in circle.items()}, alive)
        self.audit()

    def audit(self) -> None:
        """The laws on memory and bytes, at any time."""
        for who, process in self.processes.items():
            self.laws.bounded(who, process.peer, peers=len(self._lives) + self._lives.total())
            self._account(who, process)
        received = self.given["received"] + sum(tap.counters["received"] for tap in self.taps.values())
        conserved(self.given["copies"], self.network.counters, self._under_way(), received)

    def _account(self, who: str, process: Process) -> None:
        said = process.peer.sent_bytes.total()
        if said != process.tap.bytes.total() or process.tap.carried != process.tap.counters["bytes_sent"]:
            raise Broken("every byte is accounted for", f"{who} says it sent {said} bytes: {process.tap.bytes}")
        taken = process.tap.heard + process.tap.counters["dropped_inbox_full"]
        if taken > process.tap.counters["received"]:
            raise Broken("every byte is accounted for", f"{who} heard {taken} messages of fewer")

    def close(self) -> None:
        """Let go of all files."""
        for process in self.processes.values():
            if isinstance(process.keeper, Keeper):
                process.keeper.close()

    # --- details

    def _gone(self, tap: Tap) -> None:
        self.given["received"] += tap.counters["received"]
        del self.taps[tap.peer]

    def _under_way(self) -> int:
        return sum(isinstance(happen, partial) for _, _, happen in self.network._due)

    def _tap(self, who: str, name: str) -> Tap:
        self._lives[who] += 1
        self._part(joining=(who, name))
        tap = self.taps[name] = Tap(self, who, self.network.bus(name))
        self._cut_silent()
        return tap

    def _part(self, joining: tuple[str, str] | None = None) -> None:
        """Tell the network who is on which island, by the names that they have on it now."""
        names = {tap.who: name for name, tap in self.taps.items()}
        if joining is not None:
            names[joining[0]] = joining[1]
        self.network.partition(*[[names[who] for who in island if who in names] for island in self._islands])

    def _cut_silent(self) -> None:
        for one, other in permutations(self.taps.values(), 2):
            if frozenset((one.who, other.who)) in self._silent:
                self.network.links[one.peer, other.peer] = Link(loss=1.0)

    def _positions(self) -> str:
        return ", ".join(
            f"{who} {[replica.state.n for _, replica in sorted(process.peer.replicas.items())]}"
            for who, process in self.processes.items()
        )
