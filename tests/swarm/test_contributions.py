from collections.abc import Callable

import numpy as np
import pytest

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import Scans
from mapping.sensor import orion
from swarm.contributions import SILENCE, Contribution, contributions
from swarm.messages import Digest, Hello, Session, encode
from swarm.peer import Peer
from swarm.session import Descriptor, Rules

RULES = Rules(Lattice(50), EvidenceModel())
START = QuantisedPose(0, 0, 0)
SCANS = Scans(np.zeros(1, np.int64), np.zeros((1, 3), np.int32), np.full((1, 5), 300, np.uint16))


def descriptor(robot, session, *, rules=RULES, start=START, replaces=None):
    return Descriptor(robot, session, rules, orion(), start, replaces)


class Watching:
    """An observer, and what it hears from others at a time."""

    def __init__(self):
        self.peer = Peer(Hello(Hello.OBSERVER, b"o", b""), RULES, seed=b"o", mtu=32768, now=0.0)

    def hears(self, of: Descriptor, now=0.0):
        self.peer.receive("relay", encode(Session(of.encode())), now)

    def sees(self, name, of: Descriptor, now=0.0):
        """A robot that writes a session is there."""
        self.peer.receive(name, encode(Hello(Hello.ROBOT, of.robot.encode(), b"", of.session)), now)

    def at(self, now) -> dict[bytes, Contribution]:
        return {each.descriptor.session: each for each in contributions(self.peer, now)}


def reason(prepare: Callable[[Watching], None], session=b"session1", now=1.0):
    watching = Watching()
    prepare(watching)
    found = watching.at(now)[session]
    return found.summed, found.reason


def plain(watching):
    watching.hears(descriptor("r1", b"session1"))


def unplaced(watching):
    watching.hears(descriptor("r1", b"session1", start=None))


def evicted(watching):
    plain(watching)
    watching.peer.evict(b"session1", 0.0)


def readmitted(watching):
    evicted(watching)
    watching.peer.readmit(b"session1", 0.0)


def evicted_by_nobody_in_words(watching):
    peer = Peer(Hello(Hello.OBSERVER, b"\xff\x01", b""), RULES, seed=b"x", mtu=64, now=0.0)
    peer.evict(b"session1", 0.0)
    for each in peer.poll(0.0):
        watching.peer.receive("x", each.payload, 0.0)
    plain(watching)


def replaced(watching):
    plain(watching)
    watching.hears(descriptor("r1", b"session2", replaces=b"session1"))


def other_rules(watching):
    watching.hears(descriptor("r1", b"session1", rules=Rules(Lattice(20), EvidenceModel())))


def behind(watching):
    plain(watching)
    watching.peer.receive("relay", encode(Digest.of([(b"session1", 40)], complete=True)), 0.5)


@pytest.mark.parametrize(
    ("prepare", "summed", "words"),
    [
        (plain, True, ""),
        (unplaced, False, "no start pose"),
        (evicted, False, "evicted by o"),
        (readmitted, True, ""),
        (evicted_by_nobody_in_words, False, "evicted by ff01000000000000"),
        (replaced, False, f"replaced by {b'session2'.hex()}"),
        (other_rules, False, "cell size 0.02 m, ours is 0.05 m"),
        (behind, True, "is behind: at 0 of 40"),
    ],
)
def test_each_state_has_its_reason(prepare, summed, words):
    assert reason(prepare) == (summed, words)


def test_what_is_summed_is_what_the_map_is_made_of():
    watching = Watching()
    watching.hears(descriptor("r1", b"session1"))
    watching.hears(descriptor("r2", b"session2", start=None))
    watching.hears(descriptor("r3", b"session3"))
    watching.peer.evict(b"session3", 0.0)
    found = watching.at(0.0)
    assert len(watching.peer._maps()) == sum(each.summed for each in found.values()) == 1
    assert [each.descriptor.robot for each in found.values()] == ["r1", "r2", "r3"]


def test_silence_is_told_of_a_session_whose_writer_is_not_there():
    watching, of = Watching(), descriptor("r1", b"session1")
    watching.hears(of, now=100.0)
    assert watching.at(100.0 + SILENCE - 0.1)[of.session].reason == ""
    assert watching.at(112.0)[of.session].reason == "silent for 12 s"
    watching.sees("r1.x", of, now=113.0)
    assert watching.at(200.0)[of.session] == Contribution(of, 0, True, True, False, "")
    assert watching.peer.heard_at[of.session] < 113.0
    watching.peer.receive("r1.x", encode(Digest.of([], complete=False)), 150.0)
    assert watching.peer.heard_at[of.session] == 150.0
    watching.peer.left("r1.x", 160.0)
    assert watching.at(163.0)[of.session].reason == "silent for 13 s"


def test_a_session_that_was_never_heard_of_since_the_start_says_so():
    watching = Watching()
    plain(watching)
    watching.peer.heard_at.clear()
    assert watching.at(0.0)[b"session1"].reason == "not heard of yet"


def test_two_live_sessions_under_one_robot_id_are_flagged_and_both_summed():
    watching = Watching()
    of = [descriptor("r1", bytes([k] * 8)) for k in range(3)]
    for each in [*of, descriptor("r2", b"session2")]:
        watching.hears(each)
    watching.sees("r2.x", descriptor("r2", b"session2"))
    watching.sees("r1.a", of[0])
    assert not any(each.duplicate for each in watching.at(1.0).values())
    watching.sees("r1.b", of[1])
    found = watching.at(1.0)
    assert [each.duplicate for each in found.values()] == [True, True, False, False]
    assert found[of[0].session].reason == "two live robots are called r1"
    assert found[of[0].session].summed
    assert found[of[1].session].summed
    watching.sees("r1.c", of[2])
    assert watching.at(1.0)[of[2].session].reason == "three live robots are called r1"
    watching.peer.left("r1.a", 1.0)
    watching.peer.left("r1.b", 1.0)
    assert not any(each.duplicate for each in watching.at(1.0).values())


def test_a_robot_that_opened_its_session_anew_is_no_duplicate_of_itself():
    watching, old = Watching(), descriptor("r1", b"session1")
    new = descriptor("r1", b"session2", replaces=b"session1")
    watching.hears(old)
    watching.sees("r1.x", old)
    watching.hears(new)
    assert not any(each.duplicate for each in watching.at(1.0).values())
    watching.sees("r1.x", new)
    assert [each.live for each in watching.at(1.0).values()] == [False, True]
    assert not any(each.duplicate for each in watching.at(1.0).values())


def test_a_robot_that_hears_of_its_double_flags_it_too():
    peer = Peer(Hello(Hello.ROBOT, b"r1", b""), RULES, seed=b"r1", mtu=32768, now=0.0)
    peer.open_session(descriptor("r1", b"session1"))
    double = descriptor("r1", b"session2")
    peer.receive("r1.x", encode(Session(double.encode())), 0.0)
    peer.receive("r1.x", encode(Hello(Hello.ROBOT, b"r1", b"", double.session)), 0.0)
    assert [each.reason for each in contributions(peer, 0.0)] == ["two live robots are called r1"] * 2


def test_the_own_session_is_never_silent():
    peer = Peer(Hello(Hello.ROBOT, b"r1", b""), RULES, seed=b"r1", mtu=32768, now=0.0)
    peer.open_session(descriptor("r1", b"session1")).sense(SCANS)
    peer.poll(0.0)
    [own] = contributions(peer, 1000.0)
    assert (own.n, own.summed, own.live, own.reason) == (1, True, True, "")
