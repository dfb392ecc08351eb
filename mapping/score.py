"""How good a map is: recall, precision and IoU against the truth, which is walls or another map.

The definitions, for a map whose cells are called occupied where p > 0.65, and a tolerance in metres:

* **recall**: the share of points every 1 cm along the true walls that lie within the tolerance of an occupied cell's
  centre. In a true *map* the points are the centres of the occupied cells that touch a free one, at a side or a
  corner: what lies inside a wall nobody can see.
* **precision**: the share of the occupied cells' centres that lie within the tolerance of a wall; in a true map, of
  the centre of an occupied cell.
* **IoU**: grow both by the tolerance, and divide what they share by what they cover together: of the cells of the
  map's lattice, those with their centre within the tolerance of an occupied cell's centre, and those with their
  centre within the tolerance of a wall (of a true occupied cell's centre).
* **known area**: the cells with any evidence, in square metres.

Law kept here: a distance is exact (to a nanometre, so that rounding does not decide at the edge), never that of a
distance map's pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.evidence import occupied
from mapping.grid import Grid

Walls = NDArray[np.float64]
"""Segments, shape (M, 4): x1, y1, x2, y2 in metres."""

STEP = 0.01
"""Metres between the points along a wall."""

DEFAULT_TOLERANCE_CELLS = 1.5
_SLACK = 1e-9
_MAX_COORDINATE = 1e6
_MAX_POINTS = 10_000_000
_MAX_WINDOW = 1 << 28


@dataclass(frozen=True, slots=True)
class Score:
    """What a map is worth; None where the definition divides by zero.

    Attributes:
        recall: 0 to 1; 0 for an empty map, None if there are no true walls.
        precision: 0 to 1; None if no cell is occupied.
        iou: 0 to 1; None if there is neither.
        known_m2: square metres.
        occupied: number of occupied cells.
        tolerance: metres.
    """

    recall: float | None
    precision: float | None
    iou: float | None
    known_m2: float
    occupied: int
    tolerance: float


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """A score, and what in the map and in the truth it comes from. Points are metres in the common frame.

    Attributes:
        score: the numbers.
        occupied: centres of the occupied cells, shape (K, 2).
        true: which of them count for the precision, shape (K,).
        visible: the points of the truth that ought to be in the map, shape (N, 2).
        found: which of them count for the recall, shape (N,).
    """

    score: Score
    occupied: NDArray[np.float64]
    true: NDArray[np.bool_]
    visible: NDArray[np.float64]
    found: NDArray[np.bool_]


def score(grid: Grid, truth: Walls | Grid, tolerance: float | None = None) -> Score:
    """Score a map; see ``judge``."""
    return judge(grid, truth, tolerance).score


def judge(grid: Grid, truth: Walls | Grid, tolerance: float | None = None) -> Judgement:
    """Score a map, and tell what is right and wrong in it.

    Args:
        grid: the map.
        truth: the walls, or a true map, whose cell size may be another.
        tolerance: metres; 1.5 cells of ``grid`` if None.

    Raises:
        ValueError: the walls are not finite segments, or so long or so far from the map that they cannot be in the
            same frame and unit; the tolerance is negative or more than 50 cells.
    """
    cell = grid.lattice.cell
    tolerance = DEFAULT_TOLERANCE_CELLS * cell if tolerance is None else tolerance
    if not 0 <= tolerance <= 50 * cell:
        raise ValueError(f"tolerance: {tolerance} m, expected 0 to 50 cells of {cell} m")
    mask = occupied(grid.evidence)
    centres = grid.centres(mask)
    if isinstance(truth, Grid):
        true_centres = truth.centres(occupied(truth.evidence))
        points, segments = true_centres, _points_as_walls(true_centres)
        visible = truth.centres(_surface(truth.evidence))
    else:
        points, segments = _along(truth)
        visible = points
    window = _Window.around(cell, tolerance, centres, points)
    found = window.within(centres, _points_as_walls(centres), tolerance)
    true = window.within(points, segments, tolerance)
    near, right = _near(visible, grid, mask, tolerance), true[window.cells(centres)]
    numbers = Score(
        recall=_share(near),
        precision=_share(right),
        iou=_share((found & true)[found | true]),
        known_m2=grid.known_m2,
        occupied=len(centres),
        tolerance=tolerance,
    )
    return Judgement(numbers, centres, right, visible, near)


def _share(hits: NDArray[np.bool_]) -> float | None:
    return float(hits.mean()) if hits.size else None


def _points_as_walls(points: NDArray[np.float64]) -> Walls:
    return np.hstack([points, points])


def _along(walls: Walls) -> tuple[NDArray[np.float64], Walls]:
    """Points on every wall, both ends included and at most 1 cm apart, and the wall that each lies on."""
    if walls.ndim != 2 or walls.shape[1] != 4:
        raise ValueError(f"walls: expected segments (M, 4), got {walls.shape}")
    if not (np.abs(walls) <= _MAX_COORDINATE).all():
        raise ValueError("walls: expected finite numbers of metres within 1000 km")
    start, step = walls[:, :2], walls[:, 2:] - walls[:, :2]
    # The slack keeps a wall of 7 cm at seven steps, though 0.07 / 0.01 is a little more than 7.
    steps = np.ceil(np.hypot(step[:, 0], step[:, 1]) / STEP - 1e-6).clip(0)
    if steps.sum() + len(walls) > _MAX_POINTS:
        raise ValueError(f"walls: {steps.sum() * STEP:.0f} m long in all; are the numbers metres?")
    counts = steps.astype(np.int64) + 1
    wall = np.repeat(np.arange(len(walls)), counts)
    k = np.arange(len(wall)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = k / np.maximum(steps, 1)[wall]
    return start[wall] + share[:, None] * step[wall], walls[wall]


def _surface(evidence: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The occupied cells with a free one (more often seen free than occupied) among their eight neighbours."""
    rows, columns = evidence.shape
    free = np.pad(evidence < 0, 1)
    touches = np.zeros(evidence.shape, np.bool_)
    for dj in range(3):
        for di in range(3):
            touches |= free[dj : dj + rows, di : di + columns]
    return occupied(evidence) & touches


def _offsets(radius: float) -> list[tuple[int, int]]:
    """Cells (dj, di), nearest first, whose centre can lie within ``radius`` cells of a point in cell (0, 0)."""
    reach = range(-math.ceil(radius) - 1, math.ceil(radius) + 2)

    def nearest(offset: tuple[int, int]) -> float:
        return math.hypot(*(max(abs(d) - 0.5, 0.0) for d in offset))

    return sorted((o for o in ((dj, di) for dj in reach for di in reach) if nearest(o) <= radius + 1e-5), key=nearest)


def _near(points: NDArray[np.float64], grid: Grid, mask: NDArray[np.bool_], tolerance: float) -> NDArray[np.bool_]:
    """Which points, shape (N, 2), lie within the tolerance of the centre of a cell in ``mask``; shape (N,)."""
    cell = grid.lattice.cell
    rows, columns = mask.shape
    near = np.zeros(len(points), np.bool_)
    index = np.floor(points / cell).astype(np.int64)
    for dj, di in _offsets(tolerance / cell):
        left = np.flatnonzero(~near)
        i, j = index[left, 0] + di, index[left, 1] + dj
        column, row = i - grid.i0, j - grid.j0
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        inside[inside] = mask[row[inside], column[inside]]
        left, i, j = left[inside], i[inside], j[inside]
        away = np.hypot((i + 0.5) * cell - points[left, 0], (j + 0.5) * cell - points[left, 1])
        near[left] = away <= tolerance + _SLACK
    return near


@dataclass(frozen=True, slots=True)
class _Window:
    """The part of the map's lattice that map and truth, grown by the tolerance, lie in."""

    cell: float
    i0: int
    j0: int
    shape: tuple[int, int]

    @classmethod
    def around(cls, cell: float, tolerance: float, *points: NDArray[np.float64]) -> _Window:
        every = np.vstack([*points, np.zeros((0, 2))])
        if not len(every):
            return cls(cell, 0, 0, (0, 0))
        low, high = np.floor(every.min(axis=0) / cell), np.floor(every.max(axis=0) / cell)
        margin = math.ceil((tolerance + STEP) / cell) + 1
        columns, rows = high - low + 1 + 2 * margin
        if columns * rows > _MAX_WINDOW:
            width, height = (high - low + 1) * cell
            raise ValueError(f"truth: with the map it spans {width:.0f} x {height:.0f} m; are both in one frame?")
        return cls(cell, int(low[0]) - margin, int(low[1]) - margin, (int(rows), int(columns)))

    def cells(self, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column of the cell that each point lies in."""
        index = np.floor(points / self.cell).astype(np.int64)
        return index[:, 1] - self.j0, index[:, 0] - self.i0

    def within(self, points: NDArray[np.float64], segments: Walls, tolerance: float) -> NDArray[np.bool_]:
        """The cells whose centre lies within the tolerance of a segment.

        Args:
            points: shape (N, 2), at most 1 cm apart along the segments: they say where to look.
            segments: shape (N, 4): the segment that each point lies on.
            tolerance: metres.
        """
        mask = np.zeros(self.shape, np.bool_)
        rows, columns = self.cells(points)
        # Only the cell of a point matters from here on, and neighbours on a wall mostly share theirs.
        same = (np.diff(rows) == 0) & (np.diff(columns) == 0) & (segments[1:] == segments[:-1]).all(axis=1)
        fresh = np.flatnonzero(np.append(True, ~same)[: len(rows)])
        rows, columns, segments = rows[fresh], columns[fresh], segments[fresh]
        start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
        length2 = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)
        corner = np.array([self.i0, self.j0])
        for dj, di in _offsets((tolerance + STEP) / self.cell):
            row, column = rows + dj, columns + di
            centre = (np.column_stack([column, row]) + corner + 0.5) * self.cell - start
            foot = ((centre * along).sum(axis=1) / length2).clip(0, 1)[:, None] * along
            away = np.hypot(*(centre - foot).T)
            close = away <= tolerance + _SLACK
            mask[row[close], column[close]] = True
        return mask
