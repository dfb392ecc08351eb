"""What only the ZeroMQ bus can get wrong: strangers on its port, neighbours that stop reading, links that come back."""

from __future__ import annotations

import os
import signal
import time
from contextlib import ExitStack

import pytest
import zmq

from transport.bus import Joined, Left, Message
from transport.zmq_bus import ZmqBus

pytestmark = pytest.mark.processes


@pytest.fixture
def wire(zmq_harness):
    """What the other processes speak."""
    return zmq_harness


@pytest.fixture
def stranger():
    """Connects a DEALER of its own, to say what no peer of ours would."""
    with ExitStack() as stack:
        context = stack.enter_context(zmq.Context())

        def connect(endpoint: str) -> zmq.Socket[bytes]:
            made = stack.enter_context(context.socket(zmq.DEALER))
            made.connect(endpoint.replace("/", "://", 1))
            return made

        yield connect


def test_what_strangers_say_is_dropped_and_counted(zmq_harness, free_endpoint, stranger):
    endpoint = free_endpoint()
    with ZmqBus("test", "a", listen=[endpoint], connect=[], mtu=100) as a:
        somebody = stranger(endpoint)
        for frames in (
            [b"GET / HTTP/1.1"],
            [b"", b"", b""],
            [b"orion/other/b/alive"],
            [b"orion/test/a/alive"],
            [b"orion/test/b/to/c x"],
            [b"orion/test/b/news " + bytes(101)],
            [b"orion/test/b/news fine"],
        ):
            somebody.send_multipart(frames)
        assert zmq_harness.receive_until(a, bool) == [Message("b", b"fine")]
        assert a.counters == {
            "received": 1,
            "bytes_received": 4,
            "dropped_malformed": 2,
            "dropped_other_swarm": 1,
            "dropped_own_name": 1,
            "dropped_not_for_us": 1,
            "dropped_too_long": 1,
        }


def test_a_neighbour_that_stops_is_missed_and_holds_nobody_up(zmq_harness, free_endpoint, peer_process):
    """Stopped, not dead: its kernel still takes bytes for it."""
    endpoint = free_endpoint()
    process = peer_process("sleeper", listen=endpoint)
    with ZmqBus("test", "me", listen=[], connect=[endpoint]) as me:
        zmq_harness.receive_until(me, lambda events: Joined("sleeper") in events)
        os.kill(process.pid, signal.SIGSTOP)
        for _ in range(3_000):
            me.publish("news", bytes(20_000))
        zmq_harness.wait_until(
            lambda: me.counters["dropped_link_full"] + me.counters["dropped_queue_full"] > 0, idle=me
        )
        zmq_harness.receive_until(me, lambda events: Left("sleeper") in events)
        os.kill(process.pid, signal.SIGCONT)
        zmq_harness.receive_until(me, lambda events: Joined("sleeper") in events)
        me.send("sleeper", b"marker")
        zmq_harness.receive_until(me, lambda events: Message("sleeper", b"echo marker") in events)


def test_closing_beside_a_mute_neighbour_is_bounded(zmq_harness, free_endpoint, peer_process):
    endpoint = free_endpoint()
    process = peer_process("mute", listen=endpoint)
    with ZmqBus("test", "me", listen=[], connect=[endpoint]) as me:
        zmq_harness.receive_until(me, lambda events: Joined("mute") in events)
        os.kill(process.pid, signal.SIGSTOP)
        for _ in range(1_000):
            me.publish("news", bytes(30_000))
        before = time.monotonic()
    assert time.monotonic() - before < 5.0
    os.kill(process.pid, signal.SIGCONT)


@pytest.mark.parametrize(("speaker", "listener"), [(0, 1), (1, 0)])
def test_what_was_said_last_arrives_though_the_bus_closes_at_once(zmq_harness, speaker, listener):
    """Once a link that broke took with it what had come over it, and once the whole process."""
    swarm = zmq_harness.swarm("a", "b")
    one, other = swarm[speaker], swarm[listener]
    for number in range(500):
        one.publish("news", b"%d" % number)
    one.close()
    events = zmq_harness.receive_until(other, lambda events: Left(one.peer) in events)
    events += zmq_harness.messages(other, 500 - len(events) + 1) if len(events) < 501 else []
    assert [e for e in events if e != Left(one.peer)] == [Message(one.peer, b"%d" % number) for number in range(500)]


def test_what_was_meant_for_a_dead_peer_does_not_reach_its_successor(zmq_harness, free_endpoint, peer_process):
    endpoint = free_endpoint()
    with ZmqBus("test", "me", listen=[], connect=[endpoint]) as me:
        process = peer_process("old", listen=endpoint)
        zmq_harness.receive_until(me, lambda events: Joined("old") in events)
        process.kill()
        process.wait()
        for _ in range(10):
            me.send("old", b"secret")
            me.publish("news", b"old news")
        peer_process("new", listen=endpoint)
        zmq_harness.receive_until(me, lambda events: Joined("new") in events)
        me.send("new", b"marker")
        events = zmq_harness.receive_until(me, lambda events: Message("new", b"echo marker") in events)
        assert [event.payload for event in events if isinstance(event, Message)][-1] == b"echo marker"
        assert Message("new", b"echo secret") not in events
        assert Message("new", b"echo old news") not in events
