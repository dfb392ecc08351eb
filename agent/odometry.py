"""Where a differential drive is, from what its wheels and its heading sensor say (the paper, section II).

Laws kept here: x and y come from the encoders, the heading from the heading sensor, relative to what it said at the
start; where the sensor is not valid, the encoders' own heading goes on from there. Everything is a value: an odometry
and a reading give the next odometry. Poses are ``T_start_robot``; the common frame is one composition away (eq. 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from agent.heading import MovingAverage, wrapped
from mapping.pose import Pose

HEADING_WINDOW = 8
"""Samples that the heading's moving average spans; the paper gives no number. 0.16 s at 50 Hz."""


class Ticks(NamedTuple):
    """Both encoders' counts, int32: they wrap."""

    left: int
    right: int


@dataclass(frozen=True, slots=True)
class Wheels:
    """A differential drive's measures.

    Attributes:
        ticks_per_metre: encoder ticks of one wheel per metre it rolls.
        base: metres between the wheels' contact points.

    Raises:
        ValueError: a measure is not positive.
    """

    ticks_per_metre: float
    base: float

    def __post_init__(self) -> None:
        if not (self.ticks_per_metre > 0 and self.base > 0):
            raise ValueError(
                f"wheels: {self.ticks_per_metre} ticks a metre, base {self.base} m, expected positive numbers"
            )

    def rolled(self, before: Ticks, after: Ticks) -> tuple[float, float]:
        """Metres that the left and the right wheel rolled from one reading to the next."""
        return (
            ticks_between(before.left, after.left) / self.ticks_per_metre,
            ticks_between(before.right, after.right) / self.ticks_per_metre,
        )


def ticks_between(before: int, after: int) -> int:
    """The signed step from one int32 count to another, across the wrap: -2^31 ... 2^31 - 1."""
    return (after - before + 2**31) % 2**32 - 2**31


def along_arc(start: Pose, distance: float, turn: float) -> Pose:
    """Where a robot ends that drives ``distance`` metres while it turns by ``turn`` radians, both steadily: exact.

    An arc's chord is distance * sin(turn / 2) / (turn / 2) long and points half the turn aside.
    """
    half = turn / 2
    chord = distance * (math.sin(half) / half if half else 1.0)
    return Pose(
        start.x + chord * math.cos(start.yaw + half), start.y + chord * math.sin(start.yaw + half), start.yaw + turn
    )


@dataclass(frozen=True, slots=True)
class Odometry:
    """A robot's dead reckoning, up to one reading.

    The heading sensor counts through ``offsets``: the moving average of its difference from the encoders' heading,
    which has no lag while the robot turns (``agent.heading``). The first average is the reference; what it moves by
    afterwards is what the encoders got wrong. Without valid readings it stays as it is, and the encoders lead.

    Attributes:
        wheels: the drive's measures.
        ticks: the encoders' counts at this reading.
        pose: ``T_start_robot``; yaw counts on beyond half a turn.
        encoder_yaw: the heading as the encoders alone have it.
        offsets: the filtered difference between the heading sensor and the encoders.
        reference: the first such difference, if there is one yet.
    """

    wheels: Wheels
    ticks: Ticks
    pose: Pose
    encoder_yaw: float
    offsets: MovingAverage
    reference: float | None

    @classmethod
    def start(cls, wheels: Wheels, ticks: Ticks, window: int = HEADING_WINDOW) -> Self:
        """At rest in the origin of the start's frame."""
        return cls(wheels, ticks, Pose(), 0.0, MovingAverage(window), None)

    def moved(self, ticks: Ticks, heading: float | None) -> Odometry:
        """After the next reading.

        Args:
            ticks: the encoders' counts then.
            heading: radians as the sensor has it, in a frame of its own, or None if it is not valid.
        """
        left, right = self.wheels.rolled(self.ticks, ticks)
        encoder_yaw = self.encoder_yaw + (right - left) / self.wheels.base
        offsets = self.offsets if heading is None else self.offsets.pushed(heading - encoder_yaw)
        mean = offsets.mean
        reference = mean if self.reference is None else self.reference
        drift = 0.0 if mean is None or reference is None else mean - reference
        turn = wrapped(encoder_yaw + drift - self.pose.yaw)  # the drift may wrap
        pose = along_arc(self.pose, (left + right) / 2, turn)
        return replace(self, ticks=ticks, pose=pose, encoder_yaw=encoder_yaw, offsets=offsets, reference=reference)

    def recounted(self, ticks: Ticks) -> Odometry:
        """The same place, with counters that began anew: after a restart of the microcontroller.

        Its heading sensor has begun anew too: its next average is the new reference for the heading held now.
        """
        yaw = wrapped(self.pose.yaw)
        return replace(
            self,
            ticks=ticks,
            pose=replace(self.pose, yaw=yaw),
            encoder_yaw=yaw,
            offsets=MovingAverage(self.offsets.window),
            reference=None,
        )
