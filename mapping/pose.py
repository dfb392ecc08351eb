"""Poses in the plane: SE(2) in metres and radians, and the whole numbers they are published as.

Laws kept here: x forward, y left, angles counter-clockwise (REP 103); a pose is quantised once, to whole
millimetres and 1/65536 turn, and everything that decides a cell starts from the quantised numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

FULL_TURN = 65536
"""Integer angles count 1/65536 turn (``turn16``): one unit is 0.0055 degrees and wraps with a uint16."""

COORDINATE_LIMIT = 1_000_000.0
"""Metres from the origin that a pose may lie at most, on each axis: 1000 km, whose millimetres fit an int32."""


def to_turn16(angle: float) -> int:
    """The nearest integer angle, 0 ... 65535, to ``angle`` in radians."""
    return round(angle / math.tau * FULL_TURN) % FULL_TURN


def from_turn16(turn16: int) -> float:
    """The integer angle in radians, in (-pi, pi]."""
    half = FULL_TURN // 2
    return (half - (half - turn16) % FULL_TURN) / FULL_TURN * math.tau


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose ``T_a_b``: it maps coordinates in frame b into frame a.

    Chains read by adjacency: ``T_common_start @ T_start_robot``.

    Attributes:
        x: metres.
        y: metres.
        yaw: radians, counter-clockwise from a's x axis to b's.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __matmul__(self, other: Pose) -> Pose:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose(self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y, self.yaw + other.yaw)

    def inverse(self) -> Pose:
        """``T_b_a`` of a ``T_a_b``."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)

    def apply(self, points_b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of frame b, shape (..., 2), in frame a (eq. 3 and 4)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y = points_b[..., 0], points_b[..., 1]
        return np.stack([self.x + c * x - s * y, self.y + s * x + c * y], axis=-1)

    def compose(self, poses_b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Many poses of frame b at once, shape (N, 3) of x, y, yaw, in frame a (eq. 8)."""
        yaw = poses_b[:, 2] + self.yaw
        return np.column_stack([self.apply(poses_b[:, :2]), yaw])


class QuantisedPose(NamedTuple):
    """A pose in whole millimetres and 1/65536 turn, as descriptors and scans carry it."""

    x_mm: int
    y_mm: int
    yaw_turn16: int

    @classmethod
    def of(cls, pose: Pose) -> Self:
        """The nearest quantised pose.

        Raises:
            ValueError: a number is not finite, or a coordinate lies beyond 1000 km.
        """
        for name, value in (("x", pose.x), ("y", pose.y), ("yaw", pose.yaw)):
            if not math.isfinite(value):
                raise ValueError(f"pose: {name} is {value}, expected a finite number")
        if max(abs(pose.x), abs(pose.y)) > COORDINATE_LIMIT:
            raise ValueError(f"pose: ({pose.x}, {pose.y}) lies more than 1000 km from the origin")
        return cls(round(pose.x * 1000), round(pose.y * 1000), to_turn16(pose.yaw))

    def pose(self) -> Pose:
        """Back to metres and radians."""
        return Pose(self.x_mm / 1000, self.y_mm / 1000, from_turn16(self.yaw_turn16))
