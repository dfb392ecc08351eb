"""A finished map as one dense array: what pictures, files and scores are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mapping.lattice import TILE, Lattice, TileKey
from mapping.tiles import Tiles, frozen, map_digest


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A rectangle of the lattice that holds every known cell of a map.

    Attributes:
        evidence: int32, shape (rows, columns), read-only; row 0 is south, column 0 is west; 0 is unknown.
        i0: cell index along x of column 0.
        j0: cell index along y of row 0.
        lattice: the cell size.
    """

    evidence: NDArray[np.int32]
    i0: int
    j0: int
    lattice: Lattice

    @classmethod
    def of(cls, tiles: Tiles, lattice: Lattice) -> Self:
        """The smallest rectangle around all non-zero cells; empty (0 x 0 at the origin) for an empty map."""
        keys = [key for key in sorted(tiles) if tiles[key].any()]
        if not keys:
            return cls(frozen(np.zeros((0, 0), np.int32)), 0, 0, lattice)
        table = np.array(keys, np.int64)
        ty0, tx0 = table.min(axis=0).tolist()
        ty1, tx1 = table.max(axis=0).tolist()
        whole = np.zeros(((ty1 - ty0 + 1) * TILE, (tx1 - tx0 + 1) * TILE), np.int32)
        for ty, tx in keys:
            row, column = (ty - ty0) * TILE, (tx - tx0) * TILE
            whole[row : row + TILE, column : column + TILE] = tiles[TileKey(ty, tx)]
        rows = np.flatnonzero(whole.any(axis=1))
        columns = np.flatnonzero(whole.any(axis=0))
        part = whole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy()
        return cls(frozen(part), int(tx0 * TILE + columns[0]), int(ty0 * TILE + rows[0]), lattice)

    def tiles(self) -> dict[TileKey, NDArray[np.int32]]:
        """Back to tiles: the non-zero ones, as ``of`` took them."""
        rows, columns = self.evidence.shape
        ty0, tx0 = self.j0 // TILE, self.i0 // TILE
        ty1, tx1 = (self.j0 + rows - 1) // TILE, (self.i0 + columns - 1) // TILE
        whole = np.zeros(((ty1 - ty0 + 1) * TILE, (tx1 - tx0 + 1) * TILE), np.int32)
        row, column = self.j0 - ty0 * TILE, self.i0 - tx0 * TILE
        whole[row : row + rows, column : column + columns] = self.evidence
        result: dict[TileKey, NDArray[np.int32]] = {}
        for ty in range(ty0, ty1 + 1):
            for tx in range(tx0, tx1 + 1):
                r, c = (ty - ty0) * TILE, (tx - tx0) * TILE
                cells = whole[r : r + TILE, c : c + TILE]
                if cells.any():
                    result[TileKey(ty, tx)] = frozen(cells.copy())
        return result

    @property
    def origin(self) -> tuple[float, float]:
        """x, y in metres of the lower-left corner of the lower-left cell."""
        return self.i0 * self.lattice.cell_mm / 1000, self.j0 * self.lattice.cell_mm / 1000

    @property
    def known_m2(self) -> float:
        """The area in square metres of the cells with non-zero evidence."""
        return int(np.count_nonzero(self.evidence)) * self.lattice.cell_mm**2 / 1e6

    def digest(self) -> bytes:
        """The map digest, the same as that of the tiles this grid was made of."""
        return map_digest(self.tiles())

    def centres(self, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Centres in metres, shape (K, 2), of the cells where ``mask``, shaped like ``evidence``, is set."""
        rows, columns = np.nonzero(mask)
        cells = np.column_stack([columns + self.i0, rows + self.j0]).astype(np.float64)
        return (cells + 0.5) * self.lattice.cell
