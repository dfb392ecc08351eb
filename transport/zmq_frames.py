"""What one peer says to another over ZeroMQ, in one frame: a key as on Zenoh and, in a message, a space and a payload.

``orion/<swarm>/<peer>/<topic> ...`` is for all, ``orion/<swarm>/<peer>/to/<other> ...`` for one. A key alone is
presence: ``orion/<swarm>/<peer>/alive``, and ``orion/<swarm>/<peer>/gone`` as the last word.

Laws kept here: what somebody else says never raises; what is not for us has a named reason.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from transport.bus import Message, PeerId

_NAME = rb"[A-Za-z0-9._-]{1,64}"
_KEY = re.compile(rb"orion/(?P<swarm>%b)/(?P<sender>%b)/(?P<topic>to/(?P<other>%b)|%b)" % (_NAME, _NAME, _NAME, _NAME))


class Alive(NamedTuple):
    """A peer is there."""

    sender: PeerId


class Gone(NamedTuple):
    """A peer leaves."""

    sender: PeerId


class Refused(NamedTuple):
    """Nothing that concerns us, and why."""

    reason: str


def say_alive(swarm: str, own: PeerId) -> bytes:
    """That we are there."""
    return f"orion/{swarm}/{own}/alive".encode()


def say_gone(swarm: str, own: PeerId) -> bytes:
    """That we leave."""
    return f"orion/{swarm}/{own}/gone".encode()


def say_to_all(swarm: str, own: PeerId, topic: str, payload: bytes) -> bytes:
    """A payload for everybody."""
    return f"orion/{swarm}/{own}/{topic} ".encode() + payload


def say_to_one(swarm: str, own: PeerId, other: PeerId, payload: bytes) -> bytes:
    """A payload for one peer."""
    return f"orion/{swarm}/{own}/to/{other} ".encode() + payload


def understand(frames: Sequence[bytes], swarm: str, own: PeerId, mtu: int) -> Alive | Gone | Message | Refused:
    """What was said, as far as it concerns us.

    Args:
        frames: what came in, without any address.
        swarm: the only swarm that we listen to.
        own: our own name.
        mtu: the longest payload in bytes.
    """
    head, space, payload = frames[0].partition(b" ") if len(frames) == 1 else (b"", b"", b"")
    key = _KEY.fullmatch(head)
    if key is None or (not space and key["topic"] not in {b"alive", b"gone"}):
        return Refused("malformed")
    reason = _foreign(key, len(payload), swarm, own, mtu)
    if reason:
        return Refused(reason)
    sender = key["sender"].decode()
    if space:
        return Message(sender, payload)
    return Alive(sender) if key["topic"] == b"alive" else Gone(sender)


def _foreign(key: re.Match[bytes], length: int, swarm: str, own: PeerId, mtu: int) -> str:
    """Why something well-formed does not concern us; empty if it does."""
    if key["swarm"] != swarm.encode():
        return "other_swarm"
    if key["sender"] == own.encode():
        return "own_name"
    if key["other"] not in {None, own.encode()}:
        return "not_for_us"
    return "too_long" if length > mtu else ""
