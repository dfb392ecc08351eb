"""An operator among peers on the in-process bus, under fake time: what is decided is in force everywhere, or told."""

from __future__ import annotations

import pytest

from agent.config import Config, resolve
from agent.errors import UserError
from agent.operate import HOLDING, MEETING, NobodyError, Operator, chosen, evict, in_words, set_start_pose
from mapping.pose import QuantisedPose
from mapping.sensor import orion
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor
from transport.bus import Bus, Joined, Left, Message
from transport.in_process import Network

POSE = QuantisedPose(2150, 1450, 1820)
ORIGIN = QuantisedPose(0, 0, 0)


def lab() -> Config:
    return resolve({"robots": {"r1": {"start": {}}, "r2": {"start": {"x": 1.0}}, "r3": {}}})


class Place:
    """A network with robots and an observer; whoever waits on its bus lets the time pass for all."""

    def __init__(self) -> None:
        self.now = 0.0
        self.network = Network(seed=1)
        self.peers: dict[str, tuple[Bus, Peer]] = {}
        self.deaf: set[str] = set()
        self.rules = lab().rules()

    def peer(self, name: str, *, robot: str | None = None, session: bytes | None = None) -> Peer:
        hello = Hello(Hello.OBSERVER if robot is None else Hello.ROBOT, (robot or name).encode(), b"test")
        peer = Peer(hello, self.rules, seed=name.encode(), mtu=30_000, now=self.now)
        if robot is not None:
            peer.open_session(Descriptor(robot, session or name.encode().ljust(8, b"."), self.rules, orion(), ORIGIN))
        self.peers[name] = (self.network.bus(name), peer)
        return peer

    def passes(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.01
            self.network.advance(self.now)
            for name, (bus, peer) in self.peers.items():
                if name not in self.deaf:
                    self._turn(bus, peer)

    def _turn(self, bus: Bus, peer: Peer) -> None:
        for event in bus.receive():
            match event:
                case Message(sender, payload):
                    peer.receive(sender, payload, self.now)
                case Joined(other):
                    peer.joined(other, self.now)
                case Left(other):
                    peer.left(other, self.now)
        for to, topic, payload in peer.poll(self.now):
            if to is None:
                bus.publish(topic, payload)
            else:
                bus.send(to, payload)

    def operator(self) -> Operator:
        bus = self.network.bus("operator")
        receive = bus.receive

        def waits(timeout: float = 0.0) -> list:
            self.passes(timeout)
            return receive()

        bus.receive = waits  # type: ignore[method-assign]
        return Operator.met(bus, self.rules, lambda: self.now)


@pytest.fixture
def place() -> Place:
    """Two robots and an observer that have met."""
    place = Place()
    for name in ("r1", "r2"):
        place.peer(name, robot=name)
    place.peer("observer")
    place.passes(1.0)
    return place


def test_a_start_pose_is_in_force_everywhere_and_it_is_told_what_was_before(place) -> None:
    result = set_start_pose(place.operator(), lab(), "r2", POSE)
    assert result == {
        "robot": "r2",
        "start": {"x": 2.15, "y": 1.45, "yaw_deg": 9.9976},
        "before": {"x": 1.0, "y": 0.0, "yaw_deg": 0.0},
        "pending": False,
        "known_to_all": True,
        "held_by": ["observer", "r1", "r2"],
        "missing": [],
    }
    assert all(peer.controls.start_pose("r2").pose == POSE for _, peer in place.peers.values())
    assert in_words(result) == [
        "r2 starts at x = 2.15 m, y = 1.45 m, yaw = 9.9976 deg; before: x = 1 m, y = 0 m, yaw = 0 deg",
        "known to observer, r1, r2",
    ]
    assert place.now < 1.0 + MEETING  # nobody waited for a deadline


def test_a_decision_supersedes_the_one_in_force(place) -> None:
    for k in range(3):
        next(iter(place.peers.values()))[1].set_start_pose("r2", QuantisedPose(k, 0, 0), place.now)
    place.passes(1.0)
    result = set_start_pose(place.operator(), lab(), "r2", POSE)
    assert result["before"] == {"x": 0.002, "y": 0.0, "yaw_deg": 0.0}
    assert result["known_to_all"]
    assert all(peer.controls.start_pose("r2").pose == POSE for _, peer in place.peers.values())


def test_a_robot_that_is_away_is_told_of_as_pending_and_a_stranger_is_an_error(place) -> None:
    operator = place.operator()
    result = set_start_pose(operator, lab(), "r3", POSE)
    assert (result["pending"], result["known_to_all"], result["before"]) == (True, True, None)
    assert "r3 is not here: its map is put right when it comes back" in in_words(result)
    with pytest.raises(UserError, match="'r9' is unknown; robots there are: r1, r2, r3"):
        set_start_pose(operator, lab(), "r9", POSE)


def test_a_session_is_evicted_everywhere_and_readmitted(place) -> None:
    session = b"r2......"
    operator = place.operator()
    result = evict(operator, "r2", readmit=False)
    assert (result["session"], result["changed"], result["known_to_all"]) == (session.hex(), True, True)
    assert all(peer.controls.evicted == {session} for _, peer in place.peers.values())
    assert in_words(result)[0] == f"session {session.hex()} of r2 is evicted"
    again = evict(operator, session.hex(), readmit=False)
    assert not again["changed"]
    assert in_words(again)[0] == f"session {session.hex()} of r2 is evicted (as it was before)"
    assert evict(operator, session.hex()[:4], readmit=True)["known_to_all"]
    assert all(peer.controls.evicted == set() for _, peer in place.peers.values())


def test_whoever_does_not_answer_is_named_and_learns_it_later(place) -> None:
    place.deaf.add("r1")
    began = place.now
    result = evict(place.operator(), "r2", readmit=False)
    assert (result["known_to_all"], result["missing"], result["held_by"]) == (False, ["r1"], ["observer", "r2"])
    assert in_words(result)[-1] == "not confirmed by r1: they learn it from the others"
    assert place.now - began == pytest.approx(MEETING + HOLDING, abs=1.0)
    place.deaf.clear()
    place.passes(5.0)
    assert place.peers["r1"][1].controls.evicted == {b"r2......"}


def test_where_nobody_is_nothing_is_decided() -> None:
    with pytest.raises(NobodyError):
        Place().operator()


def test_a_session_is_meant_by_its_id_the_beginning_of_one_or_its_robot() -> None:
    place = Place()
    for name, robot, session in (
        ("a", "r1", "1111111111111111"),
        ("b", "r2", "1122222222222222"),
        ("c", "ab", "cd33333333333333"),
        ("d", "x", "ab44444444444444"),
        ("e", "x", "ab55555555555555"),
    ):
        place.peer(name, robot=robot, session=bytes.fromhex(session))
    observer = place.peer("o")
    place.passes(1.0)

    def means(name: str, *, readmit: bool = False) -> str:
        return chosen(observer, name, readmit=readmit).session.hex()[:2]

    assert (means("r1"), means("112"), means("CD")) == ("11", "11", "cd")
    assert means("ab") == "cd"  # a robot's id comes before the beginning of a session's
    assert means("ab4") == "ab"
    for name in ("11", "x"):
        with pytest.raises(UserError, match=f"'{name}' means 2 sessions; give one of "):
            means(name)
    with pytest.raises(UserError, match=r"'zz' is no session or robot; give one of 1111111111111111 \(r1\), .*\(x\)"):
        means("zz")
    observer.evict(bytes.fromhex("ab44444444444444"), place.now)
    assert chosen(observer, "x", readmit=False).session.hex().startswith("ab5")
    assert chosen(observer, "x", readmit=True).session.hex().startswith("ab4")
