"""The paper's moving average of the heading (section II), done on the circle: the mean of unit vectors.

Laws kept here: angles never wrap where they are averaged (359 and 1 degrees have the mean 0, not 180); the average says
nothing before its window is full, so that its lag is always the same.

An average over N samples lags: of a heading that turns steadily it gives the value of (N - 1) / 2 samples ago. A robot
that turns at 1 rad/s, sampled at 50 Hz with N = 8, would be stamped 4 degrees behind. ``agent.odometry`` therefore
averages not the heading but its *difference* from the encoders' heading, which stands still while the robot turns: the
lag is removed by the encoders' turn rate, and only what the encoders get wrong (slip, a wrong wheel base) is seen late.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace


def wrapped(angle: float) -> float:
    """The same direction in [-pi, pi]."""
    return math.remainder(angle, math.tau)


@dataclass(frozen=True, slots=True)
class MovingAverage:
    """The mean direction of the last ``window`` angles. A value: ``pushed`` gives the next one.

    Attributes:
        window: N, how many angles are averaged; 1 is no filter.
        vectors: the last angles as unit vectors, oldest first.

    Raises:
        ValueError: the window has no sample.
    """

    window: int
    vectors: tuple[complex, ...] = ()

    def __post_init__(self) -> None:
        if self.window < 1:
            raise ValueError(f"heading filter: a window of {self.window} samples, expected 1 or more")

    def pushed(self, angle: float) -> MovingAverage:
        """The average after one more angle, radians."""
        return replace(self, vectors=(*self.vectors, cmath.rect(1.0, angle))[-self.window :])

    @property
    def mean(self) -> float | None:
        """Radians in [-pi, pi]; None before the window is full, or where the angles cancel out."""
        total = sum(self.vectors)
        if len(self.vectors) < self.window or abs(total) < 1e-9 * self.window:
            return None
        return math.atan2(total.imag, total.real)  # cmath.phase raises OverflowError where the result is subnormal

    @property
    def lag(self) -> float:
        """By how many samples the mean of a steadily turning angle is behind: (N - 1) / 2."""
        return (self.window - 1) / 2
