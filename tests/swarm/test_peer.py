"""One peer and its neighbours: mapping, joining, catching up, repairing."""

import numpy as np
import pytest

from mapping.lattice import TileKey
from mapping.tiles import frozen
from swarm.messages import Digest, Hello, Session, decode, encode
from swarm.session import Descriptor
from tests.swarm.pair import ORION, OTHER_RULES, RULES, START, Pair, damaged, some_scans, truth


def test_two_robots_and_an_observer_have_one_map():
    pair = Pair()
    a, b = pair.robot("a"), pair.robot("b")
    pair.observer("o")
    one, other = some_scans(1, 30), some_scans(2, 20)
    a.writer.sense(one)
    b.writer.sense(other)
    pair.run(1.0)
    assert pair.digests() == {truth(one, other)}


def test_scans_that_come_while_one_waits_go_into_one_update():
    pair = Pair()
    a = pair.robot("a")
    pair.run(0.1)
    for seed in range(5):
        a.writer.sense(some_scans(seed, 1))
    pair.run(0.1)
    assert a.writer.replica.state.n == 1


def test_a_correction_publishes_what_waits_before_it():
    pair = Pair()
    a, o = pair.robot("a"), pair.observer("o")
    scans = some_scans(1, 4)
    a.writer.sense(scans)
    a.correct({TileKey(50, 50): frozen(np.ones((32, 32), np.int32))}, pair.now)
    pair.run(1.0)
    assert len(pair.digests()) == 1
    assert o.replicas[b"a......."].state.n == 2
    assert TileKey(50, 50) in o.fusion.tiles


def test_a_peer_wakes_to_publish_and_not_before():
    pair = Pair()
    a = pair.robot("a")
    a.writer.sense(some_scans(1, 1))
    pair.run(0.0)
    assert a.writer.replica.state.n == 1
    a.writer.sense(some_scans(2, 1))
    assert a.wake_at <= pair.now + 0.05
    a.poll(pair.now + 0.04)
    assert a.writer.replica.state.n == 1
    a.poll(pair.now + 0.05)
    assert a.writer.replica.state.n == 2


def test_the_listener_hears_of_every_update_that_is_applied_once():
    heard = []
    pair = Pair()
    a = pair.robot("a")
    pair.observer("o", listener=lambda descriptor, update: heard.append((descriptor.robot, update.n)))
    for seed in range(10):
        a.writer.sense(some_scans(seed, 2))
        pair.run(0.06)
    assert heard == [("a", n) for n in range(1, 11)]


def test_bytes_are_counted_by_topic():
    pair = Pair()
    a = pair.robot("a")
    a.writer.sense(some_scans(1, 2))
    pair.run(1.0)
    expected = {}
    for _, each in pair.traffic:
        expected[each.topic] = expected.get(each.topic, 0) + len(each.payload)
    assert dict(a.sent_bytes) == expected
    assert expected.keys() == {"hello", "session", "update", "digest"}


def test_a_peer_that_joins_is_greeted_and_told_what_there_is():
    pair = Pair()
    a = pair.robot("a")
    pair.run(60.0)
    a.joined("o", pair.now)
    said = [(each.to, decode(each.payload)) for each in a.poll(pair.now)]
    assert [(to, type(message)) for to, message in said[:2]] == [("o", Hello), ("o", Digest)]
    assert said[1][1].positions() == {b"a.......": 0}
    assert a.wake_at - pair.now <= 0.05


def test_who_is_there_is_known_until_it_leaves():
    pair = Pair()
    a, b = pair.robot("a"), pair.observer("b")
    pair.run(0.1)
    assert a.peers["b"] == Hello(Hello.OBSERVER, b"b", b"test")
    assert b.peers["a"].name == b"a"
    a.left("b", pair.now)
    a.left("nobody", pair.now)
    assert a.peers == {}


def test_a_robot_that_does_not_follow_the_swarms_rules_is_our_mistake():
    peer = Pair().observer("a")
    with pytest.raises(ValueError, match="cell size"):
        peer.open_session(Descriptor("a", bytes(8), OTHER_RULES, ORION, START))


def test_an_mtu_in_which_nothing_fits_is_our_mistake():
    """It used to send parts without content, or none at all."""
    with pytest.raises(ValueError, match="at least 64"):
        Pair(mtu=63).observer("a")


def test_a_session_without_a_start_pose_is_kept_and_served_but_not_summed():
    pair = Pair()
    a, b = pair.robot("a", start=None), pair.robot("b")
    o = pair.observer("o")
    a.writer.sense(some_scans(1, 5))
    scans = some_scans(2, 5)
    b.writer.sense(scans)
    pair.run(1.0)
    assert pair.digests() == {truth(scans)}
    assert o.replicas[b"a......."].state.root() == a.writer.replica.state.root()


def test_peers_that_refuse_each_other_soon_fall_silent():
    """Each used to take the other for one that had missed its session, and to tell it twenty times a second."""
    pair = Pair()
    a, b = pair.robot("a"), pair.robot("b", OTHER_RULES)
    a.writer.sense(some_scans(1, 5))
    b.writer.sense(some_scans(2, 5))
    pair.run(10.0)
    assert a.refused == {b"b.......": "b: cell size 0.02 m, ours is 0.05 m"}
    assert b.refused == {b"a.......": "a: cell size 0.05 m, ours is 0.02 m"}
    before = a.sent_bytes["digest"]
    pair.run(60.0)
    assert a.sent_bytes["digest"] - before < 60 * 20


def test_a_digest_of_many_sessions_goes_through_all_of_them_in_turn():
    pair = Pair(mtu=84)
    o = pair.observer("o")
    for k in range(20):
        descriptor = Descriptor(f"r{k}", bytes([k] * 8), RULES, ORION, START)
        o.receive("x", encode(Session(descriptor.encode())), 0.0)
    pair.run(30.0)
    digests = [decode(each.payload) for _, each in pair.traffic if each.topic == "digest"]
    assert not any(digest.complete for digest in digests)
    seen = [session for digest in digests[:4] for session in digest.positions()]
    assert len(set(seen)) == 20


def test_a_damaged_copy_is_repaired_and_so_is_the_sum():
    """The sum used to lose what the damaged copy had by then, not what it once had added: wrong for good."""
    pair = Pair()
    a, b = pair.robot("a"), pair.robot("b")
    o = pair.observer("o")
    batches = [some_scans(seed, 3) for seed in range(30)]
    other = some_scans(99, 40)
    b.writer.sense(other)
    for n, scans in enumerate(batches):
        a.writer.sense(scans)
        pair.run(0.06)
        if n == 24:
            damaged(o, b"a.......")
            assert not o.replicas[b"a......."].state.sound()
    for key in sorted(a.writer.replica.state.cells):  # touches every tile, so that the damage is found
        cells = a.writer.replica.state.cells[key].copy()
        cells[0, 0] += 1
        a.correct({key: frozen(cells)}, pair.now)
        pair.run(0.1)
    before = o.sent_bytes["need"]
    pair.run(5.0)
    assert o.dropped["bad_check"] >= 1
    assert len(pair.digests()) == 1
    assert o.replicas[b"a......."].state.sound()
    assert o.sent_bytes["need"] == before


def test_repairing_fetches_only_what_is_damaged():
    """The tiles that were kept used to be forgotten at once, for nobody was known yet who could help."""
    pair = Pair()
    a = pair.robot("a")
    o = pair.observer("o")
    for seed in range(40):
        a.writer.sense(some_scans(seed, 3))
        pair.run(0.06)
    tiles = len(o.replicas[b"a......."].state.cells)
    key = min(o.replicas[b"a......."].state.cells)
    damaged(o, b"a.......", key)
    cells = a.writer.replica.state.cells[key].copy()
    cells[0, 0] += 1
    a.correct({key: frozen(cells)}, pair.now)
    pair.run(3.0)
    needs = [decode(each.payload) for _, each in pair.traffic if each.topic == "need"]
    assert len(pair.digests()) == 1
    assert sum(len([*need.wanted()]) for need in needs) == 1 < tiles
