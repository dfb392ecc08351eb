"""Messages longer than the bus's MTU, cut into parts and put together again.

Parts are named by the whole message's digest, so parts of one answer that was sent twice, even by two peers, fit.
"""

from __future__ import annotations

import hashlib

from swarm.drops import Drop
from swarm.limits import MAX_MESSAGE, MAX_PART_BYTES, MAX_PARTS
from swarm.messages import Message, Part, decode, encode

_OVERHEAD = 26
"""The most bytes that a part needs besides its data."""

_KEEPING = 200
"""What keeping a piece costs in memory besides its data."""


def _digest(message: bytes) -> bytes:
    return hashlib.blake2b(message, digest_size=8).digest()


def cut(message: bytes, mtu: int) -> list[bytes]:
    """The payloads, none longer than ``mtu``, that carry an encoded message.

    Raises:
        ValueError: it would take too many parts.
    """
    if len(message) <= mtu:
        return [message]
    size = mtu - _OVERHEAD
    pieces = [message[first : first + size] for first in range(0, len(message), size)]
    if len(pieces) > MAX_PARTS:
        raise ValueError(f"message of {len(message)} bytes: too many parts for an MTU of {mtu}")
    name = _digest(message)
    return [encode(Part(name, k, len(pieces), piece)) for k, piece in enumerate(pieces)]


class Joiner:
    """Collects parts; gives a message when all of its parts are here. The oldest unfinished one makes room."""

    def __init__(self) -> None:
        self._unfinished: dict[bytes, dict[int, bytes]] = {}
        self._bytes = 0

    def join(self, part: Part) -> Message | None:
        """The message that this part completes, if it does.

        Raises:
            Drop: ``bad_part``, or what decoding the whole finds.
        """
        if part.part >= part.parts:
            raise Drop("bad_part")
        pieces = self._unfinished.setdefault(part.digest, {})
        if part.part not in pieces:
            pieces[part.part] = part.data
            self._bytes += len(part.data) + _KEEPING
        if len(pieces) < part.parts:
            self._make_room()
            return None
        self._forget(part.digest)
        whole = b"".join(pieces[k] for k in sorted(pieces))
        if len(whole) > MAX_MESSAGE or _digest(whole) != part.digest:
            raise Drop("bad_part")
        message = decode(whole)
        if isinstance(message, Part):
            raise Drop("bad_part")
        return message

    def _forget(self, name: bytes) -> None:
        self._bytes -= sum(len(data) + _KEEPING for data in self._unfinished.pop(name).values())

    def _make_room(self) -> None:
        while self._bytes > MAX_PART_BYTES:
            self._forget(next(iter(self._unfinished)))
