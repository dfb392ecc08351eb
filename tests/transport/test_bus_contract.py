"""What every bus promises, asked of each of them over perfect links."""

from __future__ import annotations

import threading
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from transport.bus import Event, Joined, Left, Message


def test_a_publish_reaches_everybody_but_its_sender(harness):
    a, b, c = harness.swarm("a", "b", "c")
    a.publish("news", b"hello")
    assert harness.messages(b, 1) == [Message("a", b"hello")]
    assert harness.messages(c, 1) == [Message("a", b"hello")]
    b.publish("news", b"marker")
    assert harness.messages(a, 1) == [Message("b", b"marker")]


def test_a_send_reaches_one_peer_only(harness):
    a, b, c = harness.swarm("a", "b", "c")
    a.send("b", b"for you")
    a.publish("news", b"for all")
    assert set(harness.messages(b, 2)) == {Message("a", b"for you"), Message("a", b"for all")}
    assert harness.messages(c, 1) == [Message("a", b"for all")]


def test_a_send_to_nobody_or_to_oneself_is_lost_without_an_error(harness):
    a, b = harness.swarm("a", "b")
    a.send("nobody", b"lost")
    a.send("a", b"lost")
    a.send("b", b"marker")
    b.send("a", b"marker")
    assert harness.messages(b, 1) == [Message("a", b"marker")]
    assert harness.messages(a, 1) == [Message("b", b"marker")]


def test_payloads_arrive_unchanged(harness):
    a, b = harness.swarm("a", "b")

    @settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
    @given(payload=st.binary(max_size=2_000), directly=st.booleans())
    def arrives(payload: bytes, directly: bool) -> None:
        if directly:
            a.send("b", payload)
        else:
            a.publish("news", payload)
        assert harness.messages(b, 1) == [Message("a", payload)]

    arrives()


def test_payloads_of_any_length_up_to_the_mtu_arrive(harness):
    a, b = harness.swarm("a", "b")
    for length in (0, 1, 255, 256, 1_499, 1_500, 8_191, a.mtu // 2, a.mtu - 1, a.mtu):
        payload = bytes(k * k % 251 for k in range(length))
        a.publish("news", payload)
        a.send("b", payload)
        assert harness.messages(b, 2) == [Message("a", payload)] * 2


def test_a_payload_longer_than_the_mtu_is_our_mistake(harness):
    a, _ = harness.swarm("a", "b")
    with pytest.raises(ValueError, match=f"expected at most {a.mtu} bytes, got {a.mtu + 1}"):
        a.publish("news", bytes(a.mtu + 1))
    with pytest.raises(ValueError, match="payload"):
        a.send("b", bytes(a.mtu + 1))
    assert not a.counters


@pytest.mark.parametrize("name", ["", "*", "**", "$*", "@x", "a/b", "a b", "a?b", "a#b", "ü", "x" * 65, "a\n"])
def test_a_name_that_is_no_name_is_our_mistake(harness, name):
    with pytest.raises(ValueError, match="peer: expected 1 to 64 letters"):
        harness.join(name)
    bus = harness.join("a")
    with pytest.raises(ValueError, match="topic"):
        bus.publish(name, b"")
    with pytest.raises(ValueError, match="peer"):
        bus.send(name, b"")
    assert not bus.counters


def test_a_peer_that_comes_is_told_to_all_and_all_are_told_to_it(harness):
    a, b = harness.swarm("a", "b")
    c = harness.join("c")
    assert set(harness.receive_until(c, lambda events: len(set(events)) == 2)) == {Joined("a"), Joined("b")}
    for bus in (a, b):
        assert set(harness.receive_until(bus, bool)) == {Joined("c")}


def test_a_peer_that_leaves_is_told(harness):
    a, b = harness.swarm("a", "b")
    b.close()
    assert harness.receive_until(a, bool) == [Left("b")]


def test_a_peer_that_comes_back_is_told_again(harness):
    a, b = harness.swarm("a", "b")
    b.close()
    again = harness.join("b")
    assert harness.receive_until(a, lambda events: Joined("b") in events) == [Left("b"), Joined("b")]
    harness.receive_until(again, lambda events: Joined("a") in events)
    a.send("b", b"welcome back")
    assert harness.messages(again, 1) == [Message("a", b"welcome back")]


def test_what_answers_a_joined_arrives_on_both_sides(harness):
    """The first digest is the answer to a Joined: were it lost, a newcomer would wait for the next one."""
    a = harness.join("a")
    for round_number in range(10):
        b = harness.join(f"b{round_number}")
        seen = {}
        for one, other in ((a, b), (b, a)):
            seen[one] = harness.receive_until(one, lambda events, peer=other.peer: Joined(peer) in events)
            one.send(other.peer, b"digest")
            one.publish("digest", b"digest")
        for one, other in ((a, b), (b, a)):
            answers = [Message(other.peer, b"digest")] * 2
            early = [event for event in seen[one] if isinstance(event, Message)]
            assert early + harness.messages(one, 2 - len(early)) == answers
        b.close()
        harness.receive_until(a, lambda events, peer=b.peer: Left(peer) in events)


def test_closing_twice_is_fine_and_nothing_works_afterwards(harness):
    a, b = harness.swarm("a", "b")
    b.publish("news", b"unread")
    harness.wait_until(lambda: a.counters["received"] == 1, idle=b)
    a.close()
    a.close()
    assert a.receive(timeout=10.0) == []
    with pytest.raises(RuntimeError, match="closed"):
        a.publish("news", b"")
    with pytest.raises(RuntimeError, match="closed"):
        a.send("b", b"")


def test_a_with_statement_closes_the_bus_on_an_error_too(harness):
    a, b = harness.swarm("a", "b")
    with pytest.raises(LookupError), b:
        raise LookupError
    assert harness.receive_until(a, bool) == [Left("b")]


def test_the_counters_add_up(harness):
    a, b, c = harness.swarm("a", "b", "c")
    a.publish("news", b"12345")
    a.publish("olds", b"")
    a.send("b", b"123")
    harness.messages(b, 3)
    harness.messages(c, 2)
    assert a.counters == {"published": 2, "sent": 1, "bytes_sent": 8}
    assert b.counters == {"received": 3, "bytes_received": 8}
    assert c.counters == {"received": 2, "bytes_received": 5}


def test_a_full_inbox_keeps_the_newest_messages_and_all_presence_and_counts_the_rest(harness):
    a = harness.join("a")
    b = harness.join("b", max_messages=10)
    harness.receive_until(a, lambda events: Joined("b") in events)
    for number in range(50):
        a.publish("news", b"%d" % number)
    harness.wait_until(lambda: b.counters["received"] == 50, idle=a)
    events = harness.receive_until(b, bool)
    assert Joined("a") in events
    assert [e for e in events if isinstance(e, Message)] == [Message("a", b"%d" % n) for n in range(40, 50)]
    assert b.counters["dropped_inbox_full"] == 40


def test_a_slow_reader_does_not_hold_up_a_publisher(harness):
    a, _never_reads, c = harness.swarm("a", "slow", "c")
    before = time.monotonic()
    for _ in range(3_000):
        a.publish("news", bytes(1_000))
    assert time.monotonic() - before < 10.0

    def a_marker_got_through(events: list[Event]) -> bool:
        a.send("c", b"marker")  # again and again: a bus may drop what comes too fast
        return Message("a", b"marker") in events

    received = harness.receive_until(c, a_marker_got_through)
    assert Message("a", bytes(1_000)) in received


def test_one_senders_payloads_keep_their_order_over_a_perfect_link(harness):
    a, b = harness.swarm("a", "b")
    for number in range(300):
        a.publish("news", b"%d" % number)
    assert harness.messages(b, 300) == [Message("a", b"%d" % number) for number in range(300)]


def test_a_reader_that_waits_is_woken_by_its_own_close(harness):
    """Shutting down must not take as long as the longest wait."""
    (bus,) = harness.swarm("a")
    closer = threading.Timer(0.05, bus.close)
    closer.start()
    before = time.monotonic()
    assert bus.receive(timeout=10.0) == []
    assert time.monotonic() - before < 5.0
    closer.join()
