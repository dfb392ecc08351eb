"""Whatever the wire brings, a peer takes it whole or drops it."""

import random
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.lattice import TileKey
from mapping.pose import QuantisedPose
from mapping.tiles import frozen
from swarm.drops import REASONS, Drop
from swarm.messages import Manifest, Mark, Part, decode, encode
from swarm.session import Descriptor
from tests.swarm.pair import ORION, RULES, SESSION, START, Pair, snapshot, some_scans, truth


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
