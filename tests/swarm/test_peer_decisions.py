"""Operators' decisions and sessions that replace others, at one peer and its neighbours."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.pose import QuantisedPose
from mapping.raster import raster
from mapping.scan import Scans
from swarm import peer as peer_module
from swarm.messages import AskControls, Control, Hello, Session, Want, decode, encode
from swarm.peer import Peer
from swarm.replica import Replica
from swarm.session import Descriptor
from swarm.writer import Writer
from tests.swarm.pair import (
    ORION,
    OTHER_RULES,
    RULES,
    SESSION,
    START,
    Pair,
    damaged,
    following,
    snapshot,
    some_scans,
    truth,
)


def controls_said(pair):
    return [(name, decode(each.payload)) for name, each in pair.traffic if each.topic in {"control", "ask"}]


def test_an_evicted_session_leaves_every_map_is_followed_all_the_same_and_comes_back():
    pair = Pair()
    a, b, o = pair.robot("a"), pair.robot("b"), pair.observer("o")
    one, other, later = some_scans(1, 30), some_scans(2, 20), some_scans(3, 5)
    a.writer.sense(one)
    b.writer.sense(other)
    pair.run(1.0)
    o.evict(SESSION, pair.now)
    assert o.fusion.digest() == truth(other)
    pair.run(0.1)
    assert pair.digests() == {truth(other)}
    a.writer.sense(later)
    pair.run(0.5)
    assert pair.digests() == {truth(other)}
    assert o.replicas[SESSION].state.root() == a.writer.replica.state.root()
    a.readmit(SESSION, pair.now)
    pair.run(0.1)
    assert pair.digests() == {truth(one, other, later)}
    assert len(controls_said(pair)) == 2  # they were heard at once: nobody had to ask


def test_an_eviction_may_come_before_its_session():
    pair = Pair()
    o, scans = pair.observer("o"), some_scans(1, 5)
    o.evict(SESSION, pair.now)
    a = pair.robot("a")
    a.writer.sense(scans)
    pair.run(5.0)
    assert pair.digests() == {truth()}
    assert a.controls.evicted == {SESSION}
    o.readmit(SESSION, pair.now)
    pair.run(1.0)
    assert pair.digests() == {truth(scans)}


def test_a_copy_that_was_damaged_leaves_the_sum_without_a_trace():
    pair = Pair()
    a, b, o = pair.robot("a"), pair.robot("b"), pair.observer("o")
    scans = some_scans(2, 20)
    a.writer.sense(some_scans(1, 30))
    b.writer.sense(scans)
    pair.run(1.0)
    damaged(o, SESSION)
    o.evict(SESSION, pair.now)
    assert o.fusion.digest() == truth(scans)


def test_a_tile_of_which_nothing_is_left_is_seen_to_go():
    pair, _, o = following()
    keys = o.fusion.tiles.keys()
    o.evict(SESSION, pair.now)
    assert o.fusion.tiles.keys() == keys
    assert not any(cells.any() for cells in o.fusion.tiles.values())


def test_who_comes_late_asks_one_peer_for_the_control_records_and_equal_tables_say_nothing():
    pair = Pair()
    a = pair.robot("a")
    pair.observer("o")
    pair.run(0.1)
    a.evict(b"session1", pair.now)
    a.set_start_pose("a", QuantisedPose(1, 2, 3), pair.now)
    pair.run(10.0)
    del pair.traffic[:]
    late = pair.observer("late")
    pair.run(20.0)
    assert [*late.controls] == [*a.controls]
    assert late.controls.check == a.controls.check
    assert late.controls.start_pose("a") == (QuantisedPose(1, 2, 3), SESSION)
    asks = [name for name, message in controls_said(pair) if isinstance(message, AskControls)]
    assert asks.count("late") == 1
    a.receive("late", encode(AskControls(a.controls.check)), pair.now)
    assert all(each.topic != "control" for each in a.poll(pair.now))


def test_two_who_decide_at_once_end_with_the_same_decision():
    pair = Pair()
    a, o = pair.robot("a"), pair.observer("o")
    a.writer.sense(some_scans(1, 5))
    pair.run(1.0)
    a.evict(SESSION, pair.now)
    o.readmit(SESSION, pair.now)
    a.set_start_pose("a", QuantisedPose(1, 0, 0), pair.now)
    o.set_start_pose("a", QuantisedPose(0, 0, 0), pair.now)
    pair.run(5.0)
    assert [*a.controls] == [*o.controls]
    assert a.controls.start_pose("a").pose == QuantisedPose(0, 0, 0)  # "o" is greater than "a"
    assert a.controls.evicted == set()
    assert len(pair.digests()) == 1


def test_who_issues_can_be_named():
    hello = Hello(Hello.OBSERVER, b"observer.of.the.lab", b"")
    for issuer, expected in ((b"", b"observer"), (b"ada", b"ada\0\0\0\0\0")):
        peer = Peer(hello, RULES, seed=b"", mtu=64, now=0.0, issuer=issuer)
        peer.evict(SESSION, 0.0)
        [control] = peer.controls
        assert control.issuer == expected


def test_a_decision_that_means_nothing_is_our_mistake():
    o = Pair().observer("o")
    with pytest.raises(ValueError, match="subject or value"):
        o.evict(b"short", 0.0)
    with pytest.raises(ValueError, match="subject or value"):
        o.set_start_pose("r 1", START, 0.0)
    assert not len(o.controls)
    assert all(each.topic != "control" for each in o.poll(0.0))


# --- sessions that replace others


def child(session, parent, robot="a", rules=RULES, start=START):
    return Descriptor(robot, session, rules, ORION, start, parent)


def moved(scans):
    return Scans(scans.stamps_ms, scans.poses + np.array([500, -300, 0], np.int32), scans.ranges)


def test_a_robot_that_opens_its_session_anew_is_summed_once_and_at_its_new_place():
    pair = Pair()
    a, b, o = pair.robot("a"), pair.robot("b"), pair.observer("o")
    one, other, more = some_scans(1, 30), some_scans(2, 20), some_scans(3, 4)
    a.writer.sense(one)
    b.writer.sense(other)
    pair.run(1.0)
    earlier = a.writer
    a.writer.sense(some_scans(9, 3))  # never published: it is in the robot's journal
    writer = a.open_session(child(b"a.second", SESSION))
    assert a.writer is writer is not earlier
    writer.sense(moved(one))
    pair.run(1.0)
    writer.sense(moved(more))
    pair.run(5.0)
    assert pair.digests() == {truth(moved(one), other, moved(more))}
    for peer in (a, b, o):
        assert peer.replicas.keys() == {b"a.second", b"b......."}
        assert peer.replaced == {SESSION: b"a.second"}
    assert b.peers["a"].session == b"a.second"
    digests = [decode(each.payload) for _, each in pair.traffic if each.topic == "digest"]
    assert digests[-1].positions().keys() == {b"a.second", b"b......."}


def test_a_robot_without_a_start_pose_is_placed_by_a_session_that_replaces_its_own():
    pair = Pair()
    a = pair.robot("a", start=None)
    pair.observer("o")
    scans = some_scans(1, 9)
    a.writer.sense(scans)
    pair.run(1.0)
    assert pair.digests() == {truth()}
    a.open_session(child(b"a.second", SESSION)).sense(moved(scans))
    pair.run(1.0)
    assert pair.digests() == {truth(moved(scans))}


def test_who_comes_late_learns_what_replaced_what_and_fetches_only_what_counts():
    pair = Pair()
    a = pair.robot("a")
    pair.observer("o")
    scans = some_scans(1, 9)
    a.writer.sense(scans)
    pair.run(1.0)
    for parent, session in ((SESSION, b"a.second"), (b"a.second", b"a..third")):
        a.open_session(child(session, parent)).sense(moved(scans))
        pair.run(1.0)
    del pair.traffic[:], pair.peers["a"]
    late = pair.observer("late")
    late.joined("o", pair.now)
    pair.run(5.0)
    assert late.fusion.digest() == truth(moved(scans))
    assert late.descriptors.keys() == {SESSION, b"a.second", b"a..third"}
    assert late.replaced == {SESSION: b"a.second", b"a.second": b"a..third"}
    told = [decode(each.payload) for name, each in pair.traffic if name == "o" and each.topic in {"update", "manifest"}]
    assert {message.session for message in told} == {b"a..third"}


def test_a_session_is_summed_until_all_is_known_of_what_replaces_it():
    """The grandchild alone does not tell that the grandparent is over: summing both would count twice."""
    pair = Pair()
    a, o = pair.robot("a"), pair.observer("o")
    scans = some_scans(1, 9)
    a.writer.sense(scans)
    pair.run(1.0)
    grandchild, second = (
        encode(Session(child(*ids).encode())) for ids in ((b"a..third", b"a.second"), (b"a.second", SESSION))
    )
    o.receive("x", grandchild, pair.now)
    assert o.dropped["unknown_session"] == 1
    assert o.replicas.keys() == {SESSION}
    assert [decode(each.payload) for each in o.poll(pair.now + 0.1) if each.topic == "want"] == [
        Want(b"a.second", -1, 0)
    ]
    o.receive("x", second, pair.now)
    assert o.replicas.keys() == {b"a..third"}
    assert o.fusion.digest() == truth()


def test_a_robot_whose_session_somebody_else_replaces_writes_no_more():
    pair, a, o = following()
    for peer in (a, o):
        peer.receive("x", encode(Session(child(b"a.second", SESSION).encode())), pair.now)
    assert a.writer is None
    assert a.replicas.keys() == {b"a.second"}
    pair.run(1.0)
    assert pair.digests() == {truth()}


@pytest.mark.parametrize(
    ("descriptor", "words"),
    [
        (child(SESSION, None), "known already"),
        (child(b"a.second", b"unknown."), "is not known"),
        (child(b"a.second", SESSION, robot="b"), "which is robot a's"),
        (child(b"a.second", SESSION, rules=OTHER_RULES), "cell size"),
    ],
)
def test_a_session_that_cannot_replace_the_other_is_our_mistake(descriptor, words):
    _, a, _ = following()
    before = snapshot(a)
    with pytest.raises(ValueError, match=words):
        a.open_session(descriptor)
    assert snapshot(a) == before
    assert a.writer.replica.descriptor.session == SESSION


def test_sessions_that_wait_for_another_are_bounded(monkeypatch):
    monkeypatch.setattr(peer_module, "MAX_SESSIONS", 5)
    o = Pair().observer("o")
    for k in range(9):
        o.receive("x", encode(Session(child(bytes([k] * 8), bytes([k + 100] * 8)).encode())), 0.0)
    assert len(o._orphans) == 5
    assert o.dropped == {"unknown_session": 5, "too_many": 4}


def written(descriptor, *batches):
    """A session's messages."""
    replica = Replica(descriptor, raster)
    writer = Writer(replica, raster, mtu=32768)
    yield encode(Session(descriptor.encode()))
    for scans in batches:
        writer.sense(scans)
        for each, _ in writer.updates():
            yield encode(each)


FAMILY = [
    child(SESSION, None),
    child(b"a.second", SESSION),
    child(b"a..third", b"a.second"),
    child(b"a..clone", b"a.second"),
    child(b"thief...", b"a..third", robot="b"),  # another robot's
    child(b"thiefson", b"thief...", robot="b"),
    child(b"stranger", b"a..third", rules=OTHER_RULES),
    child(b"circle.1", b"circle.2"),
    child(b"circle.2", b"circle.1"),
    child(b"unplaced", None, robot="c", start=None),
    child(b"placed..", b"unplaced", robot="c"),
]
EVERYTHING = [
    message for k, each in enumerate(FAMILY) for message in written(each, *(some_scans(3 * k + m, 2) for m in range(3)))
]
EVERYTHING += [
    encode(Control(Control.EVICT, session, revision, b"operator", value))
    for session, revision, value in [
        (SESSION, 1, b"\1"),
        (b"a..clone", 1, b"\0"),
        (b"a..clone", 2, b"\1"),
        (b"a..clone", 3, b"\0"),
        (b"a..third", 2, b"\1"),
        (b"a..third", 1, b"\0"),
    ]
]


def test_whatever_comes_first_all_end_with_the_same_map():
    """What a peer drops because it comes too soon, it hears again, as digests would see to."""

    @settings(max_examples=40)
    @given(st.randoms(use_true_random=False))
    def in_any_order(chance):
        peer = Pair().observer("o")
        for _ in range(5):  # a family of four generations, and then its updates
            chance.shuffle(EVERYTHING)
            for payload in EVERYTHING:
                peer.receive("x", payload, 0.0)
        assert peer.replicas.keys() == {b"a..third", b"a..clone", b"placed.."}
        assert peer.refused.keys() == {b"thief...", b"thiefson", b"stranger"}
        assert peer.replaced == {SESSION: b"a.second", b"a.second": b"a..clone", b"unplaced": b"placed.."}
        assert {replica.state.n for replica in peer.replicas.values()} == {3}
        summed = [[some_scans(3 * k + m, 2) for m in range(3)] for k in (3, 10)]
        assert peer.fusion.digest() == truth(*summed[0], *summed[1])
        outcomes.add((peer.controls.check, frozenset(peer.refused.items())))

    outcomes = set()
    in_any_order()
    assert len(outcomes) == 1
