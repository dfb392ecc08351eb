"""A differential drive: known arcs, motors that lag, encoders that count whole ticks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.kinematics import ORION_CHASSIS, Chassis, Motors, arc
from mapping.pose import Pose

BASE = 0.1
metres = st.floats(-2, 2)
small = st.floats(-0.5, 0.5)


def one_arc(pose: tuple[float, float, float], left: float, right: float) -> list[float]:
    return arc(np.array([pose]), np.array([[left, right]]), BASE)[0].tolist()


def test_equal_wheels_go_straight() -> None:
    assert one_arc((1, 2, math.pi / 6), 0.5, 0.5) == pytest.approx([1 + 0.5 * math.sqrt(3) / 2, 2.25, math.pi / 6])


def test_opposite_wheels_turn_on_the_spot() -> None:
    quarter = math.pi / 2 * BASE / 2
    assert one_arc((1, 2, 0.3), -quarter, quarter) == pytest.approx([1, 2, 0.3 + math.pi / 2])


def test_a_quarter_circle_to_the_left_ends_where_the_compasses_say() -> None:
    """Radius 0.4 m: the wheels' circles are 0.35 and 0.45 m."""
    ends = one_arc((0, 0, 0), 0.35 * math.pi / 2, 0.45 * math.pi / 2)
    assert ends == pytest.approx([0.4, 0.4, math.pi / 2])


def test_a_wheel_that_stands_is_the_centre_of_the_circle() -> None:
    assert one_arc((0, 0, 0), 0.0, math.pi * BASE) == pytest.approx([0, 0.1, math.pi])


@given(x=metres, y=metres, yaw=st.floats(-7, 7), left=small, right=small, share=st.floats(0, 1))
def test_an_arc_in_two_parts_is_the_same_arc(
    x: float, y: float, yaw: float, left: float, right: float, share: float
) -> None:
    half_way = one_arc((x, y, yaw), left * share, right * share)
    ends = arc(np.array([half_way]), np.array([[left * (1 - share), right * (1 - share)]]), BASE)[0]
    np.testing.assert_allclose(ends, one_arc((x, y, yaw), left, right), atol=1e-9)


@given(x=metres, y=metres, yaw=st.floats(-7, 7), left=small, right=small)
def test_an_arc_is_the_same_wherever_it_starts(x: float, y: float, yaw: float, left: float, right: float) -> None:
    expected = Pose(x, y, yaw) @ Pose(*one_arc((0, 0, 0), left, right))
    np.testing.assert_allclose(one_arc((x, y, yaw), left, right), [expected.x, expected.y, expected.yaw], atol=1e-9)


def test_robots_go_their_own_ways() -> None:
    ends = arc(np.zeros((2, 3)), np.array([[0.1, 0.1], [-0.05, 0.05]]), BASE)
    np.testing.assert_allclose(ends, [[0.1, 0, 0], [0, 0, 1.0]], atol=1e-12)


def test_a_motor_has_made_up_63_percent_after_its_lag() -> None:
    motors = Motors(1, Chassis(lag=0.08))
    motors.roll(np.array([[0.2, -0.1]]), 0.08)
    np.testing.assert_allclose(motors.speeds, [[0.2 * (1 - math.exp(-1)), -0.1 * (1 - math.exp(-1))]])


def test_what_a_motor_rolls_does_not_depend_on_the_steps() -> None:
    wanted = np.array([[0.2, -0.1]])
    coarse, fine = Motors(1, ORION_CHASSIS), Motors(1, ORION_CHASSIS)
    whole = coarse.roll(wanted, 0.5)
    parts = sum(fine.roll(wanted, 0.01) for _ in range(50))
    np.testing.assert_allclose(whole, parts)
    lag = ORION_CHASSIS.lag
    np.testing.assert_allclose(whole, wanted * (0.5 - lag * (1 - math.exp(-0.5 / lag))))
    np.testing.assert_allclose(coarse.rolled, fine.rolled)


def test_without_lag_speed_is_what_was_told() -> None:
    motors = Motors(1, Chassis(lag=0.0))
    np.testing.assert_allclose(motors.roll(np.array([[0.2, -0.1]]), 0.1), [[0.02, -0.01]])


def test_no_wheel_exceeds_its_top_speed() -> None:
    motors = Motors(1, Chassis(lag=0.0, top_speed=0.3))
    np.testing.assert_allclose(motors.roll(np.array([[9.0, -9.0]]), 1.0), [[0.3, -0.3]])


def test_encoders_count_whole_ticks_and_lose_none() -> None:
    motors = Motors(1, Chassis(lag=0.0, ticks_per_metre=1000))
    seen = []
    for _ in range(9):
        motors.roll(np.array([[0.25, -0.25]]), 0.001)
        seen.append(motors.ticks[0].tolist())
    assert [left for left, _ in seen] == [0, 0, 0, 1, 1, 1, 1, 2, 2]
    assert [right for _, right in seen] == [-1, -1, -1, -1, -2, -2, -2, -2, -3]


def test_the_robots_circle_goes_round_its_corners() -> None:
    assert ORION_CHASSIS.radius == pytest.approx(0.085, abs=0.0005)
