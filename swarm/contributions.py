"""What each session contributes to the global map, and if that is not all of it, why: in words for a person."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from swarm.messages import Control
from swarm.peer import Peer
from swarm.session import Descriptor, SessionId

SILENCE = 10.0
"""Seconds after which it is worth telling that nobody who is there writes a session and no news of it came.

Of a writer that is there silence means nothing: in a quiet swarm digests are suppressed."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """How one session stands at one peer.

    Attributes:
        descriptor: whose session it is.
        n: its updates that are here; 0 if it is not followed.
        summed: whether it is part of the global map.
        live: whether somebody who is there writes it.
        duplicate: whether it is live and another live session has the same robot id; the reason says so too.
        reason: why it is not summed, or what else is amiss; empty if all is well.
    """

    descriptor: Descriptor
    n: int
    summed: bool
    live: bool
    duplicate: bool
    reason: str


def contributions(peer: Peer, now: float) -> list[Contribution]:
    """Every session that a peer knows, in order of robot and session."""
    live = peer.live()
    robots = Counter(peer.descriptors[session].robot for session in live)
    found = []
    for descriptor in sorted(peer.descriptors.values(), key=lambda each: (each.robot, each.session)):
        session, replica = descriptor.session, peer.replicas.get(descriptor.session)
        excluded = _excluded(peer, descriptor)
        duplicate = session in live and robots[descriptor.robot] > 1
        amiss = [excluded] if excluded else []
        if duplicate:
            amiss.append(f"{_number(robots[descriptor.robot])} live robots are called {descriptor.robot}")
        if replica is not None:
            amiss += _lagging(peer, session)
            if session not in live:
                amiss += _silent(peer, session, now)
        n = 0 if replica is None else replica.state.n
        found.append(Contribution(descriptor, n, not excluded, session in live, duplicate, "; ".join(amiss)))
    return found


def _excluded(peer: Peer, descriptor: Descriptor) -> str:
    """Why a session is not summed, or nothing."""
    session = descriptor.session
    if session in peer.refused:
        return peer.refused[session].removeprefix(f"{descriptor.robot}: ")
    if session in peer.replaced:
        return f"replaced by {peer.replaced[session].hex()}"
    if session in peer.controls.evicted:
        control = peer.controls.get(Control.EVICT, session)
        assert control is not None
        return f"evicted by {_name(control.issuer)}"
    return "no start pose" if descriptor.start is None else ""


def _lagging(peer: Peer, session: SessionId) -> list[str]:
    n, most = peer.replicas[session].state.n, peer.known_n(session)
    return [f"is behind: at {n} of {most}"] if n < most else []


def _silent(peer: Peer, session: SessionId, now: float) -> list[str]:
    heard_at = peer.heard_at.get(session)
    if heard_at is None:
        return ["not heard of yet"]
    return [f"silent for {now - heard_at:.0f} s"] if now - heard_at >= SILENCE else []


def _name(issuer: bytes) -> str:
    """An issuer as a person may know it."""
    name = issuer.rstrip(b"\0").decode("latin-1")
    return name if name.isascii() and name.isprintable() and name else issuer.hex()


def _number(count: int) -> str:
    return {2: "two", 3: "three"}.get(count, str(count))
