"""What every bus promises: publish to all, send to one, and one bounded queue of what came in.

Laws kept here: a bus may lose, repeat, delay and reorder whole payloads, never change them; it never blocks a
publisher on a slow reader; what it drops, it counts under a name. Whoever reads does so from one thread, the one that
owns the peer's state.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Protocol, Self

PeerId = str
"""A peer's name on its bus, unique while it runs: ``r1.5f3a09c2``."""


@dataclass(frozen=True, slots=True)
class Message:
    """A payload from another peer."""

    sender: PeerId
    payload: bytes


@dataclass(frozen=True, slots=True)
class Joined:
    """A peer can be heard from now on (it may be told again)."""

    peer: PeerId


@dataclass(frozen=True, slots=True)
class Left:
    """A peer is gone, for the time being."""

    peer: PeerId


Event = Message | Joined | Left


class Bus(Protocol):
    """One peer's access to the others.

    Attributes:
        peer: the own name; the bus never delivers a peer's messages to itself.
        mtu: the longest payload in bytes. Longer ones are our mistake: ``ValueError``.
        counters: ``published``, ``sent``, ``received`` (payloads), ``bytes_sent``, ``bytes_received`` (payload
            bytes given to and taken from the wire), and ``dropped_<reason>``.
    """

    peer: PeerId
    mtu: int
    counters: Counter[str]

    def publish(self, topic: str, payload: bytes) -> None:
        """Give the payload to every peer that is there. ``topic`` is a plain word that names the traffic."""
        ...

    def send(self, peer: PeerId, payload: bytes) -> None:
        """Give the payload to one peer. To one that is not there it is lost without an error."""
        ...

    def receive(self, timeout: float = 0.0) -> list[Event]:
        """Everything that came in, oldest first; waits up to ``timeout`` seconds if there is nothing yet."""
        ...

    def close(self) -> None:
        """Leave. Safe to call twice; afterwards publish and send raise ``RuntimeError`` and receive gives nothing."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc_info: object) -> None: ...
