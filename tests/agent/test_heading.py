"""The moving average of the heading: a mean on the circle, with a lag that is known."""

import cmath
import math

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from agent.heading import MovingAverage, wrapped

angles = st.floats(-100, 100)
windows = st.integers(1, 12)


def after(window, values):
    average = MovingAverage(window)
    for value in values:
        average = average.pushed(value)
    return average


def near(a, b, tolerance=1e-9):
    return abs(wrapped(a - b)) <= tolerance


@given(angles)
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle):
    assert abs(wrapped(angle)) <= math.pi
    assert abs(cmath.rect(1, angle) - cmath.rect(1, wrapped(angle))) < 1e-9


@given(windows, angles)
def test_the_mean_of_one_direction_is_that_direction(window, angle):
    assert near(after(window, [angle] * window).mean, angle)


@given(windows, st.lists(st.floats(-1, 1), min_size=12, max_size=12), angles)
@example(2, [0.0] * 11 + [5e-324], 0.0)
def test_turning_all_angles_turns_the_mean_wherever_the_wrap_lies(window, values, turn):
    mean = after(window, values).mean
    turned = after(window, [value + turn for value in values]).mean
    assert near(turned, mean + turn, 1e-6)


def test_just_left_and_just_right_of_the_wrap_have_their_mean_at_the_wrap():
    assert near(after(2, [math.radians(359), math.radians(1)]).mean, 0)
    assert near(after(2, [math.pi - 0.1, -math.pi + 0.1]).mean, math.pi)


@given(st.integers(2, 12), st.lists(angles, max_size=11))
def test_nothing_is_said_before_the_window_is_full(window, values):
    assume(len(values) < window)
    assert after(window, values).mean is None


def test_opposite_directions_have_no_mean():
    assert after(2, [0.0, math.pi]).mean is None


@given(windows, st.lists(angles, min_size=12, max_size=30))
def test_only_the_last_samples_count(window, values):
    assert after(window, values) == after(window, values[-window:])


@given(windows, st.floats(-0.2, 0.2), angles)
def test_a_steady_turn_is_seen_half_a_window_late(window, step, start):
    """The documented lag: (N - 1) / 2 samples."""
    average = after(window, [start + k * step for k in range(40)])
    assert average.lag == (window - 1) / 2
    assert near(average.mean, start + (39 - average.lag) * step, 1e-6)


def test_noise_is_averaged_out():
    """Alternating errors vanish in an even window."""
    assert near(after(8, [1.0 + 0.1 * (-1) ** k for k in range(20)]).mean, 1.0)


def test_a_window_without_samples_is_refused():
    with pytest.raises(ValueError, match="1 or more"):
        MovingAverage(0)
