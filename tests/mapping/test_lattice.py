import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.lattice import MAX_RAY_CELLS, Lattice, TileKey


@given(st.integers(1, 10_000))
def test_a_whole_number_of_millimetres_comes_back_from_metres(cell_mm):
    lattice = Lattice.of(cell_mm / 1000)
    assert lattice == Lattice(cell_mm)
    assert lattice.cell == cell_mm / 1000


@pytest.mark.parametrize("cell_mm", [0, -1, 10_001])
def test_cells_of_no_use_are_refused(cell_mm):
    with pytest.raises(ValueError, match=f"cell: {cell_mm} mm, expected 1 mm to 10 m"):
        Lattice(cell_mm)


@pytest.mark.parametrize("cell", [0.0005, 0.0201, 0.05 + 1e-8])
def test_a_fraction_of_a_millimetre_is_refused(cell):
    with pytest.raises(ValueError, match=f"cell: {re.escape(str(cell))} m is not a whole number of millimetres"):
        Lattice.of(cell)


@pytest.mark.parametrize("cell", [0.0, -0.05, 11.0, math.nan, math.inf, -math.inf])
def test_metres_out_of_range_are_refused(cell):
    with pytest.raises(ValueError, match=f"cell: {cell} m, expected 0.001 to 10 m"):
        Lattice.of(cell)


@given(st.integers(1, 10_000))
def test_the_longest_ray_is_4095_cells(cell_mm):
    lattice = Lattice(cell_mm)
    lattice.check_range(MAX_RAY_CELLS * cell_mm)
    with pytest.raises(ValueError, match=r"is more than 4095 cells"):
        lattice.check_range(MAX_RAY_CELLS * cell_mm + 1)


def test_a_refused_range_names_the_remedy():
    message = "max_range: 20.0 m is more than 4095 cells of 0.004 m; use at most 16.38 m or larger cells"
    with pytest.raises(ValueError, match=re.escape(message)):
        Lattice(4).check_range(20_000)


def test_keys_sort_by_row_and_then_by_column():
    assert sorted([TileKey(1, -5), TileKey(-1, 9), TileKey(1, -6)]) == [(-1, 9), (1, -6), (1, -5)]
