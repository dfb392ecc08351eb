import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.evidence import occupied
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.score import score

SLACK = 1e-9


@st.composite
def grids(draw, cells_mm=(7, 20, 50, 100)):
    shape = draw(st.integers(0, 12)), draw(st.integers(0, 12))
    values = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    evidence = values.choice(np.array([0, -40, -400, 61, 62, 300], np.int32), shape)
    corner = st.integers(-20, 20)
    return Grid(evidence, draw(corner), draw(corner), Lattice(draw(st.sampled_from(cells_mm))))


coordinates = st.integers(-60, 60).map(lambda n: n / 40)
walls = st.lists(st.tuples(*[coordinates] * 4), max_size=4).map(lambda rows: np.array(rows).reshape(-1, 4))
tolerances = st.one_of(st.none(), st.sampled_from([0.0, 0.01, 0.05, 0.1]))


def to_segment(point, wall):
    (px, py), (x1, y1, x2, y2) = point, wall
    dx, dy = x2 - x1, y2 - y1
    length2 = dx * dx + dy * dy
    t = 0.0 if length2 == 0 else min(1.0, max(0.0, ((px - x1) * dx + (py - y1) * dy) / length2))
    return math.hypot(px - x1 - t * dx, py - y1 - t * dy)


def centres_of(grid, mask):
    return [
        ((grid.i0 + c + 0.5) * grid.lattice.cell, (grid.j0 + r + 0.5) * grid.lattice.cell)
        for r, c in np.argwhere(mask).tolist()
    ]


def share(flags):
    flags = list(flags)
    return sum(flags) / len(flags) if flags else None


def brute_force(grid, truth, tolerance):
    """The definitions, point by point. Cells of the IoU are looked for in a box around everything."""
    cell = grid.lattice.cell
    reach = (1.5 * cell if tolerance is None else tolerance) + SLACK
    found = centres_of(grid, occupied(grid.evidence))
    if isinstance(truth, Grid):
        is_occupied = occupied(truth.evidence)
        wide = np.pad(truth.evidence, 1)
        seen = np.zeros_like(is_occupied)
        for r, c in np.argwhere(is_occupied).tolist():
            seen[r, c] = (wide[r : r + 3, c : c + 3] < 0).any()
        segments = [(x, y, x, y) for x, y in centres_of(truth, is_occupied)]
        points = centres_of(truth, seen)
    else:
        segments = truth.tolist()
        points = []
        for x1, y1, x2, y2 in segments:
            steps = math.ceil(math.hypot(x2 - x1, y2 - y1) / 0.01 - 1e-6)
            ts = [k / steps for k in range(steps + 1)] if steps > 0 else [0.0]
            points += [(x1 + t * (x2 - x1), y1 + t * (y2 - y1)) for t in ts]

    def near_found(point):
        return any(math.dist(point, centre) <= reach for centre in found)

    def near_true(point):
        return any(to_segment(point, wall) <= reach for wall in segments)

    corners = [*found, *((s[0], s[1]) for s in segments), *((s[2], s[3]) for s in segments)]
    both = either = 0
    if corners:
        spans = [
            range(math.floor((min(axis) - reach) / cell) - 1, math.ceil((max(axis) + reach) / cell) + 2)
            for axis in zip(*corners, strict=True)
        ]
        for i, j in itertools.product(*spans):
            centre = ((i + 0.5) * cell, (j + 0.5) * cell)
            a, b = near_found(centre), near_true(centre)
            both += a and b
            either += a or b
    return share(map(near_found, points)), share(map(near_true, found)), both / either if either else None


def agrees(found, expected):
    assert (found.recall, found.precision, found.iou) == tuple(
        None if value is None else pytest.approx(value, abs=1e-12) for value in expected
    )


@settings(deadline=None, max_examples=60)
@given(grids(cells_mm=(50, 100)), walls, tolerances)
def test_a_score_against_walls_is_the_definition_computed_by_force(grid, truth, tolerance):
    agrees(score(grid, truth, tolerance), brute_force(grid, truth, tolerance))


@settings(deadline=None, max_examples=60)
@given(grids(), grids(), tolerances)
def test_a_score_against_a_map_is_the_definition_computed_by_force(grid, truth, tolerance):
    agrees(score(grid, truth, tolerance), brute_force(grid, truth, tolerance))


@given(grids())
def test_a_map_scores_one_against_itself(grid):
    result = score(grid, grid)
    assert {result.recall, result.precision, result.iou} <= {1.0, None}


def wall_map(columns=100, row=0):
    """A wall along row 0 and free space north of it, cells of 5 cm, lower-left corner at the origin."""
    evidence = np.full((10, columns), -400, np.int32)
    evidence[row] = 300
    return Grid(evidence, 0, 0, Lattice(50))


def test_a_wall_half_found_has_half_the_recall_and_full_precision():
    half = Grid(wall_map().evidence[:, :50], 0, 0, Lattice(50))
    result = score(half, np.array([[0.0, 0.025, 5.0, 0.025]]))
    assert result.precision == 1.0
    assert result.recall == pytest.approx(0.5, abs=0.02)
    assert result.iou == pytest.approx(0.5, abs=0.02)
    assert result.known_m2 == pytest.approx(10 * 50 * 0.0025)
    assert (result.occupied, result.tolerance) == (50, pytest.approx(0.075))


def test_the_tolerance_decides_exactly():
    """The centres lie at y = 0.025: 8 cm away from a wall at 0.105, to the nanometre."""
    wall = np.array([[0.0, 0.105, 5.0, 0.105]])
    assert score(wall_map(), wall, 0.08).precision == 1.0
    assert score(wall_map(), wall, 0.0799).precision == 0.0
    assert score(wall_map(), wall, 0.0799).recall == 0.0


def test_points_are_a_centimetre_apart_along_a_slanted_wall():
    """Half of a wall that leaves the map is found; its length along the slope counts, not its width."""
    steps = np.arange(100)
    evidence = np.zeros((100, 100), np.int32)
    evidence[steps, steps] = 300
    result = score(Grid(evidence, 0, 0, Lattice(50)), np.array([[0.0, 0.0, 10.0, 10.0]]))
    assert result.recall == pytest.approx(0.5, abs=0.01)


def test_the_inside_of_a_true_wall_need_not_be_found():
    thick = np.full((20, 30), -400, np.int32)
    thick[5:15] = 300
    thin = thick.copy()
    thin[6:14] = 0
    result = score(Grid(thin, 0, 0, Lattice(50)), Grid(thick, 0, 0, Lattice(50)), 0.0)
    assert (result.recall, result.precision) == (1.0, 1.0)
    inner = score(Grid(thick, 0, 0, Lattice(50)), Grid(thick, 0, 0, Lattice(50)), 0.0)
    assert (inner.recall, inner.precision, inner.iou) == (1.0, 1.0, 1.0)


def test_an_empty_map_has_no_recall_and_no_precision_to_speak_of():
    empty = Grid(np.zeros((0, 0), np.int32), 0, 0, Lattice(50))
    found = score(empty, np.array([[0.0, 0.0, 1.0, 0.0]]))
    assert (found.recall, found.precision, found.iou, found.known_m2, found.occupied) == (0.0, None, 0.0, 0.0, 0)
    nothing = score(empty, empty)
    assert (nothing.recall, nothing.precision, nothing.iou) == (None, None, None)
    no_walls = score(wall_map(), np.zeros((0, 4)))
    assert (no_walls.recall, no_walls.precision, no_walls.iou) == (None, 0.0, 0.0)


@pytest.mark.parametrize(
    ("walls", "tolerance", "message"),
    [
        (np.zeros((2, 3)), None, r"walls: expected segments \(M, 4\), got \(2, 3\)"),
        (np.array([[0, 0, math.nan, 1]]), None, "walls: expected finite numbers"),
        (np.array([[0, 0, 1e300, 1]]), None, "walls: expected finite numbers"),
        (np.array([[0.0, 0, 999_999, 0]]), None, "are the numbers metres"),
        (np.array([[9e5, 9e5, 9e5, 9e5 + 1]]), None, "are both in one frame"),
        (np.zeros((1, 4)), -0.1, "tolerance: -0.1 m"),
        (np.zeros((1, 4)), 5.0, "tolerance: 5.0 m, expected 0 to 50 cells"),
        (np.zeros((1, 4)), math.nan, "tolerance: nan m"),
    ],
)
def test_what_cannot_be_scored_is_refused(walls, tolerance, message):
    with pytest.raises(ValueError, match=message):
        score(wall_map(), walls, tolerance)


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["cave", "depot", "test04"])
def test_a_public_map_is_found_whole_in_one_of_half_its_cell_size(recordings_dir, name):
    from mapping.map_server import decode_description, decode_map_server

    folder = recordings_dir / "maps"
    found = decode_description((folder / f"{name}.yaml").read_bytes())
    truth = decode_map_server(found, (folder / found.image).read_bytes())
    fine = truth.evidence.repeat(2, axis=0).repeat(2, axis=1)
    halved = Grid(fine, truth.i0 * 2, truth.j0 * 2, Lattice(truth.lattice.cell_mm // 2))
    result = score(halved, truth)
    assert (result.recall, result.precision) == (1.0, 1.0)
