"""What a body senses, before anything is rounded: poses in the robot's start frame and ranges in metres.

Laws kept here: where the start frame lies in the common frame comes in last, together with the rounding, in one place;
so readings that are placed later become the very scans of a robot that was placed there from the beginning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mapping.pose import QuantisedPose
from mapping.scan import Scans, quantise
from mapping.sensor import Sensor

REACH = 100_000.0
"""Metres from its start, on each axis, that a robot may sense at: so that every start pose up to ``FARTHEST_START_MM``
leaves all its scans within the 1000 km of the common frame."""

FARTHEST_START_MM = 800_000_000
"""Millimetres from the origin, on each axis, that a robot may start at."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """N scans of one sensor with B beams, as they were sensed.

    Attributes:
        stamps_ms: int64, shape (N,), milliseconds of swarm time; never decreasing.
        poses: float64, shape (N, 3): ``T_start_robot``; x, y, yaw in metres and radians.
        ranges: float64, shape (N, B), metres along the beams; NaN says nothing, infinity is "nothing in range".
    """

    stamps_ms: NDArray[np.int64]
    poses: NDArray[np.float64]
    ranges: NDArray[np.float64]

    def __post_init__(self) -> None:
        stamps, poses, ranges = self.stamps_ms.shape, self.poses.shape, self.ranges.shape
        if len(stamps) != 1 or poses != (*stamps, 3) or len(ranges) != 2 or ranges[:1] != stamps:
            raise ValueError(
                f"readings: expected stamps (N,), poses (N, 3) and ranges (N, B), got {stamps}, {poses} and {ranges}"
            )

    def __len__(self) -> int:
        return len(self.stamps_ms)

    @classmethod
    def empty(cls, beams: int) -> Self:
        """No readings of a sensor with that many beams."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, beams)))

    def scans(self, start: QuantisedPose, sensor: Sensor) -> Scans:
        """The scans that a robot publishes which sensed this and whose start frame lies there (eq. 8).

        Args:
            start: ``T_common_start``.
            sensor: whose readings they are.
        """
        return quantise(self.stamps_ms / 1000, start.pose().compose(self.poses), self.ranges, sensor)
