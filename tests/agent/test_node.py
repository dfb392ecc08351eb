"""A process's one loop, on the in-process bus under a fake clock: it senses, publishes, follows and reports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import agent.node
import agent.own_session
from agent.body import BATCH
from agent.journal import Journal, JournalFullError
from agent.node import NoBody, Node, peer_name
from agent.readings import Readings
from agent.team_mates import NoMates
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.sensor import orion
from mapping.tiles import map_digest
from swarm.messages import Hello
from swarm.session import Rules
from transport.bus import is_name
from transport.in_process import InProcessBus, Link, Network

RULES = Rules(Lattice(20), EvidenceModel())
ORIGIN = QuantisedPose(0, 0, 0)
STEP = 0.01


class Body:
    """A robot that turns on the spot, ten scans a second."""

    def __init__(self, count: int = 20) -> None:
        self.sensor = orion()
        turns = np.arange(count) * 65536 // count
        poses = np.column_stack([np.zeros((count, 2)), turns / 65536 * math.tau])
        self.readings = Readings(np.arange(count, dtype=np.int64) * 100, poses, np.full((count, 5), 0.5))
        self.given = 0
        self.asked: list[float] = []
        self.patience, self.status = 0.02, ""

    def place(self, start: QuantisedPose) -> None:
        pass

    def read(self, until: float) -> Readings:
        self.asked.append(until)
        due = min(int(np.searchsorted(self.readings.stamps_ms / 1000, until)), self.given + BATCH)
        rows = slice(self.given, max(self.given, due))
        self.given = rows.stop
        return self.part(rows)

    def part(self, rows: slice) -> Readings:
        return Readings(self.readings.stamps_ms[rows], self.readings.poses[rows], self.readings.ranges[rows])

    @property
    def progress(self) -> tuple[int, int]:
        return self.given, len(self.readings)

    @property
    def done(self) -> bool:
        return self.given == len(self.readings)

    def close(self) -> None:
        pass

    def digest(self, start: QuantisedPose = ORIGIN) -> str:
        scans = self.readings.scans(start, self.sensor)
        return map_digest(integrated({}, scans, self.sensor, RULES.model, RULES.lattice)).hex()


class Conductor:
    """A node's control: every look at ``stop`` is a step of the fake time, until the piece is over.

    Attributes:
        told: all statuses.
    """

    def __init__(self, time: FakeTime, over: Callable[[Conductor], bool], *, go: bool = True) -> None:
        self.go, self.kernel = go, False
        self.told: list[dict[str, Any]] = []
        self.at: list[float] = []
        self.beats: list[float] = []
        self._time, self._over = time, over
        self._steps: Iterator[None] = iter(())

    def plays(self, steps: Iterator[None]) -> None:
        """Have somebody else's loop take a step for each of ours."""
        self._steps = steps

    @property
    def stop(self) -> bool:
        self._time.passes()
        next(self._steps, None)
        assert self._time.now < 60, "it takes too long"
        return self._over(self)

    def tell(self, event: str, **facts: Any) -> None:
        assert event == "status"
        self.told.append(facts)
        self.at.append(self._time.now)

    def beat(self, now: float) -> None:
        self.beats.append(now)


class FakeTime:
    """Stands for ``time`` in the node, and moves the network along."""

    def __init__(self) -> None:
        self.now = 0.0
        self.slept: list[float] = []
        self.network = Network(seed=1)

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)

    def passes(self) -> None:
        self.now += STEP
        self.network.advance(self.now)


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    fake = FakeTime()
    monkeypatch.setattr(agent.node, "time", fake)
    return fake


def robot(bus: InProcessBus, body: Body, **options: Any) -> Node:
    node = Node(bus, RULES, Hello(Hello.ROBOT, b"r1", b"test"), now=agent.node.time.monotonic(), body=body, **options)
    node.open_session("r1", ORIGIN, "auto", NoMates())
    return node


def observer(bus: InProcessBus, rules: Rules = RULES, **options: Any) -> Node:
    return Node(bus, rules, Hello(Hello.OBSERVER, b"o", b"test"), now=agent.node.time.monotonic(), **options)


def steps(node: Node, time: FakeTime) -> Iterator[None]:
    """The other node's loop, a turn at a time (what ``run`` does until it is told to stop)."""
    while True:
        node.turn(time.monotonic(), node._bus.receive())
        yield


def done(conductor: Conductor) -> bool:
    return bool(conductor.told) and bool(conductor.told[-1]["done"])


# The loop


def test_what_comes_in_gathers_while_the_loop_rests_unless_a_peer_has_just_been_spoken_to(time) -> None:
    node = observer(time.network.bus("o"))
    waited: list[float] = []
    receive = node._bus.receive
    node._bus.receive = lambda timeout: (waited.append(timeout), receive())[1]  # type: ignore[method-assign]
    node.run(Conductor(time, lambda control: time.now > 0.5))
    assert set(waited) == {0.0}
    assert max(time.slept) == NoBody.patience
    bus = time.network.bus("r")  # whoever joins is told things that are for it alone, and may answer
    node.run(Conductor(time, lambda control: max(waited) > 0.0))
    bus.close()
    slept = len(time.slept)
    node.run(Conductor(time, lambda control: len(time.slept) > slept + 5))
    assert set(waited[-5:]) == {0.0}


# Senses


def test_what_a_body_senses_becomes_the_robots_session_and_map(time) -> None:
    body = Body()
    node = robot(time.network.bus("r1"), body)
    node.run(Conductor(time, done))
    assert node.scans == 20
    assert node.summary()["map_digest"] == body.digest()
    (replica,) = node.peer.replicas.values()
    assert replica.state.n > 5  # 2 s of scans in updates of 50 ms


def test_a_body_moves_when_it_may_and_at_its_speed(time) -> None:
    body = Body()
    control = Conductor(time, lambda control: time.now > 0.5 and not control.go, go=False)
    node = robot(time.network.bus("r1"), body, speed=10.0)
    node.run(control)
    assert set(body.asked) == {0.0}  # a robot is listened to before it may move
    assert body.given == 0
    body.asked.clear()
    began = time.now
    node.run(Conductor(time, done))
    assert body.asked[0] == 0.0  # its own time begins when it may go
    assert 0.1 < time.now - began < 0.5
    assert body.asked[5] == pytest.approx(10.0 * 5 * STEP)


def test_a_body_as_fast_as_it_can_is_read_to_infinity_and_still_listens(time) -> None:
    body = Body(5 * BATCH)
    node = robot(time.network.bus("r1"), body, speed=math.inf)
    heard = []
    receive = node._bus.receive
    node._bus.receive = lambda timeout: (heard.append((timeout, body.given)), receive())[1]  # type: ignore[method-assign]
    node.run(Conductor(time, done))
    assert set(body.asked) == {math.inf}
    assert heard[1:5] == [(0.0, turn * BATCH) for turn in range(1, 5)]


def test_a_body_that_is_done_is_still_read_but_its_scans_no_longer_count(time) -> None:
    """A robot that stands at its last waypoint goes on sensing, and must be told to go on standing."""
    body = Body()
    node = robot(time.network.bus("r1"), body, speed=math.inf)
    node.run(Conductor(time, done))
    asked, digest = len(body.asked), node.summary()["map_digest"]
    body.read = lambda until: (body.asked.append(until), body.part(slice(1)))[1]  # type: ignore[method-assign]
    node.run(Conductor(time, lambda control: len(body.asked) >= asked + 3))
    assert node.scans == 20
    assert node.summary()["map_digest"] == digest


def test_what_is_wrong_with_a_body_is_told(time) -> None:
    body = Body()
    body.status = "the robot is not connected"
    control = Conductor(time, lambda control: bool(control.told))
    robot(time.network.bus("r1"), body).run(control)
    assert control.told[0]["body"] == "the robot is not connected"


def test_what_was_sensed_last_is_published_when_it_is_told_to_stop(time) -> None:
    body = Body()
    node = robot(time.network.bus("r1"), body, speed=math.inf)
    node.run(Conductor(time, lambda control: body.done))  # it stops with news in hand
    assert node.peer.writer is not None
    assert not node.peer.writer.waiting
    assert node.summary()["map_digest"] == body.digest()


def test_whoever_ends_stays_until_somebody_has_its_last_words(time, monkeypatch) -> None:
    body, watching = Body(2 * BATCH), observer(time.network.bus("o"))
    node, turns = robot(time.network.bus("r1"), body, speed=math.inf), steps(watching, time)

    def over(control: Conductor) -> bool:
        if body.given:
            time.network.links["r1", "o"] = Link(loss=1.0)
        return body.done

    def sleep(seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            time.passes()
        next(turns)
        if len(time.slept) > 5:
            time.network.links.clear()
        time.slept.append(seconds)

    control = Conductor(time, over)
    control.plays(turns)
    monkeypatch.setattr(time, "sleep", sleep)
    node.run(control)
    assert watching.summary()["map_digest"] == node.summary()["map_digest"] == body.digest()
    assert len(time.slept) < 45


def test_whoever_ends_does_not_stay_for_those_who_never_hear_it(time) -> None:
    body = Body()
    observer(time.network.bus("o")).peer.joined("r1", 0.0)
    node = robot(time.network.bus("r1"), body, speed=math.inf)
    time.network.links["r1", "o"] = Link(loss=1.0)
    node.run(Conductor(time, lambda control: body.done))
    assert node.summary()["map_digest"] == body.digest()


def test_a_robot_that_is_told_where_it_really_started_publishes_all_of_it_anew(time) -> None:
    body, start = Body(), QuantisedPose(500, 250, 1000)
    node = robot(time.network.bus("r1"), body)
    operator = observer(time.network.bus("o"))
    turns = steps(operator, time)
    control = Conductor(time, lambda control: body.given > 10)
    control.plays(turns)
    node.run(control)
    operator.peer.set_start_pose("r1", start, time.now)
    control = Conductor(time, lambda control: done(control) and operator.summary()["map_digest"] == body.digest(start))
    control.plays(turns)
    node.run(control)
    assert node.summary()["map_digest"] == body.digest(start)
    assert len(node.peer.replicas) == 1


def test_what_is_left_of_a_correction_is_published_before_the_end(time, monkeypatch) -> None:
    monkeypatch.setattr(agent.own_session, "_MOST_ROWS", 3)
    body, start = Body(), QuantisedPose(500, 250, 1000)
    node = robot(time.network.bus("r1"), body, speed=math.inf)
    node.run(Conductor(time, done))
    node.peer.set_start_pose("r1", start, time.now)
    node.run(Conductor(time, lambda control, end=time.now + 3 * STEP: time.now > end))
    assert node.summary()["map_digest"] == body.digest(start)


def test_a_full_journal_ends_it_rather_than_losing_scans_in_silence(time) -> None:
    body = Body()
    node = robot(time.network.bus("r1"), body)
    assert node.own is not None
    node.own.journal = Journal(body.sensor, max_bytes=10 * (8 + 24 + 40))
    with pytest.raises(JournalFullError):
        node.run(Conductor(time, done))


# Publishes and follows


def test_an_observer_follows_a_robot_to_the_same_map(time) -> None:
    body, heard = Body(), []
    watching = observer(time.network.bus("o"), listener=lambda descriptor, update: heard.append(descriptor.robot))
    node = robot(time.network.bus("r1"), body)
    control = Conductor(
        time, lambda control: done(control) and len(heard) == sum(control.told[-1]["positions"].values())
    )
    control.plays(steps(watching, time))
    node.run(control)
    assert watching.summary()["map_digest"] == node.summary()["map_digest"] == body.digest()
    assert set(heard) == {"r1"}
    assert node.summary()["bytes_sent"] > 0
    assert node.summary()["dropped"] == {}


def test_an_observer_that_comes_late_has_all_of_it(time) -> None:
    body = Body()
    node = robot(time.network.bus("r1"), body, speed=math.inf)
    node.run(Conductor(time, done))
    late = observer(time.network.bus("o"))
    control = Conductor(time, lambda control: bool(control.told) and control.told[-1]["positions"] != {})
    control.plays(steps(node, time))
    late.run(control)
    late.run(Conductor(time, lambda _, end=time.now + 0.2: time.now > end))
    assert late.summary()["map_digest"] == body.digest()


def test_messages_that_mean_nothing_are_counted_and_named_in_the_summary(time) -> None:
    node = observer(time.network.bus("o"))
    noisy = time.network.bus("x")
    for payload in (b"", b"\xff" * 9, b"hello"):
        noisy.publish("update", payload)
    node.run(Conductor(time, lambda control: time.now > 0.1))
    assert sum(node.summary()["dropped"].values()) == 3


# Reports


def test_statuses_tell_who_is_around_how_far_it_is_and_what_it_knows(time) -> None:
    time.network.bus("x")
    node = robot(time.network.bus("r1"), Body())
    control = Conductor(time, done)
    node.run(control)
    (session,) = node.peer.replicas
    first, last = control.told[0], control.told[-1]
    assert first.keys() == last.keys() == {"around", "progress", "body", "state", "done", "positions", "apart", "spent"}
    assert (first["done"], last["done"]) == (False, True)
    assert last["around"] == 1
    assert tuple(last["progress"]) == (20, 20)
    assert last["positions"] == {session.hex(): node.peer.replicas[session].state.n}


def test_statuses_are_news_and_at_most_ten_a_second(time) -> None:
    control = Conductor(time, lambda control: time.now > 5)
    robot(time.network.bus("r1"), Body()).run(control)
    assert all(later - earlier >= 0.1 - 1e-9 for earlier, later in zip(control.at, control.at[1:], strict=False))
    assert all(one != other for one, other in zip(control.told, control.told[1:], strict=False))
    assert control.at[-1] < 2.5  # nothing new: nothing said
    assert control.beats[-1] > 4.8  # yet it lives


def test_done_is_not_said_before_everything_is_published(time) -> None:
    node = robot(time.network.bus("r1"), Body(), speed=math.inf)
    control = Conductor(time, done)
    node.run(control)
    assert node.peer.writer is not None
    for status in control.told:
        assert status["done"] is False or status["positions"] == control.told[-1]["positions"]
    assert not node.peer.writer.waiting


def test_those_who_leave_are_not_around(time) -> None:
    other = time.network.bus("x")
    node = observer(time.network.bus("o"))
    control = Conductor(time, lambda control: time.now > 0.3)
    node.run(control)
    other.close()
    control = Conductor(time, lambda control: time.now > 0.6)
    node.run(control)
    assert control.told[-1]["around"] == 0


def test_a_robot_with_other_rules_is_refused_in_words(time) -> None:
    rules = Rules(Lattice(50), EvidenceModel())
    node = robot(time.network.bus("r1"), Body())
    watching = observer(time.network.bus("o"), rules)
    control = Conductor(time, lambda control: bool(control.told) and bool(control.told[-1]["apart"]))
    control.plays(steps(node, time))
    watching.run(control)
    assert list(control.told[-1]["apart"].values()) == ["r1: cell size 0.02 m, ours is 0.05 m"]
    assert control.told[-1]["positions"] == {}


# A turn at a time


def test_turns_need_no_clock_no_thread_and_no_control(monkeypatch) -> None:
    """A harness runs many nodes so, under a time of its own."""
    monkeypatch.setattr(agent.node, "time", None)
    monkeypatch.setattr("threading.Thread.start", lambda thread: pytest.fail(f"{thread} was started"))
    network = Network(seed=1)
    body = Body()
    nodes = {}
    for name, senses in (("r1", body), ("o", None)):
        bus = network.bus(name)
        nodes[bus] = Node(bus, RULES, Hello(Hello.ROBOT, name.encode(), b"test"), now=0.0, body=senses)
    writer, follower = nodes.values()
    own = writer.open_session("r1", ORIGIN, "auto", NoMates(), lambda: bytes(8))
    assert own.descriptor.session == bytes(8)
    for tick in range(400):
        network.advance(tick * STEP)
        for bus, node in nodes.items():
            node.turn(network.now, bus.receive())
    assert writer.status()["done"]
    assert writer.status()["positions"] == follower.status()["positions"] != {}
    assert writer.summary()["map_digest"] == follower.summary()["map_digest"] == body.digest()


# Odds and ends


def test_an_observers_body_senses_nothing_and_is_always_done() -> None:
    body = NoBody()
    assert (len(body.read(math.inf)), body.progress, body.done) == (0, (0, 0), True)


def test_no_two_processes_have_one_name_on_the_bus() -> None:
    names = {peer_name("r" * 32) for _ in range(100)}
    assert len(names) == 100
    assert all(is_name(name) for name in names)


def test_the_kernel_is_loaded_when_there_is_one_and_the_loop_does_not_end_in_the_middle_of_it(
    time, monkeypatch
) -> None:
    node = robot(time.network.bus("r1"), Body())
    asked = []
    monkeypatch.setattr(node._kernel, "load", lambda: asked.append("load"))
    monkeypatch.setattr(node._kernel, "close", lambda: asked.append("close"))
    control = Conductor(time, lambda control: time.now > 0.1)
    node.run(control)
    assert asked == ["close"]
    control = Conductor(time, lambda control: time.now > 0.2)
    control.kernel = True
    node.run(control)
    assert asked[1] == "load"
    assert asked[-1] == "close"
