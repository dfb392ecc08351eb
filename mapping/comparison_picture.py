"""Pictures of how a map differs: from another one, or from the truth.

Laws kept here: the top is north; the map itself is pale grey, so that only what is to be seen has a colour; the colours
are ones that the colour-blind can tell apart.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from mapping.evidence import probability
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_picture import OKABE_ITO, Colour, cells_png
from mapping.score import Judgement

_BLUE, _VERMILLION, _GREEN = OKABE_ITO[:3]

_STRONG = 400
"""Units of evidence: a difference of this or more has its colour in full."""

_PALE = 0.45
"""How much of the grey map is left; the rest is white."""


class _Sheet(NamedTuple):
    """A rectangle of cells: cell (i, j) is at row j - j0, column i - i0; row 0 is south."""

    i0: int
    j0: int
    rows: int
    columns: int

    @classmethod
    def around(cls, *corners: tuple[int, int, int, int]) -> Self:
        """What holds all rectangles of i0, j0, i1, j1 (ends excluded); one cell if there is none."""
        table = np.array([each for each in corners if each[0] < each[2] and each[1] < each[3]] or [(0, 0, 1, 1)])
        (i0, j0), (i1, j1) = table[:, :2].min(axis=0).tolist(), table[:, 2:].max(axis=0).tolist()
        return cls(i0, j0, j1 - j0, i1 - i0)

    def spread(self, grid: Grid) -> NDArray[np.int64]:
        """A map's evidence on the sheet, unknown around it."""
        whole = np.zeros((self.rows, self.columns), np.int64)
        rows, columns = grid.evidence.shape
        row, column = grid.j0 - self.j0, grid.i0 - self.i0
        whole[row : row + rows, column : column + columns] = grid.evidence
        return whole

    def cells(self, points: NDArray[np.float64], lattice: Lattice) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Row and column of points in metres, shape (N, 2)."""
        index = np.floor(points * 1000 / lattice.cell_mm + 1e-6).astype(np.intp)  # on a border: the cell beyond
        return index[:, 1] - self.j0, index[:, 0] - self.i0


def difference_png(a: Grid, b: Grid) -> bytes:
    """Where map b has more evidence of something being there than map a, and where of nothing being there.

    Args:
        a: a map.
        b: another one with cells of the same size.
    """
    assert a.lattice == b.lattice
    sheet = _Sheet.around(_corners(a), _corners(b))
    before, after = sheet.spread(a), sheet.spread(b)
    gap = after - before
    colours = _pale(before)
    for colour, strength in ((_VERMILLION, gap), (_BLUE, -gap)):
        share = np.where(strength > 0, 0.4 + 0.6 * np.minimum(strength / _STRONG, 1), 0.0)[..., None]
        colours = (1 - share) * colours + share * np.array(colour)
    return _png(colours, a.lattice, [("more occupied in B", _VERMILLION), ("more free in B", _BLUE)])


def judgement_png(grid: Grid, judgement: Judgement) -> bytes:
    """What of a map's occupied cells is true, what is not, and what of the truth is missing."""
    lattice = grid.lattice
    origin = _Sheet(0, 0, 0, 0)
    rows, columns = origin.cells(np.concatenate([judgement.visible, judgement.occupied]), lattice)
    reach = [(c, r, c + 1, r + 1) for c, r in _extremes(rows, columns)]
    sheet = _Sheet.around(_corners(grid), *reach)
    colours = _pale(sheet.spread(grid))
    for colour, points in (
        (_BLUE, judgement.visible[~judgement.found]),
        (_GREEN, judgement.occupied[judgement.true]),
        (_VERMILLION, judgement.occupied[~judgement.true]),
    ):
        colours[sheet.cells(points, lattice)] = colour
    entries = [("occupied and true", _GREEN), ("occupied and false", _VERMILLION), ("missing", _BLUE)]
    return _png(colours, lattice, entries)


def _corners(grid: Grid) -> tuple[int, int, int, int]:
    rows, columns = grid.evidence.shape
    return grid.i0, grid.j0, grid.i0 + columns, grid.j0 + rows


def _extremes(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> list[tuple[int, int]]:
    """The lower left and the upper right of some cells, as column and row; nothing of none."""
    if not len(rows):
        return []
    return [(int(columns.min()), int(rows.min())), (int(columns.max()), int(rows.max()))]


def _pale(evidence: NDArray[np.int64]) -> NDArray[np.float64]:
    """The map in pale grey, shape (rows, columns, 3)."""
    grey = 255 * (1 - probability(evidence.clip(-(2**31), 2**31 - 1).astype(np.int32)))
    return np.repeat((255 - _PALE * (255 - grey))[..., None], 3, axis=2)


def _png(colours: NDArray[np.float64], lattice: Lattice, entries: list[tuple[str, Colour]]) -> bytes:
    return cells_png(np.rint(colours[::-1]).astype(np.uint8), lattice, entries)
