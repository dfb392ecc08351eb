"""The simulated robot's firmware: its hello, its samples, its watchdog."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.kinematics import ORION_CHASSIS
from agent.microcontroller import Microcontroller
from agent.simulator import Readings
from mapping.sensor import orion
from transport.mcu_frames import RANGE_INVALID, RANGE_NOTHING, RANGE_VALID, Drive, Heartbeat, Range, decode, encode


def robot() -> Microcontroller:
    return Microcontroller(1, orion(), ORION_CHASSIS, 100)


def readings(stamp_ms: int = 100, *, ticks: int = 0, heading: float = 0.0, metres: float = 0.5) -> Readings:
    """Of two robots; ours is the second."""
    return Readings(
        stamp_ms, np.array([[7, 7], [ticks, -ticks]]), np.array([1.0, heading]), np.array([[0.1] * 5, [metres] * 5])
    )


def test_its_hello_says_what_it_is_made_of() -> None:
    hello = robot().hello
    assert (hello.ticks_per_metre, hello.wheel_base_um, hello.sample_period_ms) == (13_926, 100_000, 100)
    assert hello.max_range_mm == 800
    assert [tuple(beam) for beam in hello.beams] == [tuple(beam) for beam in orion().beams]
    assert hello.clock_ms > 0
    assert decode(encode(hello)) == hello


def test_it_says_hello_when_asked_and_only_then() -> None:
    ours = robot()
    assert ours.hear(Heartbeat(0, 1, 0, 0), 0) == [ours.hello]
    assert ours.hear(Heartbeat(1, 0, 0, 0), 0) == []


def test_a_sample_is_the_robots_own_part_of_the_readings() -> None:
    sample = robot().sample(readings(1200, ticks=345, heading=math.pi / 2, metres=0.1234))
    assert (sample.stamp_ms, sample.left_ticks, sample.right_ticks) == (1200, 345, -345)
    assert (sample.heading_turn16, sample.heading_valid) == (16384, 1)
    assert sample.ranges == (Range(123, RANGE_VALID),) * 5


@pytest.mark.parametrize(("metres", "status"), [(math.inf, RANGE_NOTHING), (math.nan, RANGE_INVALID)])
def test_readings_that_are_none_have_a_status(metres: float, status: int) -> None:
    assert robot().sample(readings(metres=metres)).ranges == (Range(0, status),) * 5


def test_samples_are_counted() -> None:
    ours = robot()
    assert [ours.sample(readings()).sequence for _ in range(3)] == [0, 1, 2]


def test_all_counters_wrap_as_their_fields_do() -> None:
    ours = robot()
    ours._samples = 1 << 16  # two hours of them
    sample = ours.sample(readings((1 << 32) + 5, ticks=(1 << 31) + 3, heading=-7 * math.pi))
    assert (sample.sequence, sample.stamp_ms) == (0, 5)
    assert (sample.left_ticks, sample.right_ticks) == (3 - (1 << 31), (1 << 31) - 3)
    assert decode(encode(sample)) == sample
    beat = ours.beat({"good": (1 << 32) + 2})
    assert decode(encode(beat)) == beat


def test_wheels_turn_as_told_for_as_long_as_told() -> None:
    ours = robot()
    assert ours.wheels(0) == (0.0, 0.0)
    ours.hear(Drive(0, 120, -80, 300), 1000)
    assert ours.wheels(1000) == ours.wheels(1299) == (0.12, -0.08)
    assert ours.wheels(1300) == (0.0, 0.0)


def test_a_new_command_replaces_the_old_and_starts_the_time_anew() -> None:
    ours = robot()
    ours.hear(Drive(0, 120, -80, 300), 1000)
    ours.hear(Drive(1, 50, 50, 300), 1200)
    assert ours.wheels(1499) == (0.05, 0.05)
    ours.hear(Drive(1, 50, 50, 0), 1300)
    assert ours.wheels(1300) == (0.0, 0.0)


def test_only_an_answer_to_the_newest_sample_counts() -> None:
    ours = robot()
    ours.sample(readings())
    newest = ours.sample(readings()).sequence
    ours.hear(Drive(newest - 1, 0, 0, 300), 0)
    assert not ours.has_answered
    ours.hear(Drive(newest, 0, 0, 300), 0)
    assert ours.has_answered
    ours.sample(readings())
    assert not ours.has_answered


def test_heartbeats_are_counted_and_tell_of_the_line() -> None:
    ours = robot()
    beats = [ours.beat({"good": 3, "damaged": 1}) for _ in range(2)]
    assert beats == [Heartbeat(0, 0, 3, 1), Heartbeat(1, 0, 3, 1)]
