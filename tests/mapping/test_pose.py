import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.pose import FULL_TURN, Pose, QuantisedPose, from_turn16, to_turn16

metres = st.floats(-1000, 1000)
poses = st.builds(Pose, metres, metres, st.floats(-10, 10))
turns = st.integers(0, FULL_TURN - 1)


def matrix(pose):
    """Eq. 4 as it is printed."""
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0, 0, 1]])


@given(poses, poses)
def test_a_chain_of_poses_is_the_product_of_their_matrices(T_a_b, T_b_c):
    assert matrix(T_a_b @ T_b_c) == pytest.approx(matrix(T_a_b) @ matrix(T_b_c), abs=1e-9)


@given(poses, poses, poses)
def test_chains_are_associative(T_a_b, T_b_c, T_c_d):
    left, right = (T_a_b @ T_b_c) @ T_c_d, T_a_b @ (T_b_c @ T_c_d)
    assert matrix(left) == pytest.approx(matrix(right), abs=1e-9)
    assert left.yaw == pytest.approx(right.yaw, abs=1e-9)


@given(poses)
def test_an_inverse_undoes_a_pose_from_both_sides(T_a_b):
    for unity in (T_a_b @ T_a_b.inverse(), T_a_b.inverse() @ T_a_b):
        assert matrix(unity) == pytest.approx(np.eye(3), abs=1e-9)
        assert unity.yaw == 0


@given(poses)
def test_the_default_pose_changes_nothing(pose):
    assert pose @ Pose() == pose
    assert Pose() @ pose == pose


@given(poses, st.lists(st.tuples(metres, metres), min_size=1, max_size=5))
def test_points_are_mapped_by_the_matrix(T_a_b, points_b):
    points_a = T_a_b.apply(np.array(points_b))
    expected = [(matrix(T_a_b) @ [x, y, 1])[:2] for x, y in points_b]
    assert points_a == pytest.approx(np.array(expected), abs=1e-9)
    assert T_a_b.inverse().apply(points_a) == pytest.approx(np.array(points_b), abs=1e-9)


@given(poses, st.sampled_from([(2,), (0, 2), (3, 2), (2, 3, 2)]))
def test_points_keep_their_shape(pose, shape):
    assert pose.apply(np.zeros(shape)).shape == shape


@given(poses, st.lists(poses, max_size=5))
def test_many_poses_are_composed_as_one_by_one(T_a_b, several_b):
    rows = np.array([(pose.x, pose.y, pose.yaw) for pose in several_b]).reshape(-1, 3)
    one_by_one = [T_a_b @ pose for pose in several_b]
    expected = np.array([(pose.x, pose.y, pose.yaw) for pose in one_by_one]).reshape(-1, 3)
    assert T_a_b.compose(rows) == pytest.approx(expected, abs=1e-9)


def test_every_integer_angle_comes_back_from_radians():
    assert [to_turn16(from_turn16(turn16)) for turn16 in range(FULL_TURN)] == list(range(FULL_TURN))


def test_radians_lie_above_minus_pi_and_up_to_pi():
    angles = [from_turn16(turn16) for turn16 in range(FULL_TURN)]
    assert max(angles) == math.pi == from_turn16(FULL_TURN // 2)
    assert -math.pi < min(angles) == from_turn16(FULL_TURN // 2 + 1)


@given(turns, st.integers(-20, 20))
def test_integer_angles_wrap(turn16, whole_turns):
    assert from_turn16(turn16 + whole_turns * FULL_TURN) == from_turn16(turn16)
    assert to_turn16(from_turn16(turn16) + whole_turns * math.tau) == turn16


@given(st.floats(-10, 10))
def test_an_integer_angle_is_the_nearest(angle):
    off = math.remainder(from_turn16(to_turn16(angle)) - angle, math.tau)
    assert abs(off) <= math.tau / FULL_TURN / 2 + 1e-12


def test_angles_count_counter_clockwise():
    assert [to_turn16(math.radians(degrees)) for degrees in (0, 90, 180, -90, 360)] == [0, 16384, 32768, 49152, 0]
    assert Pose(1, 2, math.pi / 2).apply(np.array([1.0, 0.0])) == pytest.approx([1, 3])


@given(st.builds(QuantisedPose, st.integers(-(10**9), 10**9), st.integers(-(10**9), 10**9), turns))
def test_a_quantised_pose_comes_back_from_metres(quantised):
    assert QuantisedPose.of(quantised.pose()) == quantised


@given(poses)
def test_a_quantised_pose_is_the_nearest(pose):
    near = QuantisedPose.of(pose).pose()
    assert max(abs(near.x - pose.x), abs(near.y - pose.y)) <= 0.0005 + 1e-9


@pytest.mark.parametrize("name", ["x", "y", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_no_pose_to_publish(name, value):
    with pytest.raises(ValueError, match=f"pose: {name} is {value}, expected a finite number"):
        QuantisedPose.of(Pose(**{name: value}))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["x", "y"])
def test_a_pose_lies_within_1000_km(name, sign):
    assert abs(getattr(QuantisedPose.of(Pose(**{name: sign * 1e6})), f"{name}_mm")) == 10**9
    with pytest.raises(ValueError, match=r"pose: .*1000000\.1.* lies more than 1000 km from the origin"):
        QuantisedPose.of(Pose(**{name: sign * 1_000_000.1}))
