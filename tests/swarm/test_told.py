"""What a peer came to hold, told: whoever hears it holds the same, and never anything that was not true."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import quantise
from mapping.sensor import orion
from swarm.drops import Drop
from swarm.messages import Hello, Manifest, Need, Session, TilesMessage, Update, encode
from swarm.peer import Peer
from swarm.session import Descriptor, Rules
from swarm.told import Jump, Teller, retold

RULES = Rules(Lattice(50), EvidenceModel())


def a_peer(name="o", **more):
    return Peer(Hello(Hello.OBSERVER, name.encode(), b"test"), RULES, seed=name.encode(), mtu=32_768, now=0.0, **more)


def descriptor(robot, session, replaces=None):
    return Descriptor(robot, session * 8, RULES, orion(), QuantisedPose(0, 0, 0), replaces and replaces * 8)


class Robot:
    """Publishes one scan an update."""

    def __init__(self, robot, session):
        self.peer = a_peer(robot)
        self.turns = 0
        self.open(robot, session)

    def open(self, robot, session, replaces=None):
        self.writer = self.peer.open_session(descriptor(robot, session, replaces))

    def publish(self, count):
        for _ in range(count):
            self.turns += 1
            place = [[0.1 * self.turns, 0.0, 0.1 * self.turns]]
            self.writer.sense(quantise([float(self.turns)], place, [[0.2 + 0.01 * (self.turns % 50)] * 5], orion()))
            self.peer.flush(float(self.turns))


def bring(source, peer, *, jump=False):
    """Hand a peer what another one holds: updates one by one as far as they are kept, or checkpoints."""
    for session, known in source.descriptors.items():
        if session not in peer.descriptors:
            peer.receive("x", encode(Session(known.encode())), 0.0)
    for session, replica in source.replicas.items():
        mine = peer.replicas[session]
        if jump and replica.checkpoint.n > mine.state.n:
            peer._jump(session, replica.checkpoint, 0.0)
        for update in replica.updates_after(mine.state.n):
            peer.receive("x", encode(update), 0.0)


def hearer_of(messages):
    peer = a_peer("h")
    for told in retold(messages):
        peer.repeat(told, 0.0)
    assert not peer.dropped
    return peer


def same(a, b):
    assert a.fusion.digest() == b.fusion.digest()
    assert a.descriptors.keys() == b.descriptors.keys()
    assert a.controls.check == b.controls.check
    assert {s: (r.state.n, r.state.root()) for s, r in a.replicas.items()} == {
        s: (r.state.n, r.state.root()) for s, r in b.replicas.items()
    }


steps = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.integers(1, 45)),
        st.tuples(st.sampled_from(["follow", "jump", "tell", "evict", "readmit", "replace"]), st.just(0)),
    ),
    max_size=8,
)


@settings(max_examples=15)
@given(steps)
@example([("publish", 36), ("jump", 0), ("publish", 4)])  # who jumps shares nothing with who goes on
def test_whoever_hears_it_all_holds_the_same(script):
    messages = []
    teller = None
    observer = a_peer(listener=lambda descriptor, update: messages.extend(teller.applied(update)))
    teller = Teller(observer)
    robot, session = Robot("r1", b"\x01"), 1
    for verb, count in script:
        match verb:
            case "publish":
                robot.publish(count)
            case "follow" | "jump":
                bring(robot.peer, observer, jump=verb == "jump")
            case "tell":
                messages.extend(teller.news())
            case "evict":
                observer.evict(b"\x01" * 8, 0.0)
            case "readmit":
                observer.readmit(b"\x01" * 8, 0.0)
            case "replace":
                robot.open("r1", bytes([session + 1]), bytes([session]))
                session += 1
    messages.extend(teller.news())
    same(hearer_of(messages), observer)
    assert list(teller.news()) == []


def test_a_jump_is_told_by_a_whole_checkpoint():
    robot, observer = Robot("r1", b"\x01"), a_peer()
    robot.publish(50)
    observer.receive("x", encode(Session(robot.writer.replica.descriptor.encode())), 0.0)
    teller = Teller(observer)
    list(teller.news())
    bring(robot.peer, observer, jump=True)
    messages = list(teller.news())
    assert [type(message) for message in messages] == [Manifest, TilesMessage, *[Update] * 10]
    assert [type(told) for told in retold(messages)] == [Jump, *[Update] * 10]


def test_what_is_heard_again_is_said_again_to_all():
    robot = Robot("r1", b"\x01")
    robot.publish(3)
    hearer, third = a_peer("h"), a_peer("t")
    for told in retold(Teller(robot.peer).news()):
        hearer.repeat(told, 0.0)
    for out in hearer.poll(0.0):
        if out.to is None:
            third.receive("h", out.payload, 0.0)
    same(third, robot.peer)


def test_what_does_not_fit_is_dropped_and_never_said():
    robot = Robot("r1", b"\x01")
    robot.publish(3)
    session, *updates = Teller(robot.peer).news()
    hearer = a_peer("h")
    hearer.poll(0.0)
    for message in (updates[0], session, session, updates[2], updates[0]):
        hearer.repeat(message, 0.0)
    assert hearer.dropped == {"unknown_session": 1, "stale": 1, "too_far_ahead": 1}
    assert [out.topic for out in hearer.poll(0.0) if out.topic != "digest"] == ["session", "update"]


def test_tiles_of_nobody_and_wrong_tiles_are_refused():
    robot = Robot("r1", b"\x01")
    robot.publish(25)
    replica = robot.writer.replica
    manifest = replica.manifest(0)
    wanted = [(key, mark.hash) for key, mark in replica.checkpoint.marks.items()]
    (tiles,) = replica.supply(Need(manifest.session, manifest.n, 0, Need.pack(wanted)), 32_768)
    with pytest.raises(Drop) as caught:
        list(retold([tiles]))
    assert caught.value.reason == "not_asked"
    newer = Robot("r1", b"\x01")
    newer.publish(25)
    key = next(iter(newer.writer.replica.checkpoint.marks))
    newer.writer.replica.checkpoint.cells[key] = np.full((32, 32), 7, np.int32)
    (wrong,) = newer.writer.replica.supply(Need(manifest.session, manifest.n, 0, Need.pack(wanted)), 32_768)
    with pytest.raises(Drop) as caught:
        list(retold([manifest, wrong]))
    assert caught.value.reason == "bad_hash"
