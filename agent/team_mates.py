"""Team-mates are not walls: readings that fall on one say nothing, in time or, where its pose came late, afterwards.

Laws kept here: what a robot saw of a team-mate follows from its own scans and the poses that the team-mate published,
by swarm time, and from nothing else; so whoever hears of a pose late comes to the same map as who knew it in time. The
correction is exact: new tiles = tiles - evidence of the scans as published + evidence of the scans as they should be.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.driver import ROBOT_RADIUS
from mapping.evidence import EvidenceModel
from mapping.lattice import Cells, Lattice, TileKey
from mapping.pose import FULL_TURN
from mapping.raster import Raster, raster
from mapping.rays import rays_of
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from mapping.tiles import Evidence, Tiles, added, merged
from swarm.drops import Drop
from swarm.messages import Update
from swarm.scan_block import decode_scans
from swarm.session import Descriptor

MARGIN = 0.03
"""Metres around a team-mate's body that a reading may fall on: what two robots' odometry and a reading are wrong by."""

WINDOW_MS = 300
"""A team-mate's pose counts for readings that long before and after it: 3 cm of way at 0.1 m/s, like the margin."""

KEEP_MS = 120_000
"""How long own scans and team-mates' poses are kept for corrections: two minutes."""

_MOST_POSES = 8192
"""Poses kept of one team-mate, whatever its stamps say."""

_FOOTPRINT_MM = (ROBOT_RADIUS + MARGIN) * 1000

Points = NDArray[np.float64]


@dataclass(slots=True)
class Track:
    """Where one robot was, in order of time.

    Attributes:
        stamps_ms: swarm time.
        points: x, y in millimetres of the common frame.
    """

    stamps_ms: list[int] = field(default_factory=list)
    points: list[tuple[int, int]] = field(default_factory=list)

    def add(self, stamp_ms: int, x_mm: int, y_mm: int) -> None:
        """One more pose; late ones find their place."""
        place = bisect_right(self.stamps_ms, stamp_ms)
        self.stamps_ms.insert(place, stamp_ms)
        self.points.insert(place, (x_mm, y_mm))
        if len(self.points) > _MOST_POSES:
            del self.stamps_ms[0], self.points[0]

    def forget(self, before_ms: int) -> None:
        """Drop all poses older than that but the newest of them."""
        old = max(0, bisect_left(self.stamps_ms, before_ms) - 1)
        del self.stamps_ms[:old], self.points[:old]

    def around(self, stamp_ms: int) -> list[tuple[int, int]]:
        """Where it may have been at that time: at its poses within the window; else where it last was before.

        A robot publishes wherever it goes: one that says nothing stands.
        """
        first = bisect_left(self.stamps_ms, stamp_ms - WINDOW_MS)
        last = bisect_right(self.stamps_ms, stamp_ms + WINDOW_MS)
        return self.points[first:last] or self.points[max(0, first - 1) : first]


class NoMates:
    """What a recorded robot knows of the others: nothing that it would have to take out of its scans."""

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Not heard."""

    def corrections(self, tiles: Tiles) -> dict[TileKey, Cells]:
        """None."""
        return {}


class TeamMates:
    """What a robot knows of the others, and what that does to its own scans.

    Where evidence has a limit, a scan's share of a cell cannot be told any more: then only what is known in time is
    masked, and what comes later is counted and left.

    Args:
        robot: its own id; its own sessions are none of its team-mates'.
        sensor: its own.
        model: what readings are worth.
        lattice: the swarm's.
        kernel: for corrections; see ``mapping.raster``.

    Attributes:
        counters: ``masked`` readings before they were published; ``corrected`` scans afterwards; ``uncorrectable``
            ones, because evidence has a limit and cannot be taken back; ``bad_poses``, updates that could not be read.
    """

    def __init__(
        self, robot: str, sensor: Sensor, model: EvidenceModel, lattice: Lattice, kernel: Raster = raster
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._robot = robot
        self._sensor = sensor
        self._model = model
        self._lattice = lattice
        self._kernel = kernel
        self._tracks: dict[str, Track] = {}
        self._sensed: list[Scans] = []  # as sensed, one a row; oldest first
        self._published: list[Scans] = []  # as published, the same rows
        self._news_from_ms: int | None = None  # the earliest reading that news of team-mates may concern

    # --- hearing of others

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take the poses out of an update that was applied (``swarm.peer.Listener``)."""
        if descriptor.robot == self._robot or descriptor.start is None:
            return
        try:
            poses = _poses(descriptor, update)
        except Drop:
            self.counters["bad_poses"] += 1
            return
        track = self._tracks.setdefault(descriptor.robot, Track())
        for stamp_ms, (x_mm, y_mm, _) in zip(poses.stamps_ms.tolist(), poses.poses.tolist(), strict=True):
            newest = track.stamps_ms[-1] if track.stamps_ms else stamp_ms
            self._concerns(min(stamp_ms, newest) - WINDOW_MS)
            track.add(stamp_ms, x_mm, y_mm)

    def _concerns(self, stamp_ms: int) -> None:
        self._news_from_ms = stamp_ms if self._news_from_ms is None else min(stamp_ms, self._news_from_ms)

    def positions(self) -> Points:
        """Where each team-mate was last heard of, shape (K, 2), metres in the common frame."""
        return np.array([track.points[-1] for track in self._tracks.values() if track.points]).reshape(-1, 2) / 1000

    # --- own scans

    def masked(self, scans: Scans) -> Scans:
        """The scans as they are to be published; they are remembered, to be corrected when more is known."""
        result = self._masked(scans)
        self.counters["masked"] += int(np.count_nonzero(result.ranges != scans.ranges))
        for row in range(len(scans)):
            self._sensed.append(scans[row : row + 1])
            self._published.append(result[row : row + 1])
        if len(scans):
            self._forget(int(scans.stamps_ms[-1]) - KEEP_MS)
        return result

    def corrections(self, tiles: Tiles) -> dict[TileKey, Cells]:
        """The own session's tiles that news of team-mates changes, with their new contents (``Writer.correct``).

        To be asked when all scans that ``masked`` gave are published; the changes it returns must be published then.

        Args:
            tiles: the own session's.
        """
        if self._news_from_ms is None:
            return {}
        first = bisect_left(self._sensed, self._news_from_ms, key=_stamp_ms)
        self._news_from_ms = None
        old: list[Scans] = []
        new: list[Scans] = []
        for row in range(first, len(self._sensed)):
            right = self._masked(self._sensed[row])
            if np.array_equal(right.ranges, self._published[row].ranges):
                continue
            if self._model.limit:
                self.counters["uncorrectable"] += 1
            else:
                old.append(self._published[row])
                new.append(right)
            self._published[row] = right  # under a limit too: it is counted once
        if not old:
            return {}
        self.counters["corrected"] += len(old)
        less = self._evidence(Scans.join(old))
        more = self._evidence(Scans.join(new))
        return added(tiles, merged([more, Evidence(less.keys, -less.cells)]))

    def _evidence(self, scans: Scans) -> Evidence:
        return self._kernel(rays_of(scans, self._sensor, self._lattice), self._model)

    def _forget(self, before_ms: int) -> None:
        count = bisect_left(self._sensed, before_ms, key=_stamp_ms)
        del self._sensed[:count], self._published[:count]
        for track in self._tracks.values():
            track.forget(before_ms - 2 * WINDOW_MS)

    def _masked(self, scans: Scans) -> Scans:
        """The scans without the readings that fall on a team-mate, by what is known now."""
        ranges = scans.ranges.copy()
        for row, stamp_ms in enumerate(scans.stamps_ms.tolist()):
            points = [point for track in self._tracks.values() for point in track.around(stamp_ms)]
            if points:
                fell = falls_on(scans.poses[row], scans.ranges[row], self._sensor, np.array(points, np.float64))
                ranges[row, fell] = INVALID
        return Scans(scans.stamps_ms, scans.poses, ranges)


def falls_on(
    pose: NDArray[np.int32], ranges: NDArray[np.uint16], sensor: Sensor, points_mm: Points
) -> NDArray[np.bool_]:
    """Which readings of a scan fall on a robot whose centre is at one of some points, shape (B,).

    A wide beam's reading may have come from anywhere on its arc: the nearest place counts.

    Args:
        pose: x_mm, y_mm, yaw_turn16 of the scan.
        ranges: shape (B,), millimetres, ``INVALID`` or ``NO_RETURN``.
        sensor: whose readings they are.
        points_mm: shape (P, 2), x, y in the common frame, millimetres.
    """
    x_mm, y_mm, bearing, half_width = sensor.table.T
    x, y, yaw = pose.tolist()
    to_radians = 2 * np.pi / FULL_TURN
    c, s = np.cos(yaw * to_radians), np.sin(yaw * to_radians)
    dx = points_mm[:, :1] - (x + x_mm * c - y_mm * s)
    dy = points_mm[:, 1:] - (y + x_mm * s + y_mm * c)
    aside = np.arctan2(dy, dx) - (yaw + bearing) * to_radians
    off_beam = np.maximum(np.abs((aside + np.pi) % (2 * np.pi) - np.pi) - half_width * to_radians, 0.0)
    away = np.hypot(dx, dy)
    reach = ranges.astype(np.float64)
    squared = reach**2 + away**2 - 2 * reach * away * np.cos(off_beam)  # the law of cosines
    returned = (ranges != INVALID) & (ranges != NO_RETURN)
    return np.asarray(returned & (squared <= _FOOTPRINT_MM**2).any(axis=0))


def _stamp_ms(scan: Scans) -> int:
    return int(scan.stamps_ms[0])


def _poses(descriptor: Descriptor, update: Update) -> Scans:
    """Stamps and poses that an update carries, whatever its form."""
    if update.form == Update.SCANS:
        return decode_scans(update.payload, len(descriptor.sensor.beams), descriptor.sensor.max_range_mm)
    return decode_scans(update.trail, 0, descriptor.sensor.max_range_mm) if update.trail else Scans.empty(0)
