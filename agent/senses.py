"""What a simulated robot's sensors make of the truth: noise that grows, readings that drop out, a heading that drifts.

Laws kept here: every robot has dice of its own for each sense, thrown from the seed and its index alone, so that no
robot's noise depends on what another does.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np

from agent.geometry import Floats


@dataclass(frozen=True, slots=True)
class Noise:
    """What is wrong with what a robot senses and how it moves.

    Attributes:
        range_floor: standard deviation of a range near zero, metres.
        range_share: what is added to it per metre of range. The VL53L0X's data sheet (DS11555, "Ranging accuracy")
            gives 3 to 7 % for a fast reading of a far target; our 1 % is kinder and keeps a 2 cm map crisp: raise it
            to see what that does to a map.
        range_minimum: what is nearer is invalid, metres; ST's manuals for the family name 4 cm.
        dropout: probability that a reading is invalid.
        heading: standard deviation of one heading, radians (BNO055 behind the paper's moving average).
        heading_drift: standard deviation of the slow error that comes on top, radians; none at the start. The BNO055's
            data sheet promises no more than 2.5 degrees; a well-calibrated one does better.
        heading_drift_time: seconds in which that slow error forgets itself.
        slip: share of a wheel's way that is lost on the floor.
        slip_walk: standard deviation of a wheel's way after one metre, metres; grows with the root of the way.
    """

    range_floor: float = 0.003
    range_share: float = 0.01
    range_minimum: float = 0.04
    dropout: float = 0.005
    heading: float = radians(0.2)
    heading_drift: float = radians(0.3)
    heading_drift_time: float = 120.0
    slip: float = 0.002
    slip_walk: float = 0.002


ORION_NOISE = Noise()
"""A well-kept Orion."""

NO_NOISE = Noise(
    range_floor=0.0,
    range_share=0.0,
    range_minimum=0.0,
    dropout=0.0,
    heading=0.0,
    heading_drift=0.0,
    slip=0.0,
    slip_walk=0.0,
)
"""The robot knows where it is and how far it is to the wall."""

WHEELS, RANGES, DROPOUTS, HEADING, DRIFT = range(5)
"""What there are dice for."""

_BLOCK = 64


class Dice:
    """Standard normal numbers for N robots, drawn ahead because one by one they are slow.

    Args:
        seed: with ``purpose`` and the robot's index it decides every number.
        purpose: one of ``WHEELS`` ... ``DRIFT``.
        robots: N.
        count: how many numbers a robot gets at a time.
    """

    def __init__(self, seed: int, purpose: int, robots: int, count: int) -> None:
        self._generators = [np.random.default_rng((seed, robot, purpose)) for robot in range(robots)]
        self._count = count
        self._block: Floats = np.zeros((robots, 0, count))
        self._next = 0

    def throw(self) -> Floats:
        """The next numbers, shape (N, count)."""
        if self._next == self._block.shape[1]:
            self._block = np.stack([each.standard_normal((_BLOCK, self._count)) for each in self._generators])
            self._next = 0
        self._next += 1
        return self._block[:, self._next - 1]


class RangeSensors:
    """The ranging modules of N robots with B beams each."""

    def __init__(self, seed: int, robots: int, beams: int, max_range: float, noise: Noise) -> None:
        self._noise = noise
        self._max_range = max_range
        self._errors = Dice(seed, RANGES, robots, beams)
        self._dropouts = [np.random.default_rng((seed, robot, DROPOUTS)) for robot in range(robots)]
        self._beams = beams

    def read(self, distances: Floats) -> Floats:
        """Noisy ranges from true ones, shape (N, B), metres: infinity is nothing in range, NaN is invalid."""
        noise = self._noise
        sigma = noise.range_floor + noise.range_share * np.minimum(distances, self._max_range)
        ranges = np.maximum(distances + sigma * self._errors.throw(), 0.001)  # never less than a millimetre
        ranges[ranges > self._max_range] = np.inf
        dropped = np.array([each.random(self._beams) for each in self._dropouts]) < noise.dropout
        ranges[dropped | (distances < noise.range_minimum)] = np.nan
        return ranges


class HeadingSensors:
    """The BNO055 of each of N robots: 0 where the common frame's y axis points, as a compass reads 0 in the north."""

    NORTH = np.pi / 2

    def __init__(self, seed: int, robots: int, period: float, noise: Noise) -> None:
        self._noise = noise
        self._errors = Dice(seed, HEADING, robots, 1)
        self._walk = Dice(seed, DRIFT, robots, 1)
        self._kept = np.exp(-period / noise.heading_drift_time)
        self._drift: Floats = np.zeros(robots)

    def read(self, yaws: Floats) -> Floats:
        """Headings from true yaws, shape (N,), radians, not wrapped; to be called once a sample."""
        noise = self._noise
        headings = yaws - self.NORTH + self._drift + noise.heading * self._errors.throw()[:, 0]
        # A first-order Gauss-Markov process: its spread tends to heading_drift whatever the period.
        fresh = noise.heading_drift * np.sqrt(1 - self._kept**2) * self._walk.throw()[:, 0]
        self._drift = self._kept * self._drift + fresh
        return np.asarray(headings)
