import random
import time
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.raster import raster
from mapping.scan import Scans
from mapping.sensor import orion
from mapping.tiles import frozen, map_digest
from swarm import limits
from swarm import peer as peer_module
from swarm.drops import REASONS, Drop
from swarm.limits import MAX_MESSAGE, MAX_N, MAX_PENDING
from swarm.messages import (
    REFUSED,
    AskControls,
    Control,
    Digest,
    Hello,
    Manifest,
    Mark,
    Need,
    Part,
    Session,
    TilesMessage,
    Update,
    Want,
    decode,
    encode,
)
from swarm.peer import Peer
from swarm.replica import Replica
from swarm.session import Descriptor, Rules
from swarm.tile_block import encode_tile
from swarm.writer import Writer

RULES = Rules(Lattice(50), EvidenceModel())
OTHER_RULES = Rules(Lattice(20), EvidenceModel())
ORION = orion()
START = QuantisedPose(0, 0, 0)


def some_scans(seed, count):
    chance = np.random.default_rng(seed)
    poses = np.column_stack([np.cumsum(chance.integers(-40, 60, (count, 2)), axis=0), chance.integers(0, 65536, count)])
    ranges = chance.integers(0, 801, (count, 5))
    return Scans(np.arange(count, dtype=np.int64) * 100, poses.astype(np.int32), ranges.astype(np.uint16))


class Pair:
    """Peers by name, a clock, and messages that travel when they are told to."""

    def __init__(self, mtu=32768):
        self.now = 0.0
        self.mtu = mtu
        self.peers = {}
        self.traffic = []

    def observer(self, name, rules=RULES, **more):
        hello = Hello(Hello.OBSERVER, name.encode(), b"test")
        self.peers[name] = Peer(hello, rules, seed=name.encode(), mtu=self.mtu, now=self.now, **more)
        return self.peers[name]

    def robot(self, name, rules=RULES, start=START, publish="auto"):
        peer = self.observer(name, rules)
        peer.open_session(Descriptor(name, name.encode().ljust(8, b"."), rules, ORION, start), publish)
        return peer

    def run(self, seconds):
        """Deliver everything, as often as somebody wants to speak."""
        end = self.now + seconds
        while True:
            queue = deque()
            for name, peer in self.peers.items():
                queue += [(name, each) for each in peer.poll(self.now)]
            for name, each in queue:
                self.traffic.append((name, each))
                for other, peer in self.peers.items():
                    if other != name and each.to in {None, other}:
                        peer.receive(name, each.payload, self.now)
            following = max(self.now, min(peer.wake_at for peer in self.peers.values()))
            if not queue and following > end:
                self.now = end
                return
            if not queue:
                self.now = following

    def digests(self):
        return {peer.fusion.digest() for peer in self.peers.values()}


def truth(*batches):
    tiles = {}
    for scans in batches:
        tiles |= integrated(tiles, scans, ORION, RULES.model, RULES.lattice)
    return map_digest(tiles)


def snapshot(peer):
    """All that a peer believes about maps."""
    return (
        peer.fusion.digest(),
        {session: (replica.state.n, replica.state.root()) for session, replica in peer.replicas.items()},
        dict(peer.refused),
        dict(peer.replaced),
        [*peer.controls],
    )


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


def damaged(peer, session, key=None):
    """Flip a bit of one tile in memory."""
    cells = peer.replicas[session].state.cells
    key = key or min(cells)
    wrong = cells[key].copy()
    wrong[5, 5] ^= 64
    cells[key] = frozen(wrong)


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


# --- every reason


def following():
    """An observer that follows a robot, and the robot."""
    pair = Pair()
    a, o = pair.robot("a"), pair.observer("o")
    a.writer.sense(some_scans(1, 3))
    pair.run(1.0)
    return pair, a, o


SESSION = b"a......."


def update(n, form=Update.TILES, payload=b"", check=0, session=SESSION):
    return encode(Update(session, n, form, payload, b"", check))


def session_message(name="x", session=b"x" * 8, rules=RULES):
    return encode(Session(Descriptor(name, session, rules, ORION, START).encode()))


def behind():
    """An observer far behind a robot's session, which has just asked for it; and the manifest it gets."""
    pair, a, o = following()
    for seed in range(60):
        a.writer.sense(some_scans(seed, 1))
        a.poll(pair.now + seed)
    replica = a.writer.replica
    pair.now += 100
    o.receive("a", encode(Digest.of([(SESSION, replica.state.n)], complete=True)), pair.now)
    o.poll(pair.now + 0.1)
    return o, replica, pair.now + 0.1


def bad_hash(o):
    o, replica, now = behind()
    o.receive("a", encode(replica.manifest(1)), now)
    o.poll(now)
    key = next(iter(replica.checkpoint.cells))
    o.receive("a", encode(TilesMessage(SESSION, encode_tile(key, np.ones((32, 32), np.int32)))), now)
    return o


def bad_root(o):
    o, replica, now = behind()
    manifest = replica.manifest(0)
    o.receive("a", encode(Manifest(SESSION, manifest.n, 0, bytes(16), manifest.entries)), now)
    [(_, _, request)] = [each for each in o.poll(now) if each.topic == "need"]
    for message in replica.supply(decode(request), 32768):
        o.receive("a", encode(message), now)
    return o


def too_far_ahead(o):
    for n in range(MAX_PENDING + 1):
        o.receive("a", update(n + 5), 2.0)
    return o


def too_many(o):
    for k in range(limits.MAX_SESSIONS + 1):
        o.receive("x", session_message(session=k.to_bytes(8, "big")), 2.0)
    return o


def replaced_session(o):
    o.receive("a", encode(Session(Descriptor("a", b"another.", RULES, ORION, START, SESSION).encode())), 2.0)
    assert SESSION not in o.replicas
    o.receive("a", update(2), 2.0)
    return o


def own_session(o):
    _, a, _ = following()
    a.receive("x", update(2), 2.0)
    return a


HOW = {
    "too_long": [bytes(MAX_MESSAGE + 1)],
    "not_msgpack": [b"\xc1"],
    "other_version": [b"\x93\x02\x01\x01"],
    "unknown_kind": [b"\x93\x01\x63\x01"],
    "bad_shape": [b"\x93\x01\x04\x01"],
    "out_of_range": [b"\x95\x01\x04\xc4\x00\x00\x00"],
    "bad_part": [b"\x96\x01\x09\xc4\x08" + bytes(8) + b"\x05\x05\xc4\x01\x00"],
    "bad_descriptor": [encode(Session(b"descriptor"))],
    "bad_control": [encode(Control(Control.EVICT, SESSION, 1, bytes(8), b"\2"))],
    "bad_payload": [update(2, payload=b"x")],
    "bad_check": [update(2, check=1)],
    "bad_hash": bad_hash,
    "bad_root": bad_root,
    "not_asked": [encode(TilesMessage(SESSION, b"x"))],
    "stale": [update(1)],
    "too_far_ahead": too_far_ahead,
    "unknown_session": [update(1, session=b"unknown.")],
    "refused_session": [session_message(rules=OTHER_RULES)],
    "replaced_session": replaced_session,
    "own_session": own_session,
    "too_many": too_many,
}


def test_there_is_a_way_to_every_reason():
    assert HOW.keys() == REASONS.keys()


@pytest.mark.parametrize("reason", REASONS)
def test_every_reason_is_reached_and_counted_and_nothing_is_half_applied(reason):
    pair, _, o = following()
    how = HOW[reason]
    if callable(how):
        o = how(o)
    else:
        before = snapshot(o)
        for payload in how:
            o.receive("a", payload, pair.now)
        fusion, states, *_ = snapshot(o)
        assert (fusion, states) == before[:2]
    assert o.dropped[reason] >= 1
    assert all(replica.state.sound() for replica in o.replicas.values())


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (session_message("a", SESSION), "bad_descriptor"),  # another one: it starts elsewhere
        (update(1, session=b"refused."), "refused_session"),
        (encode(Want(b"unknown.", 0, 0)), "unknown_session"),
        (encode(Need(b"unknown.", 1, 0, Need.pack([(TileKey(0, 0), 1)]))), "unknown_session"),
        (encode(Manifest(SESSION, 20, 0, bytes(16), b"")), "not_asked"),
    ],
)
def test_other_ways_to_be_dropped(payload, reason):
    pair, _, o = following()
    o.receive("x", session_message("r", b"refused.", OTHER_RULES), pair.now)
    if reason == "bad_descriptor":
        payload = encode(Session(Descriptor("a", SESSION, RULES, ORION, None).encode()))
    o.dropped.clear()
    before = snapshot(o)
    o.receive("a", payload, pair.now)
    assert dict(o.dropped) == {reason: 1}
    assert snapshot(o) == before


def test_a_descriptor_that_is_known_is_stale():
    pair, a, o = following()
    o.receive("x", encode(Session(a.writer.replica.descriptor.encode())), pair.now)
    o.receive("x", session_message("r", b"refused.", OTHER_RULES), pair.now)
    o.dropped.clear()
    o.receive("x", session_message("r", b"refused.", OTHER_RULES), pair.now)
    o.receive("x", encode(Session(a.writer.replica.descriptor.encode())), pair.now)
    assert dict(o.dropped) == {"refused_session": 1, "stale": 1}


def test_somebody_else_who_knows_more_of_our_session_than_we_is_counted_and_not_believed():
    _, a, _ = following()
    a.receive("x", encode(Digest.of([(SESSION, 7)], complete=True)), 2.0)
    assert a.dropped["own_session"] == 1
    assert all(each.topic != "want" for each in a.poll(9.0))


@pytest.mark.parametrize("n", [REFUSED, MAX_N + 1])
def test_a_number_beyond_all_updates_in_a_digest_is_not_pursued(n):
    pair, _, o = following()
    o.receive("x", encode(Digest.of([(SESSION, n), (b"unknown.", n)], complete=False)), pair.now)
    assert all(each.topic != "want" for each in o.poll(pair.now + 1.0))


def test_a_peer_that_lags_is_told_at_once_only_if_the_news_are_no_longer_on_their_way():
    pair, a, _ = following()
    pair.run(60.0)
    a.writer.sense(some_scans(7, 1))
    a.poll(pair.now)
    lagging = encode(Digest.of([(SESSION, 1)], complete=True))
    for moment, quick in ((0.1, False), (0.3, True)):
        a._settled_at = None  # leave that other reason to be quick aside
        a.receive("o", lagging, pair.now + moment)
        assert (a.wake_at - pair.now - moment <= 0.05) == quick


def test_names_of_peers_are_bounded(monkeypatch):
    monkeypatch.setattr(peer_module, "MAX_SESSIONS", 5)
    o = Pair().observer("o")
    for k in range(9):
        o.receive(f"x{k}", encode(Hello(Hello.ROBOT, b"x", b"")), 0.0)
    assert len(o.peers) == 5
    assert o.dropped["too_many"] == 4
    o.receive("x0", encode(Hello(Hello.OBSERVER, b"x", b"")), 0.0)
    assert o.peers["x0"].role == Hello.OBSERVER


def test_unknown_sessions_that_are_told_of_are_bounded(monkeypatch):
    monkeypatch.setattr(peer_module, "MAX_SESSIONS", 5)
    o = Pair().observer("o")
    o.receive("x", encode(Digest.of([(bytes([k] * 8), 9) for k in range(9)], complete=True)), 0.0)
    assert len(o._catch_ups) == 5


# --- operators' decisions


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


# --- whatever the wire brings


@settings(max_examples=100)
@given(st.lists(st.binary(max_size=60), max_size=20))
def test_garbage_is_counted_and_nothing_else(garbage):
    o = Pair().observer("o")
    before = snapshot(o)
    for payload in garbage:
        o.receive("x", payload, 0.0)
    assert snapshot(o) == before
    assert o.dropped.total() == len(garbage)


def traffic_of_a_swarm():
    """Everything that is said while robots map, somebody comes late, and parts are needed."""
    pair = Pair(mtu=350)
    a, b = pair.robot("a"), pair.robot("b", publish="tiles")
    for seed in range(45):
        a.writer.sense(some_scans(seed, 2))
        b.writer.sense(some_scans(seed + 100, 1))
        pair.run(0.06)
    tiles = {key: frozen(cells // 2) for key, cells in a.writer.replica.state.cells.items()}
    a.correct(tiles, pair.now)
    b.evict(SESSION, pair.now)
    a.set_start_pose("b", QuantisedPose(1, 2, 3), pair.now)
    b.open_session(Descriptor("b", b"b.second", RULES, ORION, START, b"b......."), "tiles").sense(some_scans(7, 3))
    pair.run(1.0)
    for name in ("a", "b"):
        pair.observer("late").joined(name, pair.now)
        pair.peers[name].joined("late", pair.now)
    pair.run(3.0)
    assert len(pair.digests()) == 1
    return pair, [(name, each.payload) for name, each in pair.traffic]


def mutated(payload, chance):
    """A payload with a few bits, bytes or stretches changed."""
    wire = bytearray(payload)
    for _ in range(chance.choice((1, 1, 2, 5))):
        at = chance.randrange(len(wire) + 1)
        match chance.randrange(5):
            case 0 if wire:
                wire[at % len(wire)] ^= 1 << chance.randrange(8)
            case 1 if wire:
                wire[at % len(wire)] = chance.choice((0, 1, 127, 128, 255, chance.randrange(256)))
            case 2:
                del wire[at : at + chance.randrange(1, 9)]
            case 3:
                wire[at:at] = chance.randbytes(chance.randrange(1, 9))
            case _:
                wire[at:at] = payload[chance.randrange(len(payload)) :][:40]
    return bytes(wire)


def test_tens_of_thousands_of_changed_frames_of_a_real_swarm_raise_nothing_and_break_nothing():
    pair, traffic = traffic_of_a_swarm()
    chance = random.Random(1)
    peers = [pair.peers["late"], pair.peers["a"], Pair(mtu=300).observer("new")]
    assert {decode(payload).KIND for _, payload in traffic} == {*range(1, 12)}
    now, begin = pair.now, time.process_time()
    frames = 0
    while frames < 20_000:
        name, payload = chance.choice(traffic)
        wire = payload if chance.random() < 0.2 else mutated(payload, chance)
        for peer in peers:
            peer.receive(name, wire, now)
            peer.poll(now)
            frames += 1
        now += 0.003
    assert time.process_time() - begin < 60
    dropped = sum((peer.dropped for peer in peers), start=type(peers[0].dropped)())
    assert len(dropped) >= 10
    for peer in peers:
        assert all(replica.state.sound() for replica in peer.replicas.values())
        again = type(peer.fusion)()
        again.rebuild(peer._maps())
        assert again.digest() == peer.fusion.digest()


def test_nothing_but_a_drop_ever_comes_out_of_decoding_and_its_reason_has_a_name():
    with pytest.raises(AssertionError):
        Drop("no such reason")
    assert all(str(Drop(reason)) == words for reason, words in REASONS.items())


def test_marks_of_a_manifest_survive_the_wire():
    manifest = Manifest(SESSION, 20, 0, bytes(16), Manifest.pack({TileKey(-1, 2): Mark(7, 9)}))
    assert decode(encode(manifest)).marks() == {TileKey(-1, 2): Mark(7, 9)}


def test_a_message_in_parts_is_taken_like_any_other():
    pair = Pair(mtu=64)
    a, o = pair.robot("a"), pair.observer("o")
    scans = some_scans(1, 3)
    a.writer.sense(scans)
    pair.run(3.0)
    assert any(type(decode(each.payload)) is Part for _, each in pair.traffic)
    assert o.fusion.digest() == truth(scans)
