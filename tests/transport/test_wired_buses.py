"""What a bus with sockets can get wrong: links, ports, processes that die, other swarms."""

from __future__ import annotations

import gc
import threading
import time
from pathlib import Path

import pytest

from transport.bus import BusError, Joined, Left, Message
from transport.roster import roster_endpoints

pytestmark = pytest.mark.processes


def internet_sockets() -> set[tuple[str, str, str]]:
    """This process's internet sockets: (protocol, local, remote) as the kernel writes them."""
    mine = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        try:
            mine.add(descriptor.readlink().name)
        except FileNotFoundError:
            continue  # it was the one that lists the folder
    sockets = set()
    for protocol in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/self/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if f"socket:[{fields[9]}]" in mine:
                sockets.add((protocol, fields[1], fields[2]))
    return sockets


LOOPBACK = "0100007F:"  # 127.0.0.1
NOBODY = "00000000:0000"


def test_every_socket_is_on_the_loopback_and_without_endpoints_nothing_is_listened_on(wire, free_endpoint):
    before = internet_sockets()
    endpoint = free_endpoint()
    with wire.bus("test", "alone", listen=[], connect=[]):
        assert internet_sockets() <= before
    with (
        wire.bus("test", "a", listen=[endpoint], connect=[]) as a,
        wire.bus("test", "b", listen=[], connect=[endpoint]) as b,
    ):
        wire.receive_until(a, bool)
        wire.receive_until(b, bool)
        new = internet_sockets() - before
        port = f"{int(endpoint.rsplit(':')[-1]):04X}"
        assert {(protocol, local) for protocol, local, remote in new if remote == NOBODY} == {("tcp", LOOPBACK + port)}
        assert len(new) == 3  # the listener and one connection's two ends
        assert all(local.startswith(LOOPBACK) for _, local, _ in new)
        assert all(remote.startswith(LOOPBACK) or remote == NOBODY for _, _, remote in new)


def test_a_newcomers_joined_is_answered_across_processes(wire, peer_process, free_endpoint):
    endpoint = free_endpoint()
    peer_process("other", listen=endpoint)
    for round_number in range(5):
        with wire.bus("test", f"me{round_number}", listen=[], connect=[endpoint]) as me:
            early = wire.receive_until(me, lambda events: Joined("other") in events)
            me.send("other", b"digest")
            missing = {Message("other", b"welcome"), Message("other", b"echo digest")}.difference(early)
            wire.receive_until(me, lambda events, missing=missing: missing <= set(events))


def test_a_dead_endpoint_neither_holds_up_opening_nor_is_given_up(wire, peer_process, free_endpoint):
    endpoint = free_endpoint()
    took = []
    for _ in range(3):
        before = time.monotonic()
        wire.bus("test", "me", listen=[], connect=[endpoint]).close()
        took.append(time.monotonic() - before)
    assert min(took) < 0.25  # Zenoh's default would look around for half a second
    with wire.bus("test", "me", listen=[], connect=[free_endpoint(), endpoint]) as me:
        me.publish("news", b"to nobody")
        assert me.receive(timeout=0.5) == []
        peer_process("late", listen=endpoint)
        wire.receive_until(me, lambda events: Joined("late") in events)


def test_a_link_that_died_is_made_again(wire, peer_process, free_endpoint):
    endpoint = free_endpoint()
    with wire.bus("test", "me", listen=[], connect=[endpoint]) as me:
        for life in ("first", "second"):
            process = peer_process(life, listen=endpoint)
            wire.receive_until(me, lambda events, life=life: Joined(life) in events)
            me.send(life, b"hello")
            wire.receive_until(me, lambda events, life=life: Message(life, b"echo hello") in events)
            process.kill()
            wire.receive_until(me, lambda events, life=life: Left(life) in events)
            process.wait()


def test_a_killed_process_is_told_to_be_gone_long_before_its_lease_is_over(wire, peer_process, free_endpoint):
    """By the link that breaks: Zenoh sees it at once, ZeroMQ's next heartbeat within half a second."""
    endpoint = free_endpoint()
    with wire.bus("test", "me", listen=[endpoint], connect=[]) as me:
        process = peer_process("victim", connect=endpoint)
        wire.receive_until(me, lambda events: Joined("victim") in events)
        before = time.monotonic()
        process.kill()
        wire.receive_until(me, lambda events: Left("victim") in events)
        assert time.monotonic() - before < 5.0  # the lease is 6 s


def test_a_process_with_an_uncaught_exception_is_gone_at_once_though_its_bus_is_open(wire, peer_process, free_endpoint):
    """Zenoh's own callback threads are such that the interpreter waits for them at exit, for ever."""
    endpoint = free_endpoint()
    with wire.bus("test", "me", listen=[endpoint], connect=[]) as me:
        process = peer_process("unlucky", connect=endpoint, then="fail")
        early = wire.receive_until(me, lambda events: Joined("unlucky") in events)
        _, errors = process.communicate(timeout=5.0)
        assert process.returncode == 1
        assert errors.rstrip().endswith("LookupError: nobody catches this")
        wire.receive_until(me, lambda events: Left("unlucky") in early + events)


def test_a_process_that_ends_without_closing_its_bus_ends(wire, peer_process, free_endpoint):
    endpoint = free_endpoint()
    with wire.bus("test", "me", listen=[endpoint], connect=[]) as me:
        process = peer_process("tidy", connect=endpoint)
        wire.receive_until(me, lambda events: Joined("tidy") in events)
        _, errors = process.communicate(timeout=5.0)  # closes its standard input
        assert (process.returncode, errors) == (0, "")


def test_an_occupied_port_is_a_clear_error_at_once(wire, free_endpoint):
    endpoint = free_endpoint()
    with wire.bus("test", "first", listen=[endpoint], connect=[]):
        before = time.monotonic()
        with pytest.raises(BusError, match="Address already in use") as caught:
            wire.bus("test", "second", listen=[endpoint], connect=[])
        assert time.monotonic() - before < 2.0
        assert caught.value.where == endpoint
        assert "/root" not in caught.value.what
        assert ".rs" not in caught.value.what
    wire.bus("test", "second", listen=[endpoint], connect=[]).close()


@pytest.mark.parametrize("endpoint", ["nonsense", "tcp/127.0.0.1", "serial//dev/ttyACM0#baudrate=9600"])
def test_an_endpoint_that_cannot_be_listened_on_is_a_clear_error(wire, endpoint):
    with pytest.raises(BusError, match=endpoint):
        wire.bus("test", "a", listen=[endpoint], connect=[])


@pytest.mark.parametrize("swarm", ["", "*", "**", "a/b", "$*", "@x", "x" * 65])
def test_a_swarm_name_that_is_no_name_is_our_mistake(wire, swarm):
    with pytest.raises(ValueError, match="swarm: expected 1 to 64 letters"):
        wire.bus(swarm, "a", listen=[], connect=[])


def test_swarms_on_the_same_endpoints_do_not_meet(wire, free_endpoint):
    endpoint = free_endpoint()
    with (
        wire.bus("red", "a", listen=[endpoint], connect=[]) as red,
        wire.bus("blue", "b", listen=[], connect=[endpoint]) as blue,
        wire.bus("red", "c", listen=[], connect=[endpoint]) as red_too,
    ):
        assert wire.receive_until(red, bool) == [Joined("c")]
        assert wire.receive_until(red_too, bool) == [Joined("a")]
        blue.publish("news", b"blue")
        blue.send("a", b"blue")
        red_too.send("a", b"marker")
        assert wire.receive_until(red, bool) == [Message("c", b"marker")]
        assert blue.receive() == []


def test_a_roster_of_robots_and_an_observer_all_meet(wire, free_ports):
    base_port = free_ports(3)
    hosts = ["127.0.0.1"] * 3
    names = ["r0", "r1", "r2", "observer"]
    buses = []
    for name, index in zip(names, [0, 1, 2, None], strict=True):
        listen, connect = roster_endpoints(hosts, base_port, index)
        buses.append(wire.bus("test", name, listen=listen, connect=connect))
    try:
        for bus in buses:
            others = {Joined(name) for name in names if name != bus.peer}
            wire.receive_until(bus, lambda events, others=others: others <= set(events))
    finally:
        for bus in buses:
            bus.close()


def test_an_incoming_payload_longer_than_the_mtu_is_dropped_and_counted(wire, free_endpoint):
    endpoint = free_endpoint()
    with (
        wire.bus("test", "a", listen=[endpoint], connect=[], mtu=100) as a,
        wire.bus("test", "b", listen=[], connect=[endpoint], mtu=200_000) as b,
    ):
        wire.receive_until(b, bool)
        for number, length in enumerate((101, 200_000), start=1):
            b.publish("news", bytes(length))
            wire.wait_until(lambda n=number: a.counters["dropped_too_long"] == n, idle=b)
        b.publish("news", bytes(100))
        wire.receive_until(a, lambda events: Message("b", bytes(100)) in events)
        assert a.counters == {"received": 1, "bytes_received": 100, "dropped_too_long": 2}


def test_a_forgotten_bus_closes(wire, free_endpoint):
    endpoint = free_endpoint()
    with wire.bus("test", "a", listen=[endpoint], connect=[]) as a:
        forgotten = wire.bus("test", "b", listen=[], connect=[endpoint])
        wire.receive_until(a, lambda events: Joined("b") in events)
        del forgotten
        gc.collect()
        wire.receive_until(a, lambda events: Left("b") in events)


def test_messages_come_in_while_the_reader_computes(wire, free_endpoint, peer_process):
    """With callbacks on Zenoh's own thread a reader that computes in Python got no more than 200 messages a second."""
    endpoint = free_endpoint()
    with wire.bus("test", "me", listen=[endpoint], connect=[]) as me:
        peer_process("other", connect=endpoint)
        wire.receive_until(me, lambda events: Message("other", b"welcome") in events)
        before = me.counters["received"]
        for number in range(1_000):
            me.send("other", b"%d" % number)
        deadline = time.monotonic() + 2.0
        while me.counters["received"] < before + 1_000 and time.monotonic() < deadline:
            sum(number * number for number in range(200))
        assert me.counters["received"] == before + 1_000


def test_a_bus_closes_while_messages_pour_in(wire, free_endpoint):
    endpoint = free_endpoint()
    with wire.bus("test", "a", listen=[endpoint], connect=[]) as a:
        stop = threading.Event()

        def pour() -> None:
            while not stop.is_set():
                a.publish("news", bytes(500))

        pouring = threading.Thread(target=pour)
        pouring.start()
        try:
            for _ in range(10):
                with wire.bus("test", "b", listen=[], connect=[endpoint]) as b:
                    wire.receive_until(b, lambda events: Message("a", bytes(500)) in events)
                    before = time.monotonic()
                assert time.monotonic() - before < 5.0
        finally:
            stop.set()
            pouring.join()
