"""Dense arrays that rays are drawn onto: a box of cells twice, by rows and by columns.

In the half by rows the cells of a row lie side by side, in the other half those of a column. So whichever way a ray
runs, there is a half where a step to one side is one cell in memory and a step ahead a whole line, and one where it is
the other way around. Where the step that may be a fraction of a cell is the one along memory, a place on the canvas and
that fraction are one number of 64 bits, and whatever follows a ray step by step is an arithmetic progression:

    (first + k * step) >> FRACTION,   k = 0, 1, ...

with no other arithmetic from one to the next. The kernels differ in what they follow: ``mapping.raster_jit`` the cells
of a ray, ``mapping.corners`` the places where it goes from one line to the next.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from mapping.lattice import TILE
from mapping.tiles import Evidence

FRACTION = 32
"""Fraction bits of a progression; the address is above them."""


class Box(NamedTuple):
    """A rectangle of whole tiles, the first one and how many; and its canvas."""

    ty: int
    tx: int
    rows: int
    columns: int

    @classmethod
    def around(cls, low_j: int, low_i: int, high_j: int, high_i: int) -> Self:
        """The tiles of two cells and of all between them."""
        ty, tx = low_j // TILE, low_i // TILE
        return cls(ty, tx, high_j // TILE - ty + 1, high_i // TILE - tx + 1)

    @property
    def area(self) -> int:
        """How many cells it has."""
        return self.rows * self.columns * TILE * TILE

    @property
    def lines(self) -> tuple[int, int, int]:
        """Where columns begin in the canvas, and cells from one row to the next, from one column to the next.

        The last two are half a tile more than they need be: were they multiples of a large power of two, the cells of
        a ray would fall into the same few sets of the cache. And the cell behind the last one of a line is there.
        """
        row, column = self.columns * TILE + TILE // 2, self.rows * TILE + TILE // 2
        return self.rows * TILE * row, row, column

    def canvases(self, count: int) -> NDArray[np.int32]:
        """Canvases of zeros, shape (count, cells)."""
        columns, _, column = self.lines
        return np.zeros((count, columns + self.columns * TILE * column), np.int32)

    def halves(self, canvas: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The rows and the columns of a canvas, a line each: views."""
        columns, row, column = self.lines
        return canvas[:columns].reshape(-1, row), canvas[columns:].reshape(-1, column)

    def tiles(self, cells: NDArray[np.int32]) -> Evidence:
        """The tiles that have any evidence, of the cells of the box, shape (rows * TILE, columns * TILE)."""
        tiles = cells.reshape(self.rows, TILE, self.columns, TILE)
        rows, columns = np.nonzero(np.bitwise_or.reduce(tiles, axis=1).any(axis=2))
        keys = np.stack([rows + self.ty, columns + self.tx], axis=1).astype(np.int32)
        return Evidence(keys, tiles[rows, :, columns])
