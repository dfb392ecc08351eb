"""What sensors make of the truth: the statistics of their noise, and whose dice they are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.senses import NO_NOISE, ORION_NOISE, RANGES, WHEELS, Dice, HeadingSensors, Noise, RangeSensors

MAX_RANGE = 0.8


def many_ranges(distance: float, noise: Noise, *, times: int = 4000) -> NDArray[np.float64]:
    sensors = RangeSensors(7, 1, 5, MAX_RANGE, noise)
    return np.concatenate([sensors.read(np.full((1, 5), distance)).ravel() for _ in range(times)])


@pytest.mark.parametrize("distance", [0.1, 0.3, 0.6])
def test_ranges_scatter_by_a_floor_and_a_share(distance: float) -> None:
    ranges = many_ranges(distance, replace(ORION_NOISE, dropout=0.0))
    assert ranges.mean() == pytest.approx(distance, abs=0.0005)
    assert ranges.std() == pytest.approx(0.003 + 0.01 * distance, rel=0.03)


def test_some_readings_drop_out() -> None:
    assert np.isnan(many_ranges(0.3, replace(ORION_NOISE, dropout=0.1))).mean() == pytest.approx(0.1, abs=0.01)


def test_what_is_too_near_is_invalid() -> None:
    noise = replace(NO_NOISE, range_minimum=0.04)
    assert np.isnan(many_ranges(0.039, noise, times=1)).all()
    assert (many_ranges(0.041, noise, times=1) == 0.041).all()


def test_noise_alone_makes_no_reading_invalid_or_negative() -> None:
    """Touching a wall a noisy range may fall below zero; a sensor would still say "very near"."""
    assert many_ranges(0.0001, replace(ORION_NOISE, dropout=0.0, range_minimum=0.0)).min() >= 0.001


def test_what_lies_beyond_the_range_is_nothing() -> None:
    sensors = RangeSensors(7, 1, 3, MAX_RANGE, NO_NOISE)
    assert sensors.read(np.array([[0.8, 0.801, math.inf]])).tolist() == [[0.8, math.inf, math.inf]]


def test_a_heading_is_zero_in_the_north_and_counts_counter_clockwise() -> None:
    sensors = HeadingSensors(7, 2, 0.1, NO_NOISE)
    np.testing.assert_allclose(sensors.read(np.array([math.pi / 2, math.pi])), [0.0, math.pi / 2])


def test_headings_scatter() -> None:
    sensors = HeadingSensors(7, 1, 0.1, replace(NO_NOISE, heading=0.01))
    errors = np.array([sensors.read(np.array([math.pi / 2]))[0] for _ in range(5000)])
    assert errors.std() == pytest.approx(0.01, rel=0.05)
    assert errors.mean() == pytest.approx(0.0, abs=0.001)


def test_headings_drift_slowly_from_a_right_start_to_a_known_spread() -> None:
    robots, noise = 400, replace(NO_NOISE, heading_drift=0.02, heading_drift_time=10.0)
    sensors = HeadingSensors(7, robots, 0.1, noise)
    yaws = np.full(robots, math.pi / 2)
    drifts = np.array([sensors.read(yaws) for _ in range(1000)])
    np.testing.assert_allclose(drifts[0], 0.0, atol=1e-12)
    assert drifts[100].std() == pytest.approx(0.02 * math.sqrt(1 - math.exp(-2)), rel=0.15)  # after one drift time
    assert drifts[500:].std() == pytest.approx(0.02, rel=0.1)
    step = np.diff(drifts, axis=0).std()
    assert step == pytest.approx(0.02 * math.sqrt(2 * (1 - math.exp(-0.01))), rel=0.05)


def test_the_same_seed_throws_the_same() -> None:
    one, other = Dice(3, WHEELS, 2, 2), Dice(3, WHEELS, 2, 2)
    for _ in range(200):
        np.testing.assert_array_equal(one.throw(), other.throw())


def test_seeds_robots_and_purposes_throw_differently() -> None:
    throws = [*Dice(3, WHEELS, 2, 2).throw(), *Dice(4, WHEELS, 1, 2).throw(), *Dice(3, RANGES, 1, 2).throw()]
    assert len({tuple(throw) for throw in throws}) == 4


def test_a_robots_dice_do_not_depend_on_how_many_there_are() -> None:
    alone, together = Dice(3, WHEELS, 1, 2), Dice(3, WHEELS, 5, 2)
    for _ in range(200):
        np.testing.assert_array_equal(alone.throw()[0], together.throw()[0])


def test_throws_are_standard_normal() -> None:
    dice = Dice(3, WHEELS, 3, 2)
    throws = np.array([dice.throw() for _ in range(3000)])
    assert throws.mean() == pytest.approx(0.0, abs=0.03)
    assert throws.std() == pytest.approx(1.0, abs=0.02)
