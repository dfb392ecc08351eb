"""A picture's walls: the same as the squares that its occupied cells are, whatever ray or point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.geometry import distances_to_walls, meet_walls
from agent.occupied_cells import NO_CELLS, OccupiedCells

ORIGIN = (-0.6, 0.4)
CELL = 0.1

pictures = st.lists(st.lists(st.booleans(), min_size=8, max_size=8), min_size=6, max_size=6).map(np.array)
columns = st.floats(-3, 11)
rows = st.floats(-3, 9)
angles = st.floats(-10, 10)


def cells(picture: NDArray[np.bool_]) -> OccupiedCells:
    return OccupiedCells(picture, ORIGIN, CELL)


def squares(picture: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Four walls around every occupied cell."""
    walls = []
    for row, column in np.argwhere(picture):
        x0, y0 = ORIGIN[0] + column * CELL, ORIGIN[1] + row * CELL
        x1, y1 = x0 + CELL, y0 + CELL
        walls += [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]
    return np.array(walls, dtype=np.float64).reshape(-1, 4)


def point(column: float, row: float) -> NDArray[np.float64]:
    return np.array([[ORIGIN[0] + column * CELL, ORIGIN[1] + row * CELL]])


def one_ray(picture: NDArray[np.bool_], column: float, row: float, bearing: float, reach: float = math.inf) -> float:
    return float(cells(picture).cast(point(column, row), np.array([bearing]), reach)[0])


def inside(picture: NDArray[np.bool_], column: float, row: float) -> bool:
    i, j = math.floor(column), math.floor(row)
    return 0 <= i < 8 and 0 <= j < 6 and bool(picture[j, i])


def one_cell(column: int, row: int) -> NDArray[np.bool_]:
    picture = np.zeros((6, 8), np.bool_)
    picture[row, column] = True
    return picture


@given(picture=pictures, column=columns, row=rows, bearing=angles)
def test_rays_agree_with_the_sides_of_the_squares(
    picture: NDArray[np.bool_], column: float, row: float, bearing: float
) -> None:
    # On the rim of an occupied cell a rounding decides whether one is in it.
    assume(distances_to_walls(point(column, row), squares(picture)).min(initial=math.inf) > 1e-6)
    found = one_ray(picture, column, row, bearing)
    if inside(picture, column, row):
        assert found == 0.0
        return
    expected = meet_walls(point(column, row), np.array([bearing]), squares(picture)).min(initial=math.inf)
    # A ray that only touches a corner may be seen either way: then a hair to either side decides.
    hair = np.array([bearing - 1e-7, bearing + 1e-7])
    beside = meet_walls(np.repeat(point(column, row), 2, axis=0), hair, squares(picture)).min(axis=1, initial=math.inf)
    assert any(found == pytest.approx(right, abs=1e-5) for right in [expected, *beside])


@pytest.mark.parametrize(
    ("bearing_deg", "distance"), [(0, 0.15), (180, math.inf), (90, math.inf), (45, math.inf), (-45, math.inf)]
)
def test_rays_along_the_axes_are_exact(bearing_deg: float, distance: float) -> None:
    assert one_ray(one_cell(4, 2), 2.5, 2.5, math.radians(bearing_deg)) == pytest.approx(distance, abs=1e-12)


@pytest.mark.parametrize("bearing", [0, math.pi / 2, math.pi, -math.pi / 2])
def test_a_ray_from_beyond_the_picture_comes_in(bearing: float) -> None:
    column, row = 4.5 - 10 * math.cos(bearing), 2.5 - 10 * math.sin(bearing)
    assert one_ray(one_cell(4, 2), column, row, bearing) == pytest.approx(0.95)


def test_no_ray_slips_between_two_cells_that_touch_at_a_corner() -> None:
    picture = one_cell(3, 3) | one_cell(4, 2)
    assert one_ray(picture, 3.5, 2.5, math.pi / 4) == pytest.approx(0.05 * math.sqrt(2))


def test_a_ray_that_starts_on_a_lattice_line_enters_the_cell_it_looks_into() -> None:
    assert one_ray(one_cell(3, 2), 4.0, 2.5, math.pi) == pytest.approx(0.0, abs=1e-9)
    assert one_ray(one_cell(3, 2), 3.0, 2.5, math.pi) in {0.0, math.inf}  # on its rim


@given(picture=pictures, column=columns, row=rows, bearing=angles, reach=st.floats(0.01, 2))
def test_what_is_within_reach_does_not_depend_on_the_reach(
    picture: NDArray[np.bool_], column: float, row: float, bearing: float, reach: float
) -> None:
    whole = one_ray(picture, column, row, bearing)
    assert one_ray(picture, column, row, bearing, reach) == (whole if whole <= reach else math.inf)


@given(picture=pictures, column=columns, row=rows)
def test_distances_agree_with_the_sides_of_the_squares(picture: NDArray[np.bool_], column: float, row: float) -> None:
    found = float(cells(picture).distances(point(column, row), 0.35)[0])
    rim = distances_to_walls(point(column, row), squares(picture)).min(initial=math.inf)
    if not picture.any():
        assert found == math.inf
    elif rim < 1e-9:
        assert found == pytest.approx(0.0, abs=1e-8)
    elif inside(picture, column, row):
        assert found == 0.0
    else:
        assert found == pytest.approx(min(rim, 0.35), abs=1e-9)


def test_many_rays_and_points_are_one_by_one_the_same() -> None:
    rng = np.random.default_rng(1)
    picture = rng.random((6, 8)) < 0.2
    where = cells(picture)
    points, bearings = rng.uniform(-1, 2, (50, 2)), rng.uniform(-4, 4, 50)
    one_by_one = [where.cast(points[k : k + 1], bearings[k : k + 1])[0] for k in range(50)]
    np.testing.assert_array_equal(where.cast(points, bearings), one_by_one)
    np.testing.assert_array_equal(where.distances(points, 0.3)[7], where.distances(points[7:8], 0.3)[0])


def test_no_picture_stops_nothing() -> None:
    assert NO_CELLS.cast(np.zeros((2, 2)), np.zeros(2)).tolist() == [math.inf, math.inf]
    assert NO_CELLS.distances(np.zeros((2, 2)), 1.0).tolist() == [math.inf, math.inf]
