"""From a microcontroller's frames to readings, in metres.

Laws kept here: what the sensors are is told by the robot itself, in its hello, so that another set of sensors is no
other program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapping.pose import FULL_TURN
from mapping.sensor import ORION_RANGE, Beam, Sensor
from transport.mcu_frames import RANGE_NOTHING, RANGE_VALID, Hello, Range


def sensor_of(hello: Hello, max_range: float = ORION_RANGE) -> Sensor:
    """The sensor that a robot says it has.

    Args:
        hello: its beams and how far they see.
        max_range: metres that are trusted at most. A VL53L0X reads farther than the 0.8 m that it measures well
            (section II.A): such a reading is "nothing in range" and frees its ray up to the limit.

    Raises:
        ValueError: it has no beams, or they are none that can be published.
    """
    return Sensor(tuple(Beam(*beam) for beam in hello.beams), min(hello.max_range_mm, round(max_range * 1000)))


def in_metres(ranges: Sequence[Range]) -> NDArray[np.float64]:
    """Readings as metres along their beams, shape (B,): NaN is invalid, infinity is "nothing in range"."""
    return np.array([_in_metres(*reading) for reading in ranges], dtype=np.float64)


def _in_metres(range_mm: int, status: int) -> float:
    if status == RANGE_VALID:
        return range_mm / 1000
    return math.inf if status == RANGE_NOTHING else math.nan


def points_seen(ranges: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Where the readings fall in the robot's frame, metres, shape (K, 2); only those within the sensor's range."""
    x_mm, y_mm, bearing_turn16, _ = sensor.table.T
    angle = bearing_turn16 / FULL_TURN * math.tau
    seen = np.isfinite(ranges) & (ranges * 1000 <= sensor.max_range_mm)
    reach = np.where(seen, ranges, 0.0)
    points = np.column_stack([x_mm / 1000 + reach * np.cos(angle), y_mm / 1000 + reach * np.sin(angle)])
    return points[seen]
