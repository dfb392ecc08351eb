"""The firmware of a simulated robot: what its microcontroller says, and how it obeys, as the real one should.

Laws kept here: it speaks the frames of ``transport.mcu_frames`` and knows no port; a drive command holds for as long as
it says and no longer; every number that a frame's field cannot hold is wrapped or cut to it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agent.kinematics import Chassis
from agent.simulator import Readings
from mapping.pose import to_turn16
from mapping.sensor import Sensor
from transport.mcu_frames import (
    RANGE_INVALID,
    RANGE_NOTHING,
    RANGE_VALID,
    Beam,
    Drive,
    Frame,
    Heartbeat,
    Hello,
    Range,
    Sample,
)

FIRMWARE = 1
CLOCK_MS = 1000
"""Swarm time begins a second before the stamps of all simulated robots do: 0 would say that they do not know it."""

_CALIBRATED = 3


class Microcontroller:
    """One robot's.

    Args:
        robot: which row of the readings is its own.
        sensor: its ranging module.
        chassis: what the robot is made of.
        period_ms: from one sample to the next.

    Attributes:
        hello: what the robot is made of.
        has_answered: whether the computer has answered the newest sample.
    """

    def __init__(self, robot: int, sensor: Sensor, chassis: Chassis, period_ms: int) -> None:
        self._robot = robot
        self.hello = Hello(
            firmware=FIRMWARE,
            ticks_per_metre=chassis.ticks_per_metre,
            wheel_base_um=round(chassis.wheel_base * 1e6),
            sample_period_ms=period_ms,
            max_range_mm=sensor.max_range_mm,
            heading_calibration=_CALIBRATED,
            clock_ms=CLOCK_MS,
            beams=tuple(Beam(*beam) for beam in sensor.beams),
        )
        self._samples = 0
        self._beats = 0
        self._drive = Drive(answers=0, left_mm_s=0, right_mm_s=0, valid_ms=0)
        self._drive_ends_ms = 0
        self.has_answered = False

    def hear(self, frame: Drive | Heartbeat, now_ms: int) -> list[Frame]:
        """Take in what the computer says; gives what is to be said to that."""
        if isinstance(frame, Heartbeat):
            return [self.hello] if frame.ask_hello else []
        self._drive = frame
        self._drive_ends_ms = now_ms + frame.valid_ms
        self.has_answered |= frame.answers == (self._samples - 1) % (1 << 16)
        return []

    def wheels(self, now_ms: int) -> tuple[float, float]:
        """The speeds that the wheels are to have now, metres a second: none, once the last command has run out."""
        if now_ms >= self._drive_ends_ms:
            return 0.0, 0.0
        return self._drive.left_mm_s / 1000, self._drive.right_mm_s / 1000

    def sample(self, readings: Readings) -> Sample:
        """The robot's part of what all of them sense; from now on this is the newest sample."""
        left, right = (int(count) for count in readings.ticks[self._robot].astype(np.int32))
        sample = Sample(
            sequence=self._samples % (1 << 16),
            stamp_ms=readings.stamp_ms % (1 << 32),
            left_ticks=left,
            right_ticks=right,
            heading_turn16=to_turn16(float(readings.headings[self._robot])),
            heading_valid=1,
            ranges=tuple(_range(metres) for metres in readings.ranges[self._robot].tolist()),
        )
        self._samples += 1
        self.has_answered = False
        return sample

    def beat(self, counters: Mapping[str, int]) -> Heartbeat:
        """The next heartbeat; the counters are those of its port."""
        self._beats += 1
        good, damaged = (counters.get(name, 0) % (1 << 32) for name in ("good", "damaged"))
        return Heartbeat(sequence=(self._beats - 1) % (1 << 16), ask_hello=0, good=good, damaged=damaged)


def _range(metres: float) -> Range:
    """One reading as the frame has it; see ``agent.simulator.Readings``."""
    if np.isnan(metres):
        return Range(0, RANGE_INVALID)
    if np.isinf(metres):
        return Range(0, RANGE_NOTHING)
    return Range(round(metres * 1000), RANGE_VALID)
