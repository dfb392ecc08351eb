"""The network of one process: what its seed decides, and what it does to payloads on purpose."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from transport.bus import Joined, Left, Message
from transport.in_process import Link, Network


def payloads(bus):
    return [event.payload for event in bus.receive() if isinstance(event, Message)]


def run(seed, **link):
    """What c hears and when, of a hundred publishes each by a and b."""
    network = Network(seed, **link)
    a, b, c = (network.bus(peer) for peer in "abc")
    heard = []
    for number in range(100):
        a.publish("news", b"a%d" % number)
        b.publish("news", b"b%d" % number)
        network.advance(network.now + 0.05)
        heard.append(c.receive())
    while (due := network.next_event()) is not None:
        network.advance(due)
        heard.append((network.now, c.receive()))
    return heard, network.counters


BAD_LINK = {"loss": 0.3, "duplicate": 0.1, "delay": (0.01, 0.5)}


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**64))
def test_the_same_seed_gives_the_same_run(seed):
    assert run(seed, **BAD_LINK) == run(seed, **BAD_LINK)


def test_another_seed_gives_another_run():
    assert run(1, **BAD_LINK) != run(2, **BAD_LINK)


def test_loss_and_duplication_come_at_their_rates():
    network = Network(7, loss=0.2, duplicate=0.1)
    a, b = network.bus("a"), network.bus("b")
    for _ in range(10_000):
        a.publish("news", b"x")
    network.advance(1.0)
    assert network.counters["lost"] == pytest.approx(2_000, rel=0.1)
    assert network.counters["duplicated"] == pytest.approx(800, rel=0.1)
    assert network.counters["delivered"] == 10_000 - network.counters["lost"] + network.counters["duplicated"]
    assert len(payloads(b)) == network.counters["delivered"] == b.counters["received"]


def test_every_payload_is_under_way_for_a_time_within_the_delay():
    network = Network(7, delay=(0.1, 0.3))
    a, b = network.bus("a"), network.bus("b")
    for _ in range(100):
        a.publish("news", b"x")
    network.advance(0.0999)
    assert payloads(b) == []
    network.advance(0.2)
    assert 0 < len(payloads(b)) < 100
    network.advance(0.3)
    assert network.next_event() is None
    assert b.counters["received"] == 100


def test_payloads_with_random_delays_overtake_each_other():
    network = Network(7, delay=(0.0, 1.0))
    a, b = network.bus("a"), network.bus("b")
    sent = [b"%d" % number for number in range(50)]
    for payload in sent:
        a.send("b", payload)
    network.advance(1.0)
    got = payloads(b)
    assert got != sent
    assert sorted(got) == sorted(sent)


def test_the_next_event_is_the_time_of_the_next_delivery():
    network = Network(7, delay=(0.25, 0.25))
    a, b = network.bus("a"), network.bus("b")
    assert network.next_event() is None
    network.advance(2.0)
    a.publish("news", b"x")
    assert network.next_event() == 2.25
    network.advance(2.25)
    assert payloads(b) == [b"x"]
    assert network.next_event() is None


def test_time_does_not_run_backwards():
    network = Network(7)
    network.advance(2.0)
    with pytest.raises(ValueError, match=r"expected 2\.0 or later, got 1\.0"):
        network.advance(1.0)


def test_a_link_can_be_made_worse_while_the_network_runs():
    network = Network(7)
    a, b, c = (network.bus(peer) for peer in "abc")
    network.links["a", "b"] = Link(loss=1.0)
    a.publish("news", b"x")
    b.publish("news", b"y")
    network.advance(1.0)
    assert payloads(b) == []
    assert payloads(c) == [b"x", b"y"]
    assert payloads(a) == [b"y"]
    del network.links["a", "b"]
    network.link = Link(duplicate=1.0)
    a.publish("news", b"z")
    network.advance(2.0)
    assert payloads(b) == [b"z", b"z"]


@pytest.mark.parametrize(
    "wrong", [{"loss": 1.1}, {"loss": -0.1}, {"duplicate": 2.0}, {"delay": (0.2, 0.1)}, {"delay": (-1.0, 0.1)}]
)
def test_a_link_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match="link: expected"):
        Network(7, **wrong)


def test_a_partition_cuts_messages_and_is_told_and_healing_joins_again():
    network = Network(7)
    a, b, c = (network.bus(peer) for peer in "abc")
    for bus in (a, b, c):
        bus.receive()
    network.partition({"a", "b"}, {"c"})
    assert a.receive() == b.receive() == [Left("c")]
    assert c.receive() == [Left("a"), Left("b")]
    a.publish("news", b"islanders only")
    c.send("a", b"cut")
    network.advance(1.0)
    assert payloads(b) == [b"islanders only"]
    assert payloads(a) == payloads(c) == []
    network.heal()
    assert a.receive() == b.receive() == [Joined("c")]
    assert c.receive() == [Joined("a"), Joined("b")]
    c.publish("news", b"again")
    network.advance(2.0)
    assert payloads(a) == payloads(b) == [b"again"]


def test_peers_that_no_island_names_are_on_one_more_island_together():
    network = Network(7)
    a, b, c = (network.bus(peer) for peer in "abc")
    network.partition({"a"})
    d = network.bus("d")
    d.publish("news", b"x")
    network.advance(1.0)
    assert payloads(b) == payloads(c) == [b"x"]
    assert payloads(a) == []


def test_what_is_under_way_when_the_network_is_cut_is_lost():
    network = Network(7, delay=(1.0, 1.0))
    a, b = network.bus("a"), network.bus("b")
    a.publish("news", b"x")
    network.partition({"a"}, {"b"})
    network.advance(1.0)
    assert payloads(b) == []
    assert network.counters == {"cut": 1}


def test_what_is_said_in_a_partition_does_not_arrive_after_it():
    network = Network(7, delay=(1.0, 1.0))
    a, b = network.bus("a"), network.bus("b")
    network.partition({"a"}, {"b"})
    a.publish("news", b"x")
    network.heal()
    network.advance(1.0)
    assert payloads(b) == []


def test_with_a_lease_a_partition_that_heals_in_time_is_never_told():
    network = Network(7, lease=2.0)
    a, b = network.bus("a"), network.bus("b")
    a.receive()
    network.partition({"a"}, {"b"})
    network.advance(1.0)
    b.publish("news", b"lost without a word")
    network.advance(1.5)
    network.heal()
    network.advance(10.0)
    assert a.receive() == []


def test_with_a_lease_a_crash_is_told_late_and_a_goodbye_at_once():
    network = Network(7, lease=2.0)
    a, _, c = (network.bus(peer) for peer in "abc")
    a.receive()
    c.close()
    assert a.receive() == [Left("c")]
    network.crash("b")
    assert network.next_event() == 2.0
    network.advance(1.999)
    assert a.receive() == []
    network.advance(2.0)
    assert a.receive() == [Left("b")]


def test_a_crashed_peer_is_told_to_be_gone_and_cannot_go_on():
    network = Network(7)
    a, b = network.bus("a"), network.bus("b")
    a.receive()
    network.crash("b")
    assert a.receive() == [Left("b")]
    assert b.receive() == []
    with pytest.raises(RuntimeError, match="closed"):
        b.publish("news", b"")
    b.close()
    with pytest.raises(KeyError):
        network.crash("b")


def test_a_peer_that_is_back_before_its_crash_was_noticed_is_told_as_gone_and_come():
    network = Network(7, lease=2.0)
    a = network.bus("a")
    network.bus("b")
    a.receive()
    network.crash("b")
    again = network.bus("b")
    assert a.receive() == [Left("b"), Joined("b")]
    network.advance(10.0)
    assert a.receive() == []
    a.send("b", b"x")
    network.advance(11.0)
    assert payloads(again) == [b"x"]


def test_what_was_under_way_to_a_crashed_peer_does_not_reach_its_successor():
    network = Network(7, delay=(1.0, 1.0))
    a = network.bus("a")
    network.bus("b")
    a.send("b", b"to the first")
    network.crash("b")
    again = network.bus("b")
    network.advance(1.0)
    assert payloads(again) == []


def test_a_name_is_on_the_network_once():
    network = Network(7)
    network.bus("a")
    with pytest.raises(ValueError, match="'a' is on this network already"):
        network.bus("a")


def test_a_payload_is_what_it_was_when_it_was_sent():
    network = Network(7)
    a, b = network.bus("a"), network.bus("b")
    buffer = bytearray(b"before")
    a.publish("news", buffer)
    buffer[:] = b"after!"
    network.advance(1.0)
    assert payloads(b) == [b"before"]
