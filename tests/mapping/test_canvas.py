"""Boxes of whole tiles, and the tiles of their cells."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapping.canvas import Box
from mapping.lattice import TILE

boxes = st.builds(Box, *[st.integers(-9, 9)] * 2, *[st.integers(1, 4)] * 2)
near = st.integers(-(10**9), 10**9)


@given(near, near, st.integers(0, 200), st.integers(0, 200))
def test_a_box_around_cells_is_the_smallest_of_whole_tiles(j, i, height, width):
    box = Box.around(j, i, j + height, i + width)
    for low, count, first, last in ((box.ty, box.rows, j, j + height), (box.tx, box.columns, i, i + width)):
        assert low * TILE <= first < (low + 1) * TILE
        assert (low + count - 1) * TILE <= last < (low + count) * TILE


@given(boxes)
def test_a_canvas_has_every_cell_twice_and_one_behind_each_line(box):
    (canvas,) = box.canvases(1)
    rows, columns = box.halves(canvas)
    assert rows.size + columns.size == canvas.size
    assert (len(rows), len(columns)) == (box.rows * TILE, box.columns * TILE)
    assert rows.shape[1] > len(columns)
    assert columns.shape[1] > len(rows)
    begin, row, column = box.lines
    canvas[3 * row + 5], canvas[begin + 7 * column + 9] = 1, 2
    assert (rows[3, 5], columns[7, 9]) == (1, 2)


@given(boxes, st.integers(0, 2**32))
def test_tiles_are_those_with_evidence(box, seed):
    chance = np.random.default_rng(seed)
    cells = np.zeros((box.rows * TILE, box.columns * TILE), np.int32)
    for _ in range(4):
        cells[chance.integers(len(cells)), chance.integers(cells.shape[1])] += chance.integers(-5, 5)
    known = np.zeros_like(cells)
    for (ty, tx), tile in box.tiles(cells):
        assert tile.any()
        y, x = (ty - box.ty) * TILE, (tx - box.tx) * TILE
        known[y : y + TILE, x : x + TILE] = tile
    assert np.array_equal(known, cells)
