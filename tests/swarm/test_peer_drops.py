"""Every reason for which a peer drops something, and the bounds of what it keeps."""

import numpy as np
import pytest

from mapping.lattice import TileKey
from swarm import limits
from swarm import peer as peer_module
from swarm.drops import REASONS
from swarm.limits import MAX_MESSAGE, MAX_N, MAX_PENDING
from swarm.messages import (
    REFUSED,
    Control,
    Digest,
    Hello,
    Manifest,
    Need,
    Session,
    TilesMessage,
    Update,
    Want,
    decode,
    encode,
)
from swarm.session import Descriptor
from swarm.tile_block import encode_tile
from tests.swarm.pair import ORION, OTHER_RULES, RULES, SESSION, START, Pair, following, snapshot, some_scans


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
    monkeypatch.setattr("swarm.pursuits.MAX_SESSIONS", 5)
    o = Pair().observer("o")
    o.receive("x", encode(Digest.of([(bytes([k] * 8), 9) for k in range(9)], complete=True)), 0.0)
    assert len(o._pursuits) == 5
