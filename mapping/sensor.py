"""Range sensors as tables of beams: where each beam starts on the robot, where it looks, how far it sees.

Laws kept here: a sensor is configuration, not code. The paper measures bearings from the robot's right (Table I);
this file is the only place that knows, and it converts to x forward, counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.pose import FULL_TURN, to_turn16

MAX_RANGE_LIMIT_MM = 65_000
"""Ranges travel as uint16 millimetres; 65535 means "nothing in range"."""

MAX_HALF_WIDTH_TURN16 = FULL_TURN // 4
"""A wider beam than half a turn would look behind itself."""

MAX_WIDTHS_TURN16 = FULL_TURN
"""The half-widths of all beams together: two full turns of view. It bounds the rays that one scan can draw."""


class Beam(NamedTuple):
    """One beam in the robot's frame.

    Attributes:
        x_mm: where it starts, forward of the robot's centre.
        y_mm: where it starts, left of the robot's centre.
        bearing_turn16: where it looks, counter-clockwise from forward, 1/65536 turn.
        half_width_turn16: half of its field of view; 0 is a thin ray. A reading of a wide beam came from somewhere in
            it (``mapping.rays.fan``); a VL53L0X sees 25 degrees in all (its data sheet, section 1.1), so 2276.
    """

    x_mm: int
    y_mm: int
    bearing_turn16: int
    half_width_turn16: int = 0


@dataclass(frozen=True, slots=True)
class Sensor:
    """A rigid set of beams that are read together.

    Attributes:
        beams: in the order of a scan's ranges.
        max_range_mm: a reading beyond it is "nothing in range" and frees its ray up to here.

    Raises:
        ValueError: no beams, too many, too wide ones, or a number that cannot be published.
    """

    beams: tuple[Beam, ...]
    max_range_mm: int

    def __post_init__(self) -> None:
        if not 1 <= len(self.beams) <= 4096:
            raise ValueError(f"sensor: {len(self.beams)} beams, expected 1 to 4096")
        if not 1 <= self.max_range_mm <= MAX_RANGE_LIMIT_MM:
            raise ValueError(
                f"sensor: max_range {self.max_range_mm / 1000} m, expected 0.001 to {MAX_RANGE_LIMIT_MM / 1000} m"
            )
        for beam in self.beams:
            if max(abs(beam.x_mm), abs(beam.y_mm)) > 32767:
                raise ValueError(f"sensor: a beam starts at ({beam.x_mm}, {beam.y_mm}) mm, expected within 32.767 m")
            if not 0 <= beam.bearing_turn16 < FULL_TURN:
                raise ValueError(f"sensor: a beam's bearing is {beam.bearing_turn16}, expected 0 to {FULL_TURN - 1}")
            if not 0 <= beam.half_width_turn16 <= MAX_HALF_WIDTH_TURN16:
                raise ValueError(
                    f"sensor: half_width {beam.half_width_turn16}/65536 turn, expected 0 to {MAX_HALF_WIDTH_TURN16}"
                )
        if (total := sum(beam.half_width_turn16 for beam in self.beams)) > MAX_WIDTHS_TURN16:
            raise ValueError(
                f"sensor: half_widths of {total}/65536 turn in all, "
                f"expected at most {MAX_WIDTHS_TURN16} (two turns of view)"
            )

    def __hash__(self) -> int:
        return hash((len(self.beams), self.beams[0], self.max_range_mm))  # kernels look a sensor up in each call

    @property
    def table(self) -> NDArray[np.int64]:
        """The beams as an array, shape (B, 4): x_mm, y_mm, bearing_turn16, half_width_turn16."""
        return np.array(self.beams, dtype=np.int64).reshape(-1, 4)


def sensor(beams: Sequence[tuple[float, float, float]], max_range: float) -> Sensor:
    """A sensor from SI units.

    Args:
        beams: x, y (metres) and bearing (radians, counter-clockwise from forward) of each beam.
        max_range: metres.
    """
    quantised = tuple(Beam(round(x * 1000), round(y * 1000), to_turn16(bearing)) for x, y, bearing in beams)
    return Sensor(quantised, round(max_range * 1000))


TABLE_I = (0.0, math.pi / 4, math.pi / 2, 3 * math.pi / 4, math.pi)
"""The paper's bearings in radians from the robot's right: right, right diagonal, front, left diagonal, left."""

ORION_RANGE = 0.8
"""Metres a VL53L0X measures well (section II.A)."""

ORION_OFFSET = 0.03
"""d_RS of eq. 2 in metres: the ranging module sits this far ahead of the centre. The paper prints no number."""


def orion(max_range: float = ORION_RANGE, *, view: float = 0.0) -> Sensor:
    """The paper's ranging module: five VL53L0X, pi/4 apart, bearings of Table I, offset d_RS forward (eq. 2).

    Args:
        max_range: metres.
        view: each beam's field of view, radians; 0 is a thin ray, as in the paper.
    """
    thin = sensor([(ORION_OFFSET, 0.0, phi - math.pi / 2) for phi in TABLE_I], max_range)
    half_width = round(view / 2 / math.tau * FULL_TURN)
    return Sensor(tuple(beam._replace(half_width_turn16=half_width) for beam in thin.beams), thin.max_range_mm)


def laser(beams: int, *, first: float, step: float, max_range: float) -> Sensor:
    """A laser scanner at the robot's centre.

    Args:
        beams: how many readings a scan has.
        first: bearing of beam 0 in radians, counter-clockwise from forward.
        step: radians from one beam to the next.
        max_range: metres.
    """
    return sensor([(0.0, 0.0, first + k * step) for k in range(beams)], max_range)
