"""Dead reckoning: arcs are exact, counters wrap, the heading sensor leads without lag and may fail."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.heading import wrapped
from agent.odometry import Odometry, Ticks, Wheels, along_arc, ticks_between
from mapping.pose import Pose

WHEELS = Wheels(10_000, 0.1)
metres = st.floats(-2, 2)
turns = st.floats(-6, 6)
ZERO = Ticks(0, 0)
int32 = st.integers(-(2**31), 2**31 - 1)


def wrap32(count):
    return (count + 2**31) % 2**32 - 2**31


def assert_same(a, b, tolerance=1e-9):
    assert math.hypot(a.x - b.x, a.y - b.y) <= tolerance
    assert abs(wrapped(a.yaw - b.yaw)) <= tolerance


class Truth:
    """An ideal robot with fine encoders and a heading sensor whose zero lies anywhere."""

    def __init__(self, north=2.0, start=ZERO):
        self.pose = Pose()
        self.north = north
        self.start = start
        self.left = self.right = 0.0

    def roll(self, left, right):
        self.left += left
        self.right += right
        self.pose = along_arc(self.pose, (left + right) / 2, (right - left) / WHEELS.base)

    @property
    def ticks(self):
        count = WHEELS.ticks_per_metre
        return Ticks(
            wrap32(self.start.left + round(self.left * count)), wrap32(self.start.right + round(self.right * count))
        )

    @property
    def heading(self):
        return wrapped(self.pose.yaw + self.north)


# The arc


@given(metres, turns)
def test_an_arc_in_one_go_is_the_arc_in_two_halves(distance, turn):
    whole = along_arc(Pose(1, 2, 0.3), distance, turn)
    half = along_arc(along_arc(Pose(1, 2, 0.3), distance / 2, turn / 2), distance / 2, turn / 2)
    assert_same(whole, half)


@given(metres, turns)
def test_an_arc_is_the_limit_of_small_straight_steps(distance, turn):
    angles = (np.arange(20_000) + 0.5) / 20_000 * turn
    steps = distance / 20_000 * np.stack([np.cos(angles), np.sin(angles)])
    end = along_arc(Pose(), distance, turn)
    np.testing.assert_allclose([end.x, end.y], steps.sum(axis=1), atol=1e-6)


def test_a_full_circle_ends_where_it_began():
    assert_same(along_arc(Pose(), 1.0, math.tau), Pose())


@given(metres, turns, st.builds(Pose, metres, metres, turns))
def test_an_arc_backwards_is_the_way_back(distance, turn, start):
    assert_same(along_arc(along_arc(start, distance, turn), -distance, -turn), start)


# The counters


@given(int32, st.integers(-(2**31), 2**31 - 1))
def test_counters_wrap(before, step):
    assert ticks_between(before, wrap32(before + step)) == step


rolls = st.lists(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), min_size=1, max_size=30)


@given(rolls, int32, int32)
def test_where_the_counters_begin_makes_no_difference(steps, left, right):
    zero, other = Truth(), Truth(start=Ticks(left, right))
    one, two = Odometry.start(WHEELS, zero.ticks), Odometry.start(WHEELS, other.ticks)
    for step in steps:
        zero.roll(*step)
        other.roll(*step)
        one, two = one.moved(zero.ticks, zero.heading), two.moved(other.ticks, other.heading)
    assert one.pose == two.pose


# The heading


@given(rolls, st.floats(-3, 3), st.integers(1, 8), st.booleans())
def test_an_ideal_robot_knows_where_it_is_at_every_sample(steps, north, window, valid):
    """Whatever the heading's zero, the filter's window, and whether there is a heading at all: no lag, no error."""
    truth = Truth(north)
    odometry = Odometry.start(WHEELS, truth.ticks, window)
    for step in steps:
        truth.roll(*step)
        odometry = odometry.moved(truth.ticks, truth.heading if valid else None)
        assert_same(odometry.pose, truth.pose, 0.02)  # a tick of 0.1 mm over a base of 0.1 m is 1 mrad


def test_the_filter_has_no_lag_while_the_robot_turns():
    """1 rad/s, ten samples a second, N = 8: a plain average of the heading would be 0.35 rad behind."""
    truth = Truth()
    odometry = Odometry.start(WHEELS, truth.ticks, 8)
    for _ in range(40):
        truth.roll(-0.005, 0.005)
        odometry = odometry.moved(truth.ticks, truth.heading)
        assert abs(odometry.pose.yaw - truth.pose.yaw) < 1e-9


def slipping(truth, odometry, steps, *, valid=True):
    """Wheels that turn a tenth more than the robot does."""
    for _ in range(steps):
        truth.roll(-0.005, 0.005)
        truth.left -= 0.0005
        truth.right += 0.0005
        odometry = odometry.moved(truth.ticks, truth.heading if valid else None)
    return odometry


def test_what_the_encoders_get_wrong_is_seen_with_the_filters_lag_and_no_more():
    """A tenth too much at 0.1 rad a sample: 0.01 rad a sample, times (8 - 1) / 2 samples."""
    truth = Truth()
    odometry = Odometry.start(WHEELS, truth.ticks, 8)
    for _ in range(8):
        odometry = odometry.moved(truth.ticks, truth.heading)
    odometry = slipping(truth, odometry, 50)
    assert odometry.pose.yaw - truth.pose.yaw == pytest.approx(0.01 * 3.5, abs=1e-6)
    for _ in range(8):
        odometry = odometry.moved(truth.ticks, truth.heading)
    assert odometry.pose.yaw - truth.pose.yaw == pytest.approx(0.0, abs=1e-9)


def test_without_a_valid_heading_the_encoders_lead_and_afterwards_the_sensor_again():
    truth = Truth()
    odometry = Odometry.start(WHEELS, truth.ticks, 4)
    for _ in range(4):
        odometry = odometry.moved(truth.ticks, truth.heading)
    odometry = slipping(truth, odometry, 20, valid=False)
    assert odometry.pose.yaw - truth.pose.yaw == pytest.approx(0.2, abs=1e-6)
    for _ in range(4):
        odometry = odometry.moved(truth.ticks, truth.heading)
    assert odometry.pose.yaw - truth.pose.yaw == pytest.approx(0.0, abs=1e-9)


def test_the_heading_counts_from_what_it_first_said():
    odometry = Odometry.start(WHEELS, Ticks(0, 0), 2)
    for heading in (3.0, 3.0, 3.1, 3.1):
        odometry = odometry.moved(Ticks(0, 0), heading)
    assert odometry.pose.yaw == pytest.approx(0.1)


def test_a_heading_that_crosses_the_wrap_many_times_goes_on():
    truth = Truth()
    odometry = Odometry.start(WHEELS, truth.ticks, 4)
    for _ in range(400):
        truth.roll(-0.01, 0.01)
        odometry = odometry.moved(truth.ticks, truth.heading)
    assert odometry.pose.yaw == pytest.approx(80.0)


def test_heading_noise_is_filtered():
    random = np.random.default_rng(1)
    errors = {}
    for window in (1, 16):
        odometry = Odometry.start(WHEELS, Ticks(0, 0), window)
        yaws = []
        for noise in random.normal(0, 0.01, 2000):
            odometry = odometry.moved(Ticks(0, 0), noise)
            yaws.append(odometry.pose.yaw)
        errors[window] = np.std(yaws[100:])
    assert errors[16] == pytest.approx(errors[1] / 4, rel=0.2)


# A restart


@given(rolls, int32, st.floats(-3, 3))
def test_a_restart_moves_nothing(steps, count, north):
    """Counters and heading begin anew elsewhere; the place and what follows are as if nothing had happened."""
    truth = Truth()
    odometry = Odometry.start(WHEELS, truth.ticks, 3)
    for step in steps:
        truth.roll(*step)
        odometry = odometry.moved(truth.ticks, truth.heading)
    before = odometry.pose
    truth.start = Ticks(count, wrap32(-count))
    truth.north = north
    odometry = odometry.recounted(truth.ticks)
    assert_same(odometry.pose, before)
    for step in steps:
        truth.roll(*step)
        odometry = odometry.moved(truth.ticks, truth.heading)
    assert_same(odometry.pose, truth.pose, 0.05)


@pytest.mark.parametrize("measures", [(0, 0.1), (100, 0), (-1, 0.1), (100, math.nan)])
def test_wheels_without_measure_are_refused(measures):
    with pytest.raises(ValueError, match="positive"):
        Wheels(*measures)
