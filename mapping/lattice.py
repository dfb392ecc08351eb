"""The common lattice: square cells of one size for the whole swarm, kept in tiles of 32 x 32.

Cell (i, j) covers [i*s, (i+1)*s) x [j*s, (j+1)*s): i counts along x, j along y, negative ones too. The origin never
moves and the map has no edge. Tile (ty, tx) holds the cells with j // 32 == ty and i // 32 == tx; in its array rows
are y and columns are x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

TILE = 32
"""Cells along one side of a tile."""

MAX_RAY_CELLS = 4095
"""The longest ray in cells: it bounds what one reading can touch and fits every kernel's arithmetic."""

Cells = NDArray[np.int32]
"""The evidence of one tile, shape (32, 32), row-major, rows are y."""


class TileKey(NamedTuple):
    """A tile's integer coordinates. Sorting keys gives the order of the map digest: (ty, tx)."""

    ty: int
    tx: int


@dataclass(frozen=True, slots=True)
class Lattice:
    """The cell size, a whole number of millimetres.

    Raises:
        ValueError: the size is not between 1 mm and 10 m.
    """

    cell_mm: int

    def __post_init__(self) -> None:
        if not 1 <= self.cell_mm <= 10_000:
            raise ValueError(f"cell: {self.cell_mm} mm, expected 1 mm to 10 m")

    @classmethod
    def of(cls, cell: float) -> Self:
        """The lattice with cells of ``cell`` metres.

        Raises:
            ValueError: not a whole number of millimetres, or out of range.
        """
        if not 0 < cell <= 10:  # NaN too
            raise ValueError(f"cell: {cell} m, expected 0.001 to 10 m")
        cell_mm = round(cell * 1000)
        if abs(cell * 1000 - cell_mm) > 1e-6:
            raise ValueError(f"cell: {cell} m is not a whole number of millimetres")
        return cls(cell_mm)

    @property
    def cell(self) -> float:
        """The cell size in metres."""
        return self.cell_mm / 1000

    def check_range(self, max_range_mm: int) -> None:
        """Refuse a range that would draw rays of more than 4,095 cells.

        Raises:
            ValueError: with the largest range that this cell size allows.
        """
        if max_range_mm > MAX_RAY_CELLS * self.cell_mm:
            raise ValueError(
                f"max_range: {max_range_mm / 1000} m is more than {MAX_RAY_CELLS} cells of {self.cell} m; "
                f"use at most {MAX_RAY_CELLS * self.cell_mm / 1000} m or larger cells"
            )
