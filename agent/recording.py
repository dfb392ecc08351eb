"""Recorded runs: one value whatever the file's format, the way in, and the body that plays one back.

Laws kept here: a recording is kept as it was recorded (its own frame, its own stamps); start pose and rounding come
in once, when a body is made of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.body import BATCH
from agent.errors import UserError
from mapping.pose import QuantisedPose
from mapping.scan import Scans, quantise
from mapping.sensor import MAX_RANGE_LIMIT_MM, Sensor

POSES = ("truth", "odometry", "slam")
"""Which of a recording's trajectories to map with: motion capture, dead reckoning, or what a SLAM made of it."""

_COORDINATE_LIMIT = 100_000.0  # metres: no recorded robot drove further
_YAW_LIMIT = 100_000.0  # radians: an unwrapped heading stays far below
_STAMP_LIMIT = 1e10  # seconds: Unix time is below 2e9


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One robot's recorded run of N scans with B beams.

    Attributes:
        name: for messages and legends.
        stamps: float64, shape (N,), seconds from the run's start, as recorded: they may step backwards.
        poses: float64, shape (N, 3): x, y, yaw of the robot in the recording's frame, metres and radians.
        ranges: float64, shape (N, B), metres along the beams; NaN says nothing, infinity is "nothing in range".
        sensor: what the ranges mean.
    """

    name: str
    stamps: NDArray[np.float64]
    poses: NDArray[np.float64]
    ranges: NDArray[np.float64]
    sensor: Sensor

    def __post_init__(self) -> None:
        count, beams = len(self.stamps), len(self.sensor.beams)
        if count == 0 or self.poses.shape != (count, 3) or self.ranges.shape != (count, beams):
            raise ValueError(
                f"recording: expected at least 1 stamp, poses ({count}, 3) and ranges ({count}, {beams}), "
                f"got {count} stamps, {self.poses.shape} and {self.ranges.shape}"
            )

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def due(self) -> NDArray[np.float64]:
        """Seconds from the first scan at which each is given: float64, shape (N,), never decreasing.

        Where the recorded clock steps back, scans wait for nothing: they follow at once.
        """
        return np.asarray(np.maximum.accumulate(self.stamps) - self.stamps[0])


def read(path: Path, *, poses: str | None = None, max_range: float | None = None) -> list[Recording]:
    """The recordings in a file or folder, one a robot.

    Args:
        path: a CARMEN log (plain or gzip) or a nano_swarm folder.
        poses: one of ``POSES``; ``None`` takes the best that the recording has.
        max_range: metres, the sensor's range to map with; ``None`` is the format's default.

    Raises:
        UserError: whatever is wrong with the path, its content, or an argument.
    """
    from agent import carmen, nano_swarm

    if poses is not None and poses not in POSES:
        raise UserError("--poses", f"{poses!r} is unknown", f"choose one of {', '.join(POSES)}")
    try:
        exists, is_folder = path.exists(), path.is_dir()
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the path") from error
    if not exists:
        raise UserError(path, "there is no such file or folder", "check the path")
    if is_folder:
        return nano_swarm.read(path, poses=poses, max_range=max_range)
    return [carmen.read(path, poses=poses, max_range=max_range)]


def split(recording: Recording, parts: int) -> list[Recording]:
    """Consecutive pieces of equal path length, as if that many robots had shared the run; poses stay as they are.

    The path is the polyline through the scans' positions; a scan at a cut opens the next piece.

    Raises:
        UserError: a piece would have no scan.
    """
    if not 1 <= parts <= len(recording):
        raise UserError(recording.name, f"{len(recording)} scans cannot become {parts} robots", "choose other --robots")
    if parts == 1:
        return [recording]
    steps = np.diff(recording.poses[:, :2], axis=0)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    cuts = np.searchsorted(path, path[-1] * np.arange(1, parts) / parts)
    bounds = [0, *cuts.tolist(), len(recording)]
    pieces = list(pairwise(bounds))
    for number, (start, stop) in enumerate(pieces, start=1):
        if start == stop:
            raise UserError(
                recording.name,
                f"piece {number} of {parts} of its {path[-1]:.2f} m of path has no scan",
                "choose fewer --robots",
            )
    return [
        Recording(
            f"{recording.name} {number}/{parts}",
            recording.stamps[start:stop] - recording.stamps[start],
            recording.poses[start:stop],
            recording.ranges[start:stop],
            recording.sensor,
        )
        for number, (start, stop) in enumerate(pieces, start=1)
    ]


class RecordedBody:
    """A robot played back from a recording (implements ``Body``).

    Every scan is given once, in the recording's order, when its ``due`` time has passed; its published stamp is that
    time. Rounding happens here, once.

    Args:
        recording: what to play.
        start: ``T_common_start``: the recording's frame in the common frame.

    Raises:
        UserError: the start pose takes the recording out of the map's bounds.
    """

    def __init__(self, recording: Recording, start: QuantisedPose) -> None:
        self.sensor = recording.sensor
        self._due = recording.due
        poses_common = start.pose().compose(recording.poses)  # eq. 8
        try:
            self._scans = quantise(self._due, poses_common, recording.ranges, recording.sensor)
        except ValueError as error:
            raise UserError(recording.name, str(error), "check the robot's start pose") from error
        self._next = 0

    def read(self, until: float) -> Scans:
        """The next scans, at most ``BATCH``, that are due before ``until`` (seconds since the first scan)."""
        due = int(np.searchsorted(self._due, until))
        rows = slice(self._next, max(self._next, min(due, self._next + BATCH)))
        self._next = rows.stop
        return self._scans[rows]

    @property
    def progress(self) -> tuple[int, int]:
        """Scans given so far, and how many there are."""
        return self._next, len(self._scans)

    @property
    def done(self) -> bool:
        """Whether every scan has been given."""
        return self._next == len(self._scans)


def range_limit(max_range: float | None, default: float) -> float:
    """The user's range limit in metres, or the format's default.

    Raises:
        UserError: it is no length that a scan can carry.
    """
    limit = default if max_range is None else max_range
    if not 0.001 <= limit <= MAX_RANGE_LIMIT_MM / 1000:
        raise UserError("--max-range", f"{limit} m is out of bounds", f"choose 0.001 to {MAX_RANGE_LIMIT_MM / 1000} m")
    return limit


def check_pose(where: object, x: float, y: float, yaw: float) -> None:
    """Refuse a recorded pose that no robot had.

    Raises:
        UserError: a number is not finite or absurdly large.
    """
    sane = abs(x) <= _COORDINATE_LIMIT and abs(y) <= _COORDINATE_LIMIT and abs(yaw) <= _YAW_LIMIT
    if not sane:  # NaN compares false
        raise UserError(where, f"the pose ({x}, {y}, {yaw}) is none of a robot", "mend or delete the line")


def check_stamp(where: object, stamp: float) -> None:
    """Refuse a recorded time in seconds that no clock showed.

    Raises:
        UserError: it is not finite or absurdly large.
    """
    if not (math.isfinite(stamp) and abs(stamp) <= _STAMP_LIMIT):
        raise UserError(where, f"the stamp {stamp} is no time in seconds", "mend or delete the line")
