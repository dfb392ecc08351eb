"""A map made small: as many cells as fit into a rectangle, for where there is little room to draw.

Law kept here: a wall does not vanish, however small the picture: of the cells that become one, the occupied wins, then
the free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.grid import Grid

FREE, UNKNOWN, OCCUPIED = -1, 0, 1


@dataclass(frozen=True, slots=True, eq=False)
class Thumbnail:
    """The small map.

    Attributes:
        cells: int8, shape (rows, columns), ``FREE``, ``UNKNOWN`` or ``OCCUPIED``; row 0 is north.
        west: x in metres of the left edge.
        north: y in metres of the upper edge.
        cell: metres that one of its cells is wide.
    """

    cells: NDArray[np.int8]
    west: float
    north: float
    cell: float

    @classmethod
    def of(cls, grid: Grid, rows: int, columns: int) -> Thumbnail:
        """The largest one of a map that has at most so many rows and columns, each at least 1.

        A cell of it is a whole number of cells of the map wide.
        """
        height, width = grid.evidence.shape
        factor = max(1, math.ceil(height / rows), math.ceil(width / columns))
        x, y = grid.origin
        signs = np.sign(grid.evidence[::-1]).astype(np.int8)
        signs = np.pad(signs, ((0, -height % factor), (0, -width % factor)))
        blocks = signs.reshape(-(-height // factor), factor, -(-width // factor), factor)
        occupied, free = (blocks > 0).any(axis=(1, 3)), (blocks < 0).any(axis=(1, 3))
        cells = np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.int8)
        return cls(cells, x, y + height * grid.lattice.cell, factor * grid.lattice.cell)

    def place(self, x: float, y: float) -> tuple[int, int] | None:
        """Row and column of a point in metres; None if it lies outside."""
        row, column = math.floor((self.north - y) / self.cell), math.floor((x - self.west) / self.cell)
        rows, columns = self.cells.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None
