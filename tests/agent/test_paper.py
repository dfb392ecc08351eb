"""The paper's pipeline by itself, and where it must agree with ours."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.paper import (
    L_FREE,
    L_OCC,
    T_R_S,
    T_W_R,
    LogOdds,
    bresenham,
    grid_cell,
    inv_sensor,
    manhattan_distance,
    mapped,
    occupancy_grid_mapping,
    point_cloud,
    points_S,
    probability,
    theta_of,
)
from agent.paper_example import STEPS, cell_of, frames_by_the_paper, frames_by_us
from mapping.evidence import EvidenceModel, to_units
from mapping.lattice import TILE
from mapping.raster import raster_rays
from mapping.rays import Rays

cells = st.tuples(st.integers(-200, 200), st.integers(-200, 200))
metres = st.floats(-5, 5)
angles = st.floats(-7, 7)
readings = st.lists(st.floats(0.002, 0.8), min_size=5, max_size=5)


def our_evidence(rays: list[tuple[tuple[int, int], tuple[int, int]]]) -> dict[tuple[int, int], int]:
    """What our kernel makes of thin rays that hit, by cell."""
    starts, ends = (np.array([ray[k] for ray in rays], np.int64) for k in (0, 1))
    model = EvidenceModel(to_units(L_OCC), to_units(L_FREE))
    known = {}
    for (ty, tx), tile in raster_rays(Rays(starts, ends, np.ones(len(rays), np.uint8)), model):
        for j, i in zip(*np.nonzero(tile), strict=True):
            known[tx * TILE + int(i), ty * TILE + int(j)] = int(tile[j, i])
    return known


# --- equations 1 to 4, and 8


def test_equation_1_has_the_front_sensor_on_y_and_the_right_one_on_x() -> None:
    right, diagonal, front, _, left = points_S([0.5] * 5).T
    assert right == pytest.approx([0.5, 0, 1])
    assert diagonal == pytest.approx([0.5 / math.sqrt(2), 0.5 / math.sqrt(2), 1])
    assert front == pytest.approx([0, 0.5, 1])
    assert left == pytest.approx([-0.5, 0, 1])


def test_equation_2_moves_the_sensors_ahead() -> None:
    assert (T_R_S(0.03) @ [0, 0, 1]).tolist() == [0, 0.03, 1]


def test_equation_4_turns_counter_clockwise_and_moves() -> None:
    assert T_W_R(1, 2, math.pi / 2) @ [0, 1, 1] == pytest.approx([0, 2, 1])


@given(metres, metres, angles, readings)
def test_equation_3_is_written_out_what_the_matrices_say(x: float, y: float, theta: float, rho: list[float]) -> None:
    cloud = point_cloud((x, y, theta), rho, 0.03)
    for k, (point, reading) in enumerate(zip(cloud, rho, strict=True)):
        phi = k * math.pi / 4
        assert point == pytest.approx(
            [
                x - 0.03 * math.sin(theta) + reading * math.cos(theta + phi),
                y + 0.03 * math.cos(theta) + reading * math.sin(theta + phi),
            ]
        )


def test_equation_8_is_robot_2s_start() -> None:
    T = T_W_R(2150, 1450, 14 * math.pi / 9)
    assert pytest.approx([2150, 1450, 1]) == T @ [0, 0, 1]
    assert theta_of(math.radians(10)) % math.tau == pytest.approx(14 * math.pi / 9)
    ahead = (T @ [0, 1, 1] - T @ [0, 0, 1])[:2]
    assert ahead == pytest.approx([math.cos(math.radians(10)), math.sin(math.radians(10))])


def test_grid_is_the_cell_below_and_to_the_left_also_of_what_is_negative() -> None:
    assert grid_cell((0.03, -0.001), 0.02) == (1, -1)


# --- algorithms 1 and 2, equation 7


@given(cells, cells)
def test_a_ray_goes_from_end_to_end_by_steps_to_one_of_eight_neighbours(x: tuple[int, int], z: tuple[int, int]) -> None:
    ray = bresenham(x, z)
    assert (ray[0], ray[-1]) == (x, z)
    assert len(ray) == max(abs(z[0] - x[0]), abs(z[1] - x[1])) + 1
    assert all(max(abs(b[0] - a[0]), abs(b[1] - a[1])) == 1 for a, b in pairwise(ray))


def test_algorithm_2_says_occupied_free_or_nothing_by_manhattan_distances() -> None:
    assert manhattan_distance((0, 0), (3, -1)) == 4
    assert inv_sensor((3, -1), (0, 0), (3, -1)) == L_OCC
    assert inv_sensor((2, -1), (0, 0), (3, -1)) == L_FREE
    assert inv_sensor((4, -1), (0, 0), (3, -1)) is None


def test_algorithm_2_asked_about_cells_that_are_on_no_ray_calls_a_whole_diamond_occupied() -> None:
    assert inv_sensor((-4, 0), (0, 0), (3, -1)) == L_OCC


def test_algorithm_1_leaves_the_last_grid_and_unseen_cells_alone() -> None:
    before = {(9, 9): 1.5, (1, 0): 0.85}
    after = occupancy_grid_mapping(before, (0, 0), (2, 0))
    assert before == {(9, 9): 1.5, (1, 0): 0.85}
    assert after == pytest.approx({(9, 9): 1.5, (0, 0): -0.4, (1, 0): 0.45, (2, 0): 0.85})


def test_equation_7_is_one_half_at_the_prior_where_the_printed_one_has_a_pole() -> None:
    assert probability(0.0) == 0.5
    assert probability(0.85) == pytest.approx(math.exp(0.85) / (1 + math.exp(0.85)))
    assert probability(-8) < 0.001
    assert probability(8) > 0.999
    with pytest.raises(ZeroDivisionError):
        1 - 1 / (1 - math.exp(0.0))


@given(st.lists(st.tuples(cells, cells), min_size=1, max_size=12))
def test_thin_rays_are_worth_the_same_to_the_paper_and_to_us(
    rays: list[tuple[tuple[int, int], tuple[int, int]]],
) -> None:
    """Evidence is l in hundredths; cells whose sum is zero are known to the paper, and not to us."""
    log_odds: LogOdds = {}
    for x, z in rays:
        log_odds = occupancy_grid_mapping(log_odds, x, z)
    theirs = {cell: round(value * 100) for cell, value in log_odds.items() if abs(value) > 1e-9}
    assert theirs == our_evidence(rays)


def test_a_scan_is_mapped_from_the_robots_own_cell() -> None:
    log_odds: LogOdds = {}
    cloud = point_cloud((0.01, 0.01, 0.0), [0.30, 0.40], 0.0, [0.0, math.pi / 2])
    mapped(log_odds, (0.01, 0.01, 0.0), cloud, 0.02)
    assert {cell for cell, value in log_odds.items() if value > 0} == {(15, 0), (0, 20)}
    assert log_odds[0, 0] == pytest.approx(-0.8)


# --- figure 3


@pytest.fixture(params=[frames_by_the_paper, frames_by_us])
def frames(request: pytest.FixtureRequest) -> list[dict[int, float]]:
    """The figure's grid at t = 0 ... 3, by one pipeline."""
    found: list[dict[int, float]] = request.param()
    return found


def test_both_pipelines_draw_the_same_figure_3() -> None:
    for theirs, ours in zip(frames_by_the_paper(), frames_by_us(), strict=True):
        assert theirs == pytest.approx(ours)


def test_the_moving_obstacle_of_figure_3_appears_and_fades(frames: list[dict[int, float]]) -> None:
    before, seen, gone, longer_gone = (frame[10] for frame in frames)
    assert before == 0.5 < longer_gone < gone < seen


def test_the_walls_of_figure_3_rise(frames: list[dict[int, float]]) -> None:
    assert [frame[4] == 0.5 for frame in frames] == [True, True, False, False]
    assert 0.5 < frames[2][4] < frames[3][4]
    assert min(frames[3][wall] for wall in (4, 13, 19, 31)) > 0.65


def test_what_nobody_saw_of_figure_3_stays_at_one_half(frames: list[dict[int, float]]) -> None:
    seen: set[tuple[int, int]] = set()
    for step, frame in zip(STEPS, frames[1:], strict=True):
        seen.update(*(bresenham(cell_of(step.robot), cell_of(reading)) for reading in step.readings))
        assert {p for index, p in frame.items() if cell_of(index) not in seen} == {0.5}
