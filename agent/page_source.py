"""Where what the page shows comes from: a peer at work, or a log of one (``agent.log_player``).

Law kept here: the page does not know which of them it shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from agent.page_orders import Evict, Order, Place
from agent.page_snapshot import Lost, Snapshot, Snapshots
from agent.page_tracks import Tracks
from swarm.peer import Peer


class Source(Protocol):
    """What can be shown; asked and told only by the loop that owns it."""

    def take(self, now: float) -> Snapshot:
        """What is to be seen now."""
        ...

    def obey(self, order: Order, now: float) -> None:
        """Carry out what a person decided on the page.

        Raises:
            ValueError: it cannot be done, in words.
        """
        ...


class PeerSource:
    """A peer at work.

    Args:
        peer: the observer.
        tracks: what its updates told.
        heard_bytes: payload bytes heard from each other peer.
        lost: what the bus had to drop.
    """

    def __init__(self, peer: Peer, tracks: Tracks, heard_bytes: Mapping[str, int], lost: Lost = dict) -> None:
        self._peer = peer
        self._snapshots = Snapshots(peer, tracks, heard_bytes, lost)

    def take(self, now: float) -> Snapshot:
        """See ``Source``."""
        return self._snapshots.take(now)

    def obey(self, order: Order, now: float) -> None:
        """See ``Source``."""
        match order:
            case Evict(session, readmit):
                if session not in self._peer.replicas:
                    raise ValueError(f"session {session.hex()} is not held here")
                (self._peer.readmit if readmit else self._peer.evict)(session, now)
            case Place(robot, pose):
                if not any(descriptor.robot == robot for descriptor in self._peer.descriptors.values()):
                    raise ValueError(f"robot {robot} is unknown")
                self._peer.set_start_pose(robot, pose, now)
            case _:
                raise ValueError("a swarm at work cannot be wound back")
