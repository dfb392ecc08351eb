"""What the tests of all buses share: a harness per bus, a peer in a process, and waiting without sleeping."""

from __future__ import annotations

import random
import socket
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from transport.bus import Bus, BusError, Event, Joined, Message
from transport.in_process import Network
from transport.zenoh_bus import ZenohBus
from transport.zmq_bus import ZmqBus

PATIENCE = 15.0
"""Seconds after which what should have come counts as lost; a test that passes never waits that long."""


class Harness(ABC):
    """Peers on one kind of bus, over perfect links. A new kind of bus is one more subclass, listed in `harness`."""

    def __init__(self) -> None:
        self._stack = ExitStack()

    @abstractmethod
    def join(self, peer: str, *, max_messages: int = 10_000) -> Bus:
        """A new peer, which may not have met the others yet."""

    @abstractmethod
    def pass_time(self) -> None:
        """Let fake time pass; real time does so by itself."""

    def receive_until(self, bus: Bus, enough: Callable[[list[Event]], bool]) -> list[Event]:
        """What comes in until it is enough."""
        deadline = time.monotonic() + PATIENCE
        events = bus.receive()
        while not enough(events):
            assert time.monotonic() < deadline, f"{bus.peer} waited in vain, got only {events[-10:]}"
            self.pass_time()
            events += bus.receive(0.05)
        return events

    def messages(self, bus: Bus, number: int) -> list[Message]:
        """The next messages, at least so many; presence is passed over."""
        events = self.receive_until(bus, lambda events: len(_messages(events)) >= number)
        return _messages(events)

    def wait_until(self, condition: Callable[[], bool], idle: Bus) -> None:
        """Wait without reading the bus under test: on ``idle``, a peer that has nothing to read."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            self.pass_time()
            idle.receive(0.01)

    def swarm(self, *peers: str) -> list[Bus]:
        """Peers that know each other, with nothing left to read."""
        buses = [self.join(peer) for peer in peers]
        for bus in buses:
            others = {Joined(peer) for peer in peers if peer != bus.peer}
            self.receive_until(bus, lambda events, others=others: others <= set(events))
        return buses

    def close(self) -> None:
        self._stack.close()


class InProcessHarness(Harness):
    def __init__(self) -> None:
        super().__init__()
        self.network = Network(seed=1, delay=(0.001, 0.001))

    def join(self, peer: str, *, max_messages: int = 10_000) -> Bus:
        return self.network.bus(peer, max_messages=max_messages)

    def pass_time(self) -> None:
        self.network.advance(self.network.now + 0.01)


class LoopbackHarness(Harness):
    """Each peer listens on a free port of 127.0.0.1 and connects to all who came before."""

    bus: type[ZenohBus | ZmqBus]

    def __init__(self) -> None:
        super().__init__()
        self._endpoints: list[str] = []

    def join(self, peer: str, *, max_messages: int = 10_000) -> Bus:
        for _ in range(5):
            endpoint = _free_endpoint()
            try:
                bus = self.bus("test", peer, listen=[endpoint], connect=self._endpoints, max_messages=max_messages)
            except BusError:  # somebody took the port between our asking and our listening
                continue
            self._endpoints.append(endpoint)
            return self._stack.enter_context(bus)
        raise AssertionError("no free port")

    def pass_time(self) -> None:
        """It does."""


class ZenohHarness(LoopbackHarness):
    bus = ZenohBus


class ZmqHarness(LoopbackHarness):
    bus = ZmqBus


HARNESSES: list[object] = [
    pytest.param(InProcessHarness, id="in_process"),
    pytest.param(ZenohHarness, id="zenoh", marks=pytest.mark.processes),
    pytest.param(ZmqHarness, id="zmq", marks=pytest.mark.processes),
]


@pytest.fixture(params=HARNESSES)
def harness(request: pytest.FixtureRequest) -> Iterator[Harness]:
    """Every bus in turn."""
    harness: Harness = request.param()
    yield harness
    harness.close()


@pytest.fixture
def zenoh_harness() -> Iterator[ZenohHarness]:
    harness = ZenohHarness()
    yield harness
    harness.close()


@pytest.fixture
def zmq_harness() -> Iterator[ZmqHarness]:
    harness = ZmqHarness()
    yield harness
    harness.close()


@pytest.fixture(params=[ZenohHarness, ZmqHarness], ids=["zenoh", "zmq"])
def wire(request: pytest.FixtureRequest) -> Iterator[LoopbackHarness]:
    """Every bus that has sockets; ``wire.bus`` is its class."""
    harness: LoopbackHarness = request.param()
    yield harness
    harness.close()


@pytest.fixture
def free_endpoint() -> Callable[[], str]:
    """Gives endpoints on 127.0.0.1 on which nobody listens."""
    return _free_endpoint


@pytest.fixture
def free_ports() -> Callable[[int], int]:
    """Gives the first of so many free ports in a row on 127.0.0.1."""
    return _free_ports


PeerProcess = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def peer_process(wire: LoopbackHarness) -> Iterator[PeerProcess]:
    """Starts `a_peer.py` in a new interpreter (never by a fork), and leaves none behind."""
    with ExitStack() as stack:

        def start(peer: str, *, listen: str = "-", connect: str = "-", then: str = "echo") -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [
                    sys.executable,
                    str(Path(__file__).with_name("a_peer.py")),
                    wire.bus.__name__,
                    peer,
                    listen,
                    connect,
                    then,
                ],
                stdin=subprocess.PIPE,  # it ends when we do
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield start


def _messages(events: list[Event]) -> list[Message]:
    return [event for event in events if isinstance(event, Message)]


def _free_endpoint() -> str:
    return f"tcp/127.0.0.1:{_free_ports(1)}"


def _free_ports(number: int) -> int:
    """The first of so many free ports in a row, below those that the kernel hands out by itself."""
    while True:
        first = random.randrange(20_000, 32_000)
        with suppress(OSError), ExitStack() as stack:
            for port in range(first, first + number):
                stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
            return first
