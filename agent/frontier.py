"""Where unknown land begins, and how to get there: frontiers and a wavefront over a coarse picture of the fused map.

Laws kept here: the robot's whole body stays on what is known to be free, and a margin away from what is known to be
occupied; pure functions, from a map to a way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.driver import ROBOT_RADIUS
from mapping.evidence import occupied
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.tiles import Tiles

MARGIN = 0.045
"""Metres that a planned way keeps from what is occupied, besides the robot's radius: the map is a cell or two wrong at
the end of a wall, which few rays meet, and so is the robot's place on it."""

COARSE = 0.04
"""Metres: the side of a coarse cell; about half the robot's radius is fine enough to plan with."""

SMALLEST = 0.08
"""Metres: a frontier that is shorter, where the robot's centre could pass it, is a crack or a gap between rays."""

VIEW = ROBOT_RADIUS + 2 * COARSE
"""Metres from a frontier at which the robot looks over it; nearer it does not go to what it does not know."""

Mask = NDArray[np.bool_]
Points = NDArray[np.float64]

_NEIGHBOURS = [(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)]  # the straight four first


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """A map in coarse cells; rows are y, columns are x. A rim of unknown cells surrounds what is known.

    Attributes:
        free: bool, shape (rows, columns): something is free in it, or all around it, and nothing occupied.
        occupied: bool, likewise: something in it is occupied.
        cell: metres, the side of a coarse cell.
        x0: metres, the lower-left corner of cell [0, 0] in the common frame.
        y0: metres.
    """

    free: Mask
    occupied: Mask
    cell: float
    x0: float
    y0: float

    @property
    def unknown(self) -> Mask:
        """Cells that nothing is known of."""
        return np.asarray(~(self.free | self.occupied))

    def cells(self, points: Points) -> NDArray[np.int64]:
        """Row and column of each point, shape (K, 2); a point outside is moved into the rim."""
        indices = np.floor((points[:, ::-1] - (self.y0, self.x0)) / self.cell).astype(np.int64)
        return np.clip(indices, 0, np.array(self.free.shape) - 1)

    def centres(self, cells: NDArray[np.int64]) -> Points:
        """x, y in metres of each cell's centre, shape (K, 2)."""
        return np.asarray((cells[:, ::-1] + 0.5) * self.cell + (self.x0, self.y0), dtype=np.float64)

    def discs(self, points: Points, radius: float) -> Mask:
        """The cells whose centres lie within ``radius`` metres of the centre of a point's cell."""
        return grown(self._mask(self.cells(points)), radius / self.cell)

    def _mask(self, cells: NDArray[np.int64]) -> Mask:
        mask = np.zeros(self.free.shape, np.bool_)
        mask[cells[:, 0], cells[:, 1]] = True
        return mask


def terrain_of(tiles: Tiles, lattice: Lattice, here: Points) -> Terrain:
    """The coarse picture of a map.

    Args:
        tiles: the map.
        lattice: its cell size.
        here: shape (K, 2), points that the picture must contain, metres.
    """
    grid = Grid.of(tiles, lattice)
    merge = max(1, round(COARSE / lattice.cell))
    rows, columns = grid.evidence.shape
    fine = np.floor(here / lattice.cell).astype(np.int64)  # i, j
    lowest = np.minimum(fine.min(axis=0), (grid.i0, grid.j0) if rows else fine.min(axis=0))
    highest = np.maximum(fine.max(axis=0) + 1, (grid.i0 + columns, grid.j0 + rows) if rows else fine.max(axis=0) + 1)
    rim = math.ceil((ROBOT_RADIUS + MARGIN) / (merge * lattice.cell)) + 1
    i0, j0 = ((lowest // merge - rim) * merge).tolist()
    width, height = (-(-(highest - (i0, j0)) // merge) + rim).tolist()
    whole = np.zeros((height * merge, width * merge), np.int32)
    whole[grid.j0 - j0 : grid.j0 - j0 + rows, grid.i0 - i0 : grid.i0 - i0 + columns] = grid.evidence
    blocked = _merged(occupied(whole), merge)
    free = _merged(np.asarray(whole < 0), merge) & ~blocked
    return Terrain(filled(free) & ~blocked, blocked, merge * lattice.cell, i0 * lattice.cell, j0 * lattice.cell)


def _merged(mask: Mask, merge: int) -> Mask:
    """Whether any cell of each block of ``merge`` by ``merge`` is set; strided, as reducing short axes is slow."""
    parts = [mask[row::merge, column::merge] for row, column in np.ndindex(merge, merge)]
    return np.asarray(np.logical_or.reduce(parts))


def grown(mask: Mask, radius: float) -> Mask:
    """The cells within ``radius`` (in cells) of a set one, centre to centre.

    Only the rim of what is set is walked along: whatever is near to an inner cell and not set itself is at least as
    near to a cell of the rim that lies between them. That is what keeps a large unknown land cheap.
    """
    inner = np.logical_and.reduce([_shifted(mask, *step) for step in _NEIGHBOURS[:4]])
    rows, columns = np.nonzero(mask & ~inner)
    reach = math.floor(radius)
    result = mask.copy()
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            if down * down + right * right <= radius * radius:
                r, c = rows + down, columns + right
                inside = (r >= 0) & (r < mask.shape[0]) & (c >= 0) & (c < mask.shape[1])
                result[r[inside], c[inside]] = True
    return result


def filled(mask: Mask) -> Mask:
    """With the cells most of whose eight neighbours are set: gaps between rays are no land to discover."""
    around = sum(_shifted(mask, *step).astype(np.int8) for step in _NEIGHBOURS)
    return mask | (around >= 5)


def kept_clear(terrain: Terrain) -> Mask:
    """Cells that are too near to what is occupied for the robot's centre."""
    return grown(terrain.occupied, (ROBOT_RADIUS + MARGIN) / terrain.cell)


def passable(terrain: Terrain, here: Points, mates: Points) -> Mask:
    """Where the robot's centre may be: its body is on free cells there, and a margin away from all that is occupied.

    The cells under the robot are free, whatever the map says: it stands there, and must get away from a wall that it
    is too near to.

    Args:
        terrain: the map.
        here: shape (1, 2), where the robot is.
        mates: shape (K, 2), where its team-mates are: as large as itself.
    """
    unsafe = kept_clear(terrain) | grown(terrain.unknown, ROBOT_RADIUS / terrain.cell)
    body = terrain.discs(here, ROBOT_RADIUS) & ~terrain.occupied
    way = (terrain.free & ~unsafe) | body
    return way & ~terrain.discs(mates, 2 * ROBOT_RADIUS + MARGIN) if len(mates) else way


def frontiers(terrain: Terrain) -> Mask:
    """Free cells beside unknown ones that the robot's centre could pass, in groups that are not too small."""
    beside = np.zeros_like(terrain.free)
    for step in _NEIGHBOURS[:4]:
        beside |= _shifted(terrain.unknown, *step)
    found = terrain.free & beside & ~kept_clear(terrain)
    return large_groups(found, SMALLEST / terrain.cell)


def large_groups(mask: Mask, least: float) -> Mask:
    """The set cells that touch, by sides or corners, at least ``least`` of their kind, themselves included."""
    left = {(row, column) for row, column in np.argwhere(mask).tolist()}
    result = np.zeros_like(mask)
    while left:
        group = [left.pop()]
        for row, column in group:  # grows while it is walked through
            touching = {(row + down, column + right) for down, right in _NEIGHBOURS} & left
            left -= touching
            group += touching
        if len(group) >= least:
            result[tuple(np.array(group).T)] = True
    return result


def viewpoints(terrain: Terrain, targets: Mask) -> Mask:
    """Cells from which the robot looks over frontiers."""
    return grown(targets, VIEW / terrain.cell)


def _shifted(mask: Mask, down: int, right: int) -> Mask:
    """What each cell's neighbour at that step is."""
    padded = np.pad(mask, 1)
    rows, columns = mask.shape
    return padded[1 + down : 1 + down + rows, 1 + right : 1 + right + columns]


def way_to_nearest(way: Mask, start: tuple[int, int], targets: Mask) -> list[tuple[int, int]] | None:
    """The shortest way over cells to the nearest of some targets, start and target included.

    Args:
        way: where it may lead.
        start: row and column; allowed whatever ``way`` says.
        targets: where it should lead; those off the way cannot be reached.
    """
    columns = way.shape[1] + 2
    open_ = np.pad(way, 1).ravel()
    wanted = np.pad(targets, 1).ravel()
    steps = [down * columns + right for down, right in _NEIGHBOURS]
    origin = (start[0] + 1) * columns + start[1] + 1
    reached = np.full(open_.shape, -1, np.int32)
    reached[origin] = 0
    front = np.array([origin], np.int64)
    wave = 0
    while len(front):  # a wave of cells that are equally far from the start
        if wanted[front].any():
            goal = int(front[wanted[front]][0])
            return [(at // columns - 1, at % columns - 1) for at in _back(reached, goal, steps)]
        wave += 1
        following = np.concatenate([front + step for step in steps])
        following = following[open_[following] & (reached[following] < 0)]
        reached[following] = wave
        front = np.unique(following)
    return None


def _back(reached: NDArray[np.int32], cell: int, steps: list[int]) -> list[int]:
    """The way that the wave took to a cell, from its origin."""
    trail = [cell]
    for wave in range(int(reached[cell]) - 1, -1, -1):
        trail.append(next(trail[-1] + step for step in steps if reached[trail[-1] + step] == wave))
    return trail[::-1]


def straightened(trail: list[tuple[int, int]], way: Mask) -> list[tuple[int, int]]:
    """The corners of a way over cells: as few as can see each other, without the start."""
    corners: list[tuple[int, int]] = []
    at = 0
    while at < len(trail) - 1:
        ahead = at + 1
        while ahead + 1 < len(trail) and _clear(trail[at], trail[ahead + 1], way):
            ahead += 1
        corners.append(trail[ahead])
        at = ahead
    return corners


def _clear(a: tuple[int, int], b: tuple[int, int], way: Mask) -> bool:
    """Whether the straight line between two cells' centres stays on the way; looked at four times a cell."""
    count = 4 * max(abs(b[0] - a[0]), abs(b[1] - a[1])) + 1
    line = np.rint(np.linspace(a, b, count)).astype(np.int64)
    return bool(way[line[:, 0], line[:, 1]].all())
