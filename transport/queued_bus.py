"""What all our buses do alike, so that a new one says only how bytes leave: check, count, queue, close once.

Laws kept here: our own mistakes (a name, a length, use after close) raise at once, before anything is counted or
leaves; what is counted was given to the wire.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import Counter
from typing import Self

from transport.bus import Answers, Event, PeerId, checked_name
from transport.inbox import Inbox


class QueuedBus(ABC):
    """A `Bus` with an inbox; a subclass brings the wire.

    Whatever brings bytes in calls ``inbox.put``; it should hold the inbox and not the bus, so that a bus nobody
    holds can be collected.

    Args:
        peer: the own name.
        mtu: the longest payload in bytes.
        max_messages: how many messages the inbox holds at most.
        max_bytes: how many bytes of payload the inbox holds at most.
    """

    def __init__(self, peer: PeerId, *, mtu: int, max_messages: int = 10_000, max_bytes: int = 32 << 20) -> None:
        self.peer = checked_name("peer", peer)
        self.mtu = mtu
        self.counters: Counter[str] = Counter()
        self.inbox = Inbox(self.counters, max_messages=max_messages, max_bytes=max_bytes)
        self._closing = threading.Lock()
        self._closed = False

    def publish(self, topic: str, payload: bytes) -> None:
        """See `Bus.publish`."""
        self._check(payload)
        self._publish(checked_name("topic", topic), payload)
        self._count("published", payload)

    def send(self, peer: PeerId, payload: bytes) -> None:
        """See `Bus.send`."""
        self._check(payload)
        self._send(checked_name("peer", peer), payload)
        self._count("sent", payload)

    def receive(self, timeout: float = 0.0) -> list[Event]:
        """See `Bus.receive`."""
        return self.inbox.take(timeout)

    def serve(self, topic: str, answers: Answers) -> None:
        """See `Bus.serve`. Most wires carry no questions: nobody asks."""
        checked_name("topic", topic)

    def close(self) -> None:
        """See `Bus.close`."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
        self.inbox.close()
        self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @abstractmethod
    def _publish(self, topic: str, payload: bytes) -> None:
        """Give the payload to the wire, for all; never wait for a reader."""

    @abstractmethod
    def _send(self, peer: PeerId, payload: bytes) -> None:
        """Give the payload to the wire, for one; never wait for a reader."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of the wire. Called once."""

    def _check(self, payload: bytes) -> None:
        if self._closed:
            raise RuntimeError(f"{self.peer}: the bus is closed")
        if len(payload) > self.mtu:
            raise ValueError(f"payload: expected at most {self.mtu} bytes, got {len(payload)}")

    def _count(self, verb: str, payload: bytes) -> None:
        self.counters[verb] += 1
        self.counters["bytes_sent"] += len(payload)
