"""Readings as values: placed in the common frame they become scans, all bits the same whenever that is done."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.readings import FARTHEST_START_MM, REACH, Readings
from mapping.pose import Pose, QuantisedPose
from mapping.scan import INVALID, NO_RETURN
from mapping.sensor import laser

SENSOR = laser(3, first=-0.5, step=0.5, max_range=5.0)
starts = st.builds(QuantisedPose, st.integers(-9000, 9000), st.integers(-9000, 9000), st.integers(0, 65535))


def readings(poses, stamps_ms=None):
    count = len(poses)
    stamps = np.arange(count) if stamps_ms is None else stamps_ms
    return Readings(np.array(stamps, np.int64), np.array(poses, float), np.tile([1.0, np.nan, np.inf], (count, 1)))


def test_the_start_pose_comes_before_the_sensed_ones():
    """A quarter turn to the left at (1 m, 2 m)."""
    scans = readings([(0, 0, 0), (1, 0, 0)]).scans(QuantisedPose(1000, 2000, 16384), SENSOR)
    assert scans.poses.tolist() == [[1000, 2000, 16384], [1000, 3000, 16384]]


def test_ranges_keep_their_meaning():
    scans = readings([(0, 0, 0)]).scans(QuantisedPose(0, 0, 0), SENSOR)
    assert scans.ranges.tolist() == [[1000, INVALID, NO_RETURN]]


@given(st.lists(st.tuples(*[st.floats(-50, 50)] * 3), min_size=1, max_size=40), starts)
def test_placed_together_or_one_by_one_they_are_the_same_bits(poses, start):
    """A body places its robot one pose at a time, a correction thousands at once."""
    together = readings(poses).scans(start, SENSOR).poses
    for row, (x, y, yaw) in enumerate(poses):
        alone = readings([(x, y, yaw)]).scans(start, SENSOR).poses[0]
        assert together[row].tolist() == alone.tolist() == list(QuantisedPose.of(start.pose() @ Pose(x, y, yaw)))


@given(st.integers(0, 2**42))
def test_stamps_are_kept_to_the_millisecond(stamp_ms):
    assert readings([(0, 0, 0)], [stamp_ms]).scans(QuantisedPose(0, 0, 0), SENSOR).stamps_ms.tolist() == [stamp_ms]


@pytest.mark.parametrize("turn16", range(0, 65536, 8192))
def test_the_farthest_reading_of_the_robot_that_started_farthest_out_is_still_on_the_map(turn16):
    start = QuantisedPose(FARTHEST_START_MM, -FARTHEST_START_MM, turn16)
    assert len(readings([(REACH, REACH, math.pi), (-REACH, REACH, 0.0)]).scans(start, SENSOR)) == 2


def test_shapes_that_do_not_belong_together_are_refused():
    with pytest.raises(ValueError, match=r"poses \(N, 3\)"):
        Readings(np.zeros(2, np.int64), np.zeros((1, 3)), np.zeros((2, 3)))
    assert len(Readings.empty(3)) == 0
