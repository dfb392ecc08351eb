"""What every bus promises: publish to all, send to one, and one bounded queue of what came in.

Laws kept here: a bus may lose, repeat, delay and reorder whole payloads, never change them; it never blocks a
publisher on a slow reader; what it drops, it counts under a name. Whoever publishes, sends and reads does so from one
thread, the one that owns the peer's state.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol, Self

PeerId = str
"""A peer's name on its bus, unique while it runs: ``r1.5f3a09c2``."""

MTU = 32_768
"""The longest payload, in bytes, of a bus that has no reason for another one."""

_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")


@dataclass(frozen=True, slots=True)
class Message:
    """A payload from another peer."""

    sender: PeerId
    payload: bytes


@dataclass(frozen=True, slots=True)
class Joined:
    """A peer is there: what is given to it from now on is likely to arrive (it may be told again).

    A peer's first messages may come before its ``Joined``, and its last ones after its ``Left``.
    """

    peer: PeerId


@dataclass(frozen=True, slots=True)
class Left:
    """A peer is gone, for the time being."""

    peer: PeerId


Event = Message | Joined | Left

Answers = Callable[[], Iterable[tuple[str, bytes]]]
"""What there is to show now: values by name. A name is one or more words with slashes between."""


class BusError(OSError):
    """A bus cannot be opened, and it is not the caller's code that is wrong.

    Attributes:
        what: what failed and why, for the user.
        where: the endpoint or device.
    """

    def __init__(self, what: str, where: str) -> None:
        super().__init__(f"{what}: {where}")
        self.what = what
        self.where = where


class Bus(Protocol):
    """One peer's access to the others.

    Attributes:
        peer: the own name; the bus never delivers a peer's messages to itself.
        mtu: the longest payload in bytes. Longer ones are our mistake: ``ValueError``.
        counters: ``published``, ``sent``, ``received`` (payloads), ``bytes_sent``, ``bytes_received`` (payload
            bytes given to and taken from the wire; a publish counts once, however many listen), and
            ``dropped_<reason>``. ``dropped_inbox_full`` are payloads that were received and then pushed out unread;
            those under any other reason were not counted as received.
    """

    peer: PeerId
    mtu: int
    counters: Counter[str]

    def publish(self, topic: str, payload: bytes) -> None:
        """Give the payload to every peer that is there. ``topic`` is a plain word that names the traffic."""
        ...

    def send(self, peer: PeerId, payload: bytes) -> None:
        """Give the payload to one peer. To one that is not there (or to oneself) it is lost without an error."""
        ...

    def receive(self, timeout: float = 0.0) -> list[Event]:
        """Everything that came in, oldest first; waits up to ``timeout`` seconds if there is nothing yet."""
        ...

    def serve(self, topic: str, answers: Answers) -> None:
        """Show values to whoever asks for them without being a peer, on a bus that carries questions.

        Args:
            topic: a plain word, under which they are found.
            answers: gives them; called by a thread of the bus, so it may read only what is never written.
        """
        ...

    def close(self) -> None:
        """Leave. Safe to call twice; afterwards publish and send raise ``RuntimeError`` and receive gives nothing."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc_info: object) -> None: ...


def is_name(text: str) -> bool:
    """Whether the text may name a swarm, a peer or a topic: 1 to 64 ASCII letters, digits, ``.``, ``_``, ``-``."""
    return _NAME.fullmatch(text) is not None


def checked_name(what: str, text: str) -> str:
    """The text, if it may be the name of a ``what``.

    Raises:
        ValueError: it may not; see `is_name`.
    """
    if not is_name(text):
        raise ValueError(f"{what}: expected 1 to 64 letters, digits, '.', '_' or '-', got {text!r}")
    return text
