"""The occupied cells of a picture as walls: where rays enter one, and how far points are from one.

Laws kept here: exact for the squares that the cells are; two cells that touch at a corner leave no gap there; what
is free or unknown, or lies beyond the picture, stops nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.geometry import Floats

_CORNER = 1e-9
"""Cells; a ray that passes a corner nearer than this touches the cells on both sides of it."""

_STILL = 1e-12
"""A ray that goes no faster than this along an axis, of 1 in all, crosses no line of it in any picture's width."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupiedCells:
    """A picture's walls.

    Attributes:
        occupied: shape (rows, columns); row 0 is south, column 0 is west.
        origin: x, y of the lower-left corner, metres.
        cell: metres.
    """

    occupied: NDArray[np.bool_]
    origin: tuple[float, float]
    cell: float

    def cast(self, origins: Floats, bearings: Floats, reach: float = np.inf) -> Floats:
        """How far each ray goes until it enters an occupied cell; 0 for a ray that starts in one.

        A ray enters every cell through one of the lattice's lines, so the lines it crosses are all that is looked at
        (as Amanatides and Woo do one by one, 1987), for all rays at once.

        Args:
            origins: shape (K, 2), metres.
            bearings: shape (K,), radians counter-clockwise from the x axis.
            reach: metres beyond which nobody cares; it bounds the work.

        Returns:
            Shape (K,), metres; infinity where no cell is met within ``reach``.
        """
        if not self.occupied.any() or not len(origins):
            return np.full(len(bearings), np.inf)
        points = (origins - self.origin) / self.cell
        towards = np.column_stack([np.cos(bearings), np.sin(bearings)])
        inside = self._is_occupied(np.floor(points[:, 0]), np.floor(points[:, 1]))
        entered = np.minimum(self._enter(points, towards, reach, axis=0), self._enter(points, towards, reach, axis=1))
        distance = np.where(inside, 0.0, entered * self.cell)
        return np.where(distance <= reach, distance, np.inf)

    def _enter(self, points: Floats, towards: Floats, reach: float, axis: int) -> Floats:
        """How far, in cells, until an occupied cell is entered across a line of constant coordinate ``axis``."""
        size = self.occupied.shape[1 - axis]
        start, speed = points[:, axis, None], towards[:, axis, None]
        most = min(reach / self.cell, float(np.maximum(np.abs(points[:, axis]), np.abs(size - points[:, axis])).max()))
        k = np.arange(int(np.ceil(most)) + 1)
        forward = speed > 0
        line = np.floor(start) + np.where(forward, 1 + k, -k)
        moving = np.abs(speed) > _STILL
        time = np.divide(line - start, speed, out=np.full(line.shape, np.inf), where=moving)
        entered = np.where(forward, line, line - 1)
        across = points[:, 1 - axis, None] + np.where(moving, time, 0) * towards[:, 1 - axis, None]
        hit = np.zeros(line.shape, np.bool_)
        for side in (-_CORNER, _CORNER):
            other = np.floor(across + side)
            hit |= self._is_occupied(*((entered, other) if axis == 0 else (other, entered)))
        return np.asarray(np.where(hit & moving, time, np.inf).min(axis=1))

    def _is_occupied(self, column: Floats, row: Floats) -> NDArray[np.bool_]:
        """Whether a cell is; one beyond the picture is not."""
        rows, columns = self.occupied.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        at = np.where(inside, row, 0).astype(np.intp), np.where(inside, column, 0).astype(np.intp)
        return np.asarray(self.occupied[at] & inside)

    def distances(self, points: Floats, within: float) -> Floats:
        """From each point, shape (N, 2), to the nearest occupied cell, metres; ``within`` if none is so near."""
        if not self.occupied.any():
            return np.full(len(points), np.inf)
        around = np.arange(-int(np.ceil(within / self.cell)), int(np.ceil(within / self.cell)) + 1)
        x, y = ((points - self.origin) / self.cell).T
        columns, rows = np.floor(x)[:, None] + around, np.floor(y)[:, None] + around
        gap_x = np.maximum(np.maximum(columns - x[:, None], x[:, None] - columns - 1), 0)
        gap_y = np.maximum(np.maximum(rows - y[:, None], y[:, None] - rows - 1), 0)
        gaps = np.hypot(gap_x[:, None, :], gap_y[:, :, None]) * self.cell
        shape = gaps.shape
        met = self._is_occupied(np.broadcast_to(columns[:, None, :], shape), np.broadcast_to(rows[:, :, None], shape))
        return np.asarray(np.where(met, gaps, within).min(axis=(1, 2)).clip(max=within))


NO_CELLS = OccupiedCells(np.zeros((0, 0), np.bool_), (0.0, 0.0), 1.0)
"""A world without a picture."""
