"""Frontiers and ways over a coarse picture of the map."""

import math
from collections import deque
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from agent.driver import ROBOT_RADIUS
from agent.frontier import (
    COARSE,
    MARGIN,
    VIEW,
    Terrain,
    filled,
    frontiers,
    grown,
    large_groups,
    passable,
    straightened,
    terrain_of,
    viewpoints,
    way_to_nearest,
)
from mapping.grid import Grid
from mapping.lattice import Lattice

NOBODY = np.zeros((0, 2))
masks = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12))


def picture(*rows):
    """Rows from north to south: '.' free, '#' occupied, ' ' unknown; cells of 4 cm from the origin."""
    table = np.array([list(row) for row in rows[::-1]])
    return Terrain(table == ".", table == "#", 0.04, 0.0, 0.0)


# The picture


@given(
    arrays(np.int32, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=20), elements=st.integers(-1, 1)),
    st.integers(-70, 70),
    st.integers(-70, 70),
    st.sampled_from([10, 20, 40, 50]),
)
def test_a_coarse_cell_is_what_its_cells_are(signs, i0, j0, cell_mm):
    lattice = Lattice(cell_mm)
    tiles = Grid(signs * np.int32(100), i0, j0, lattice).tiles()
    terrain = terrain_of(tiles, lattice, np.array([[0.0, 0.0]]))
    assert terrain.cell == pytest.approx(max(1, round(40 / cell_mm)) * cell_mm / 1000)
    rows, columns = np.nonzero(signs)
    points = (np.column_stack([columns + i0, rows + j0]) + 0.5) * lattice.cell
    occupied, free = np.zeros_like(terrain.free), np.zeros_like(terrain.free)
    for (row, column), sign in zip(terrain.cells(points).tolist(), signs[rows, columns].tolist(), strict=True):
        (occupied if sign > 0 else free)[row, column] = True
    assert np.array_equal(terrain.occupied, occupied)
    assert np.array_equal(terrain.free, filled(free & ~occupied) & ~occupied)


@given(st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_the_robot_is_in_the_picture_even_of_an_empty_map(place):
    terrain = terrain_of({}, Lattice(20), np.array([place]))
    ((row, column),) = terrain.cells(np.array([place]))
    ((x, y),) = terrain.centres(np.array([[row, column]]))
    assert max(abs(x - place[0]), abs(y - place[1])) <= terrain.cell / 2 + 1e-9
    assert 0 < row < terrain.free.shape[0] - 1
    assert 0 < column < terrain.free.shape[1] - 1


def test_weak_evidence_is_no_wall_and_no_way():
    """p = 0.6: neither free nor occupied."""
    grid = Grid(np.array([[40]], np.int32), 0, 0, Lattice(40))
    terrain = terrain_of(grid.tiles(), Lattice(40), np.array([[0.0, 0.0]]))
    assert not terrain.free.any()
    assert not terrain.occupied.any()


# Growing


@given(masks, st.floats(0, 4))
def test_growing_is_all_within_the_radius(mask, radius):
    rows, columns = np.nonzero(mask)
    r, c = np.indices(mask.shape)
    near = np.zeros_like(mask)
    for row, column in zip(rows, columns, strict=True):
        near |= (r - row) ** 2 + (c - column) ** 2 <= radius * radius
    assert np.array_equal(grown(mask, radius), near)


def test_the_robot_keeps_its_radius_and_a_margin():
    terrain = picture(*["." * 21] * 10, "." * 10 + "#" + "." * 10, *["." * 21] * 10)
    way = passable(terrain, np.array([[0.02, 0.02]]), NOBODY)
    ((x, y),) = terrain.centres(np.argwhere(terrain.occupied))
    centres = terrain.centres(np.argwhere(way))
    assert np.hypot(*(centres - (x, y)).T).min() > ROBOT_RADIUS + MARGIN
    assert way.sum() > 300


def test_the_body_stays_on_what_is_known():
    terrain = picture(*["." * 10 + " " * 10] * 12)
    way = passable(terrain, np.array([[0.1, 0.2]]), NOBODY)
    assert terrain.centres(np.argwhere(way))[:, 0].max() < 0.4 - ROBOT_RADIUS + terrain.cell / 2
    assert way.any()


def test_a_team_mate_is_an_obstacle_twice_as_wide():
    terrain = picture(*["." * 15] * 15)
    mate = np.array([[0.3, 0.3]])
    way = passable(terrain, np.array([[0.02, 0.02]]), mate)
    centres = terrain.centres(np.argwhere(way))
    assert np.hypot(*(centres - mate).T).min() > 2 * ROBOT_RADIUS


def test_a_robot_too_near_to_a_wall_can_get_away():
    terrain = picture(*["." * 10] * 8, "#" * 10)
    here = np.array([[0.2, 0.06]])  # 6 cm above the bottom row's lower edge
    way = passable(terrain, here, NOBODY)
    goal = np.zeros_like(way)
    goal[7, 5] = True
    assert way_to_nearest(way, tuple(terrain.cells(here)[0].tolist()), goal)


# Frontiers


def test_a_frontier_is_free_beside_unknown_and_away_from_walls():
    rows = ["#" * 12, *["." * 12] * 12, "#" * 12]
    terrain = picture(*(row[:-2] + "  " for row in rows))
    cells = np.argwhere(frontiers(terrain))
    assert set(cells[:, 1].tolist()) == {9}
    walls = terrain.centres(np.argwhere(terrain.occupied))
    away = np.hypot(*(terrain.centres(cells)[:, None] - walls).transpose(2, 0, 1)).min()
    assert away > ROBOT_RADIUS + MARGIN
    assert len(cells) == 6  # of twelve, three below each wall are too near to it


def test_a_crack_that_is_too_narrow_is_none():
    rows = ["#" * 12, *["." * 12] * 7, "#" * 12]
    assert not frontiers(picture(*(row[:-2] + "  " for row in rows))).any()


def test_a_gap_between_rays_is_filled_and_no_frontier():
    free = np.ones((9, 9), np.bool_)
    free[4, 4] = False
    assert filled(free).all()
    free[4, 4:6] = False
    assert filled(free).all()  # seven and seven of eight
    assert not filled(np.zeros((5, 5), np.bool_)).any()


def test_what_is_closed_has_none():
    assert not frontiers(picture("     ", " ### ", " #.# ", " ### ", "     ")).any()


@given(masks, st.integers(1, 5))
def test_groups_are_kept_or_dropped_whole(mask, least):
    kept = large_groups(mask, least)
    assert not (kept & ~mask).any()
    for row, column in np.argwhere(mask).tolist():
        group = np.zeros_like(mask)
        group[row, column] = True
        while (larger := grown(group, 1.5) & mask).sum() > group.sum():
            group = larger
        assert kept[row, column] == (group.sum() >= least)


def test_a_frontier_is_looked_over_from_some_way_off():
    terrain = picture(*["." * 20 + " "] * 20)
    way = passable(terrain, np.array([[0.2, 0.4]]), NOBODY)
    trail = way_to_nearest(way, (10, 2), viewpoints(terrain, frontiers(terrain)))
    assert trail is not None
    ((x, _),) = terrain.centres(np.array(trail[-1:]))
    assert 0.8 - VIEW - COARSE <= x <= 0.8 - ROBOT_RADIUS


# The way


def plain_distance(way, start, targets):
    """Breadth first over eight neighbours: whether any target can be reached."""
    todo, seen = deque([start]), {start}
    while todo:
        row, column = todo.popleft()
        if targets[row, column]:
            return True
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                cell = row + down, column + right
                inside = 0 <= cell[0] < way.shape[0] and 0 <= cell[1] < way.shape[1]
                if inside and cell not in seen and way[cell]:
                    seen.add(cell)
                    todo.append(cell)
    return False


@given(st.data(), masks)
def test_a_way_is_found_when_there_is_one_and_stays_on_it(data, way):
    targets = data.draw(arrays(np.bool_, way.shape))
    start = data.draw(st.tuples(*(st.integers(0, side - 1) for side in way.shape)))
    trail = way_to_nearest(way, start, targets)
    if trail is None:
        assert not plain_distance(way, start, targets)
        return
    assert trail[0] == start
    assert targets[trail[-1]]
    assert all(way[cell] for cell in trail[1:])
    for a, b in pairwise(trail):
        assert max(abs(a[0] - b[0]), abs(a[1] - b[1])) == 1


def test_the_nearest_is_taken():
    way = np.ones((9, 30), np.bool_)
    targets = np.zeros_like(way)
    targets[4, [2, 25]] = True
    assert way_to_nearest(way, (4, 10), targets)[-1] == (4, 2)
    assert way_to_nearest(way, (4, 15), targets)[-1] == (4, 25)


def test_a_way_round_a_wall_has_few_corners_and_never_touches_it():
    terrain = picture(*["." * 40] * 10, *["." * 20 + "#" + "." * 19] * 20)
    way = passable(terrain, np.array([[0.2, 0.1]]), NOBODY)
    targets = np.zeros_like(way)
    targets[2, 36] = True
    corners = straightened(way_to_nearest(way, (2, 5), targets), way)
    assert corners[-1] == (2, 36)
    assert len(corners) <= 5
    walls = terrain.centres(np.argwhere(terrain.occupied))
    points = terrain.centres(np.array([(2, 5), *corners]))
    for a, b in pairwise(points):
        line = a + np.linspace(0, 1, 100)[:, None] * (b - a)
        nearest = np.hypot(*(line[:, None] - walls).transpose(2, 0, 1)).min()
        assert nearest > ROBOT_RADIUS + MARGIN - terrain.cell / math.sqrt(2)


def test_a_trail_of_one_cell_has_no_corner():
    assert straightened([(0, 0)], np.ones((1, 1), np.bool_)) == []
