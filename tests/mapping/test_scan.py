import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.pose import Pose, QuantisedPose, from_turn16
from mapping.scan import INVALID, NO_RETURN, Scans, quantise
from mapping.sensor import Beam, Sensor

few = settings(max_examples=40, deadline=None)
ONE = Sensor((Beam(0, 0, 0),), 800)
THREE = Sensor((Beam(0, 0, 0),) * 3, 65_000)

metres = st.floats(-1e6, 1e6)
yaws = st.floats(-1e4, 1e4)
readings = st.one_of(
    st.floats(0, 70), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 65.0, 65.0005]), st.floats()
)


@st.composite
def raw_scans(draw):
    """Stamps, poses and ranges of the sensor THREE, in SI units."""
    count = draw(st.integers(0, 4))
    stamps = draw(st.lists(st.floats(-1e9, 1e9), min_size=count, max_size=count))
    poses = draw(st.lists(st.tuples(metres, metres, yaws), min_size=count, max_size=count))
    ranges = draw(st.lists(st.tuples(readings, readings, readings), min_size=count, max_size=count))
    return np.array(stamps), np.array(poses).reshape(-1, 3), np.array(ranges).reshape(-1, 3)


def one_reading(metres):
    return int(quantise([0.0], [[0.0, 0.0, 0.0]], [[metres]], ONE).ranges[0, 0])


def in_si(scans):
    """Whole numbers back in seconds, metres and radians."""
    ranges = scans.ranges / 1000
    ranges[scans.ranges == INVALID] = math.nan
    ranges[scans.ranges == NO_RETURN] = math.inf
    yaw = [from_turn16(turn16) for turn16 in scans.poses[:, 2].tolist()]
    return scans.stamps_ms / 1000, np.column_stack([scans.poses[:, :2] / 1000, yaw]), ranges


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("stamps_ms", "poses", "ranges"))


@pytest.mark.parametrize(
    ("metres", "reading"),
    [
        (math.nan, INVALID),
        (math.inf, NO_RETURN),
        (-math.inf, INVALID),
        (-0.3, INVALID),
        (0.0, INVALID),
        (0.0004, INVALID),
        (0.0006, 1),
        (0.4321, 432),
        (0.4326, 433),
        (0.0005, INVALID),  # a half goes to the even neighbour, as in Python
        (0.0015, 2),
        (0.8, 800),
        (0.8004, 800),  # what counts is the rounded range
        (0.8006, NO_RETURN),
        (65.535, NO_RETURN),
        (1e308, NO_RETURN),
    ],
)
def test_a_range_becomes_millimetres_nothing_in_range_or_invalid(metres, reading):
    assert one_reading(metres) == reading


@given(raw_scans())
@few
def test_no_reading_is_beyond_the_sensors_range(raw):
    ranges = quantise(*raw, THREE).ranges
    assert ((ranges <= THREE.max_range_mm) | (ranges == NO_RETURN)).all()


@given(raw_scans())
@few
def test_what_was_quantised_is_not_changed_by_quantising(raw):
    scans = quantise(*raw, THREE)
    assert same(quantise(*in_si(scans), THREE), scans)


@given(raw_scans())
@few
def test_quantised_scans_have_the_documented_types(raw):
    scans = quantise(*raw, THREE)
    assert (scans.stamps_ms.dtype, scans.poses.dtype, scans.ranges.dtype) == (np.int64, np.int32, np.uint16)
    assert len(scans) == len(raw[0])
    assert scans.beams == 3
    assert ((scans.poses[:, 2] >= 0) & (scans.poses[:, 2] < 65536)).all()


@given(metres, metres, st.one_of(yaws, st.floats(-1e300, 1e300)))
def test_a_scans_pose_is_rounded_like_any_other(x, y, yaw):
    """A heading far out of bounds too: it overflowed an int64 once, where one pose by itself did not."""
    scans = quantise([0.0], [[x, y, yaw]], [[1.0]], ONE)
    assert tuple(scans.poses[0].tolist()) == QuantisedPose.of(Pose(x, y, yaw))


def test_lists_are_taken_and_left_alone():
    stamps, poses, ranges = [1.0004, 2.0006], [[1, 2, 3], [4, 5, 6]], [[0.1], [9]]
    scans = quantise(stamps, poses, ranges, ONE)
    assert scans.stamps_ms.tolist() == [1000, 2001]
    assert scans.poses[:, :2].tolist() == [[1000, 2000], [4000, 5000]]
    assert scans.ranges.tolist() == [[100], [NO_RETURN]]
    assert (stamps, poses, ranges) == ([1.0004, 2.0006], [[1, 2, 3], [4, 5, 6]], [[0.1], [9]])


@pytest.mark.parametrize(
    ("stamps", "poses", "ranges", "message"),
    [
        (np.zeros(2), np.zeros((2, 3)), np.zeros((2, 4)), "ranges: expected (N, 1), got (2, 4)"),
        (np.zeros(2), np.zeros((2, 3)), np.zeros(2), "ranges: expected (N, 1), got (2,)"),
        (np.zeros(2), np.zeros((2, 2)), np.zeros((2, 1)), "poses: expected (N, 3), got (2, 2)"),
        (np.zeros(2), np.zeros(3), np.zeros((2, 1)), "poses: expected (N, 3), got (3,)"),
        (np.zeros(2), np.zeros((3, 3)), np.zeros((2, 1)), "got (2,), (3, 3) and (2, 1)"),
        (np.zeros(2), np.zeros((2, 3)), np.zeros((3, 1)), "got (2,), (2, 3) and (3, 1)"),
        (np.zeros((2, 2)), np.zeros((2, 3)), np.zeros((2, 1)), "got (2, 2), (2, 3) and (2, 1)"),
        (0.0, np.zeros((1, 3)), np.zeros((1, 1)), "got (), (1, 3) and (1, 1)"),
    ],
)
def test_a_wrong_shape_is_refused_with_both_sides(stamps, poses, ranges, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        quantise(stamps, poses, ranges, ONE)


@pytest.mark.parametrize("pose", [[math.nan, 0, 0], [0, math.inf, 0], [0, 0, -math.inf], [1_000_001, 0, 0]])
def test_a_pose_that_nobody_has_is_refused_with_its_row(pose):
    poses = np.zeros((4, 3))
    poses[2] = pose
    message = f"poses: scan 2 is at {poses[2].tolist()}, expected finite numbers within 1000 km"
    with pytest.raises(ValueError, match=re.escape(message)):
        quantise(np.zeros(4), poses, np.ones((4, 1)), ONE)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_a_time_that_never_was_is_refused_with_its_row(stamp):
    with pytest.raises(ValueError, match=f"stamps: scan 1 is at {stamp}, expected a finite number"):
        quantise([0.0, stamp, 0.0], np.zeros((3, 3)), np.ones((3, 1)), ONE)


@given(raw_scans(), st.data())
@few
def test_batches_are_cut_and_joined_without_loss(raw, data):
    scans = quantise(*raw, THREE)
    cut = data.draw(st.integers(0, len(scans)))
    assert len(scans[:cut]) == cut
    assert same(Scans.join([scans[:cut], scans[cut:]]), scans)
    assert same(Scans.join([Scans.empty(3), scans]), scans)


def test_scans_of_different_sensors_do_not_join():
    with pytest.raises(ValueError, match="must match exactly"):
        Scans.join([Scans.empty(3), Scans.empty(4)])


def test_no_scans_know_their_number_of_beams():
    assert len(Scans.empty(5)) == 0
    assert Scans.empty(5).beams == 5
