"""A recorded run: one value whatever the file's format, and the checks that all formats share.

Laws kept here: a recording is kept as it was recorded (its own frame, its own stamps); start pose and rounding come
in once, when a body is made of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.errors import UserError
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
