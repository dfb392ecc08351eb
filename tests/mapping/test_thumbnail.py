"""Maps made small, for a terminal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.thumbnail import FREE, OCCUPIED, UNKNOWN, Thumbnail
from mapping.tiles import frozen

LATTICE = Lattice(50)


def grid(evidence: object, i0: int = 0, j0: int = 0) -> Grid:
    return Grid(frozen(np.array(evidence, np.int32)), i0, j0, LATTICE)


evidences = arrays.arrays(np.int32, st.tuples(st.integers(0, 40), st.integers(0, 40)), elements=st.integers(-3, 3))
sides = st.integers(1, 30)


@given(evidences, sides, sides)
def test_it_fits_and_is_as_large_as_can_be(evidence, rows: int, columns: int) -> None:
    small = Thumbnail.of(grid(evidence), rows, columns)
    assert small.cells.shape[0] <= rows
    assert small.cells.shape[1] <= columns
    factor = round(small.cell / LATTICE.cell)
    assert factor == 1 or -(-max(evidence.shape[0] / rows, evidence.shape[1] / columns) // 1) == factor


@given(evidences, sides, sides, st.integers(-50, 50), st.integers(-50, 50))
def test_every_cell_finds_itself_in_it_and_no_wall_vanishes(
    evidence, rows: int, columns: int, i0: int, j0: int
) -> None:
    whole = grid(evidence, i0, j0)
    small = Thumbnail.of(whole, rows, columns)
    for (row, column), units in np.ndenumerate(evidence):
        place = small.place((i0 + column + 0.5) * LATTICE.cell, (j0 + row + 0.5) * LATTICE.cell)
        assert place is not None
        if units > 0:
            assert small.cells[place] == OCCUPIED
        if units < 0:
            assert small.cells[place] != UNKNOWN
    assert np.count_nonzero(small.cells) <= np.count_nonzero(evidence)


def test_north_is_above_and_the_free_wins_over_the_unknown() -> None:
    small = Thumbnail.of(grid([[5, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, -1], [0, 0, -1, -1]], 10, -20), 2, 2)
    assert small.cells.tolist() == [[UNKNOWN, FREE], [OCCUPIED, UNKNOWN]]
    assert (small.west, small.north, small.cell) == pytest.approx((0.5, -0.8, 0.1))


def test_what_lies_outside_has_no_place() -> None:
    small = Thumbnail.of(grid([[1]]), 4, 4)
    assert small.place(0.01, 0.01) == (0, 0)
    assert [small.place(x, y) for x, y in ((-0.01, 0), (0.06, 0), (0, -0.01), (0, 0.06))] == [None] * 4


def test_an_empty_map_has_no_cells() -> None:
    assert Thumbnail.of(grid(np.zeros((0, 0))), 5, 5).cells.shape == (0, 0)
