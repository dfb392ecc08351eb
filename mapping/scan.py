"""Pose-stamped range scans in whole numbers: what a robot senses, publishes, and maps from.

A robot maps from the quantised scan that it publishes, never from the raw reading, so that everybody who gets the
scan draws the same cells. Scans travel and are integrated in batches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.pose import COORDINATE_LIMIT, FULL_TURN
from mapping.sensor import Sensor

INVALID = 0
"""A reading that says nothing."""

NO_RETURN = 65535
"""Nothing within the sensor's range: the ray is free up to it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """A batch of N scans of one sensor with B beams.

    Attributes:
        stamps_ms: int64, shape (N,), milliseconds since the session's own epoch. Data for viewers, never for order.
        poses: int32, shape (N, 3): x_mm, y_mm, yaw_turn16 (0 ... 65535) of the robot in the common frame.
        ranges: uint16, shape (N, B): millimetres along the beam, ``INVALID`` or ``NO_RETURN``.
    """

    stamps_ms: NDArray[np.int64]
    poses: NDArray[np.int32]
    ranges: NDArray[np.uint16]

    def __post_init__(self) -> None:
        stamps, poses, ranges = self.stamps_ms.shape, self.poses.shape, self.ranges.shape
        if len(stamps) != 1 or poses != (*stamps, 3) or len(ranges) != 2 or ranges[:1] != stamps:
            raise ValueError(
                f"scans: expected stamps (N,), poses (N, 3) and ranges (N, B), got {stamps}, {poses} and {ranges}"
            )

    def __len__(self) -> int:
        return len(self.stamps_ms)

    def __getitem__(self, rows: slice) -> Self:
        return type(self)(self.stamps_ms[rows], self.poses[rows], self.ranges[rows])

    @property
    def beams(self) -> int:
        """Readings a scan."""
        return int(self.ranges.shape[1])

    @classmethod
    def empty(cls, beams: int) -> Self:
        """No scans of a sensor with that many beams."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3), np.int32), np.zeros((0, beams), np.uint16))

    @classmethod
    def join(cls, batches: Sequence[Scans]) -> Self:
        """One batch out of several (at least one) of the same sensor."""
        return cls(
            np.concatenate([batch.stamps_ms for batch in batches]),
            np.concatenate([batch.poses for batch in batches]),
            np.concatenate([batch.ranges for batch in batches]),
        )


def quantise(stamps: ArrayLike, poses: ArrayLike, ranges: ArrayLike, sensor: Sensor) -> Scans:
    """Round raw scans to the whole numbers that are published; the only place where this is done.

    Args:
        stamps: shape (N,), seconds.
        poses: shape (N, 3), x, y, yaw of the robot in the common frame; metres and radians.
        ranges: shape (N, B), metres along each beam; infinity is "nothing in range", and so is whatever rounds to
            more than the sensor's range; NaN is invalid, and so is whatever rounds to less than a millimetre.
        sensor: gives the number of beams and the range.

    Raises:
        ValueError: a shape is wrong, a stamp or a pose is not finite, a pose lies beyond 1000 km.
    """
    stamps = np.asarray(stamps, dtype=np.float64)
    poses = np.asarray(poses, dtype=np.float64)
    ranges = np.asarray(ranges, dtype=np.float64)
    if ranges.ndim != 2 or ranges.shape[1] != len(sensor.beams):
        raise ValueError(f"ranges: expected (N, {len(sensor.beams)}), got {ranges.shape}")
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise ValueError(f"poses: expected (N, 3), got {poses.shape}")
    if not np.isfinite(stamps).all():
        row = int(np.argmin(np.isfinite(stamps)))
        raise ValueError(f"stamps: scan {row} is at {stamps.flat[row]}, expected a finite number")
    bad = ~(np.isfinite(poses).all(axis=1) & (np.abs(poses[:, :2]) <= COORDINATE_LIMIT).all(axis=1))
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(f"poses: scan {row} is at {poses[row].tolist()}, expected finite numbers within 1000 km")
    whole = np.empty((len(poses), 3), np.int32)
    whole[:, :2] = np.rint(poses[:, :2] * 1000)
    whole[:, 2] = np.rint(poses[:, 2] / (2 * np.pi) * FULL_TURN) % FULL_TURN
    with np.errstate(invalid="ignore", over="ignore"):
        millimetres = np.rint(ranges * 1000)
        far = millimetres > sensor.max_range_mm
        valid = millimetres >= 1
    readings = np.where(far, NO_RETURN, np.where(valid, millimetres, INVALID)).astype(np.uint16)
    return Scans(np.rint(stamps * 1000).astype(np.int64), whole, readings)
