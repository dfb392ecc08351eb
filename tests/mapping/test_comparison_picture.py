"""Pictures of differences, looked at cell by cell."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from mapping.comparison_picture import difference_png, judgement_png
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_picture import OKABE_ITO
from mapping.score import judge

BLUE, VERMILLION, GREEN = OKABE_ITO[:3]
_MARGIN = 24


def cells(png: bytes, rows: int, columns: int) -> np.ndarray:
    """The colours of the cells, row 0 south, from the middles of their squares."""
    pixels = np.asarray(Image.open(io.BytesIO(png)))
    width = (pixels.shape[1] - 2 * _MARGIN) // columns
    middles = [_MARGIN + width * k + width // 2 for k in range(max(rows, columns))]
    return pixels[np.ix_(middles[:rows], middles[:columns])][::-1]


def grid(rows: list[list[int]], i0: int = 0, j0: int = 0) -> Grid:
    """A map whose last row given is south."""
    return Grid(np.array(rows[::-1], np.int32), i0, j0, Lattice(100))


def test_only_what_differs_has_a_colour() -> None:
    a = grid([[0, 85, -40], [400, -400, 0]])
    b = grid([[0, 85, 500], [-400, -400, 500]])
    seen = cells(difference_png(a, b), 2, 3)
    assert seen[1, 2].tolist() == list(VERMILLION)
    assert seen[0, 2].tolist() == list(VERMILLION)
    assert seen[0, 0].tolist() == list(BLUE)
    for row, column in ((1, 0), (1, 1), (0, 1)):
        assert np.ptp(seen[row, column]) == 0


def test_a_larger_difference_is_stronger() -> None:
    zero, b = grid([[0, 0, 0]]), grid([[10, 200, 4000]])
    greens = cells(difference_png(zero, b), 1, 3)[0, :, 1].tolist()
    assert greens == sorted(greens, reverse=True)
    assert len(set(greens)) == 3


def test_maps_of_different_extents_are_drawn_whole() -> None:
    seen = cells(difference_png(grid([[500]], -2, -1), grid([[500]], 1, 2)), 4, 4)
    assert seen[0, 0].tolist() == list(BLUE)
    assert seen[3, 3].tolist() == list(VERMILLION)
    assert np.ptp(seen[0, 3]) == 0


def test_the_largest_evidence_that_there_is_can_differ() -> None:
    low, high = grid([[-(2**31)]]), grid([[2**31 - 1]])
    assert cells(difference_png(low, high), 1, 1)[0, 0].tolist() == list(VERMILLION)


def test_what_is_true_false_and_missing() -> None:
    """A wall along the south border of cells 0 to 3 in row 0; the map has two of its cells, and one out of place."""
    found = grid([[0, 0, 0, 0], [0, 0, 85, 0], [0, 0, 0, 0], [85, 85, 0, 0]])
    judgement = judge(found, np.array([[0.05, 0.05, 0.35, 0.05]]), tolerance=0.04)
    seen = cells(judgement_png(found, judgement), 4, 4)
    assert [seen[0, k].tolist() for k in range(4)] == [list(GREEN), list(GREEN), list(BLUE), list(BLUE)]
    assert seen[2, 2].tolist() == list(VERMILLION)
    assert np.ptp(seen[3, 3]) == 0


def test_a_truth_beyond_the_map_is_in_the_picture() -> None:
    judgement = judge(grid([[85]]), np.array([[0.05, 0.05, 0.55, 0.05]]), tolerance=0.04)
    seen = cells(judgement_png(grid([[85]]), judgement), 1, 6)
    assert seen[0, 5].tolist() == list(BLUE)


@pytest.mark.parametrize("truth", [np.zeros((0, 4)), np.array([[0.0, 0.0, 1.0, 0.0]])])
def test_empty_maps_are_pictures_too(truth: np.ndarray) -> None:
    nothing = Grid(np.zeros((0, 0), np.int32), 0, 0, Lattice(100))
    assert difference_png(nothing, nothing).startswith(b"\x89PNG")
    assert judgement_png(nothing, judge(nothing, truth)).startswith(b"\x89PNG")
