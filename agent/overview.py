"""How a swarm stands, as one value of plain numbers and words: what the page, ``orion top`` and ``/metrics`` show.

Laws kept here: what it says of a snapshot depends on nothing else, but for the digest, which of a large map costs
something and so is at most a second old.
"""

from __future__ import annotations

import math
from typing import Any

from agent.page_history import History
from agent.page_snapshot import SessionView, Snapshot, Timeline
from mapping.lattice import TileKey
from mapping.map_picture import Colour, robot_colour
from mapping.tiles import map_digest
from swarm.radio import PROFILES

_DIGEST_PERIOD = 1.0
"""Seconds between two map digests."""


class Overview:
    """Tells it of one snapshot after the other.

    Args:
        swarm: its name.
        roster: robot ids, whose order decides their colours.
        budget: payload bytes a second that the network can carry in all, or None if it does not matter.

    Attributes:
        history: of the global map.
        changed: the global map's tiles that are others in the newest snapshot than in the one before.
    """

    def __init__(self, swarm: str, roster: list[str], budget: float | None = None) -> None:
        self._swarm = swarm
        self._roster = roster
        self._budget = budget
        self._digest = ""
        self._digest_at = -math.inf
        self._digest_due = True
        self.history = History()
        self.changed: set[TileKey] = set()

    def of(self, snapshot: Snapshot, *, exact: bool = False) -> dict[str, Any]:
        """The value of a snapshot.

        Args:
            snapshot: the newest.
            exact: its very digest, whatever that costs.

        Returns:
            What ``/api/state`` answers but for ``ended``, ready for JSON. ``agree`` is whether everybody who is there
            said that it holds this map, and we lack nothing that anybody holds; ``dropped``, ``sent`` and ``spent``
            are our own, in messages by reason, payload bytes by topic and payload bytes by class of traffic.
        """
        self.changed = self.history.take(snapshot.fused, snapshot.rules.lattice)
        self._digest_due = self._digest_due or bool(self.changed)
        if self._digest_due and (exact or self._is_late(snapshot)):
            self._digest, self._digest_at, self._digest_due = map_digest(snapshot.fused).hex(), snapshot.now, False
        behind = any(view.contribution.n < view.known_n for view in snapshot.sessions)
        return {
            "swarm": self._swarm,
            "cell_mm": snapshot.rules.lattice.cell_mm,
            "clear_hit": snapshot.rules.model.occupied,
            "digest": self._digest,
            "agree": bool(snapshot.peers) and all(peer.same for peer in snapshot.peers) and not behind,
            "tiles": self.history.tiles,
            "known_m2": self.history.known_m2,
            "bytes_rate": round(snapshot.bytes_rate),
            "budget": self._budget,
            "timeline": None if snapshot.timeline is None else _told(snapshot.timeline),
            "peers": [peer._asdict() for peer in snapshot.peers],
            "sessions": [self._session(view) for view in snapshot.sessions],
            **snapshot.traffic._asdict(),
        }

    def colour(self, robot: str) -> str:
        """A robot's colour as #rrggbb."""
        return "#{:02x}{:02x}{:02x}".format(*self.rgb(robot))

    def rgb(self, robot: str) -> Colour:
        """A robot's colour, the same as in the map's picture."""
        return robot_colour(self._roster.index(robot) if robot in self._roster else len(self._roster))

    def _is_late(self, snapshot: Snapshot) -> bool:
        """Whether the digest is to be made anew: at once where nothing else is going on."""
        stands = snapshot.timeline is not None and snapshot.timeline.whole and snapshot.timeline.speed == 0
        return stands or snapshot.now - self._digest_at >= _DIGEST_PERIOD

    def _session(self, view: SessionView) -> dict[str, Any]:
        standing = view.contribution
        descriptor, pose = standing.descriptor, view.track.pose
        return {
            "session": view.session.hex(),
            "robot": descriptor.robot,
            "colour": self.colour(descriptor.robot),
            "n": standing.n,
            "known_n": view.known_n,
            "summed": standing.summed,
            "live": standing.live,
            "reason": standing.reason,
            "replaced": view.tiles == {} and standing.reason.startswith("replaced by"),
            "evicted": standing.reason.startswith("evicted"),
            "age": None if view.age is None else round(view.age),
            "updates_rate": round(view.updates_rate, 2),
            "bytes_rate": None if view.bytes_rate is None else round(view.bytes_rate),
            "tiles": len(view.tiles),
            "pose": None if pose is None else pose.tolist(),
            "sensed_from": None if descriptor.start is None else list(descriptor.start),
            "start": None if view.start is None else list(view.start),
        }


def budget(radio: str) -> float | None:
    """Payload bytes a second of a channel that all share; None if each peer has a link of its own."""
    profile = PROFILES[radio]
    return profile.rate if profile.repeats else None


def _told(timeline: Timeline) -> dict[str, Any]:
    return {
        "seconds": timeline.seconds,
        "duration": timeline.duration,  # to the bit: whoever goes there is to be at the end
        "whole": timeline.whole,
        "torn": timeline.torn,
        "speed": timeline.speed,
    }
