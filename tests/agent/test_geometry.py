"""Rays against walls and discs, and distances to walls. How rays meet walls at large is in ``test_world``."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.geometry import box_walls, distances_to_walls, meet_discs, meet_walls

metres = st.floats(-3, 3)
angles = st.floats(-10, 10)


def one_disc(x: float, y: float, bearing: float, disc: tuple[float, float, float]) -> float:
    return float(meet_discs(np.array([[x, y]]), np.array([bearing]), np.array([disc]))[0, 0])


def test_a_disc_is_met_at_its_near_rim() -> None:
    assert one_disc(0, 0, 0.0, (2, 0, 0.5)) == pytest.approx(1.5)
    assert one_disc(0, 0.3, 0.0, (2, 0, 0.5)) == pytest.approx(1.6)  # 3, 4, 5


def test_a_disc_beside_or_behind_is_not_met_and_one_around_is_met_at_once() -> None:
    assert one_disc(0, 0.6, 0.0, (2, 0, 0.5)) == math.inf
    assert one_disc(0, 0, math.pi, (2, 0, 0.5)) == math.inf
    assert one_disc(0, 0, 1.0, (0.1, 0, 0.5)) == 0.0


@given(x=metres, y=metres, bearing=angles, radius=st.floats(0.05, 1))
def test_a_disc_is_nearly_a_polygon_of_many_corners(x: float, y: float, bearing: float, radius: float) -> None:
    around = np.linspace(0, 2 * np.pi, 2001)
    rim = radius * np.column_stack([np.cos(around), np.sin(around)])
    walls = np.hstack([rim[:-1], rim[1:]])
    origins, bearings = np.array([[x, y]]), np.array([bearing])
    nearest = meet_walls(origins, bearings, walls).min()
    found = one_disc(x, y, bearing, (0, 0, radius))
    aside = abs(x * math.sin(bearing) - y * math.cos(bearing))
    if math.hypot(x, y) > radius + 1e-3 and abs(aside - radius) > 1e-2:  # outside, and not grazing
        assert found == pytest.approx(nearest, abs=1e-3)


def test_things_are_told_apart() -> None:
    """One column a thing: the caller rules out what a ray may not see."""
    walls = np.array([[1, -1, 1, 1], [2, -1, 2, 1]], dtype=float)
    met = meet_walls(np.zeros((2, 2)), np.array([0.0, math.pi]), walls)
    np.testing.assert_allclose(met, [[1, 2], [np.inf, np.inf]])


def test_the_nearest_point_of_a_wall_may_be_its_middle_or_its_end() -> None:
    points = np.array([[1, 2], [5, 4], [-3, -4]], dtype=float)
    np.testing.assert_allclose(distances_to_walls(points, np.array([[0.0, 0, 2, 0]])), [[2], [5], [5]])


def test_a_box_has_four_sides_around_its_centre() -> None:
    straight = box_walls(np.array([[1.0, 2.0]]), 0.5, 0.0)
    assert straight.shape == (1, 4, 4)
    assert set(map(tuple, np.round(straight[0, :, :2], 9))) == {(1.5, 2.5), (0.5, 2.5), (0.5, 1.5), (1.5, 1.5)}
    np.testing.assert_array_equal(straight[0, :, 2:], np.roll(straight[0, :, :2], -1, axis=0))


@given(x=metres, y=metres, yaw=angles, half_side=st.floats(0.01, 1))
def test_a_turned_box_keeps_its_size(x: float, y: float, yaw: float, half_side: float) -> None:
    sides = box_walls(np.array([[x, y]]), half_side, yaw)[0]
    np.testing.assert_allclose(np.hypot(*(sides[:, 2:] - sides[:, :2]).T), 2 * half_side)
    np.testing.assert_allclose(distances_to_walls(np.array([[x, y]]), sides), half_side, rtol=1e-6)
    looking = meet_walls(np.array([[x, y]]), np.array([yaw]), sides)
    assert looking.min() == pytest.approx(half_side)
