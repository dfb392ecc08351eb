"""The compiled kernel: a ray's cells are an arithmetic progression, exact for every ray that there may be."""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.canvas import FRACTION, Box
from mapping.lattice import MAX_RAY_CELLS, TILE
from mapping.rays import FREE, HIT, SILENT


@pytest.fixture(scope="module")
def cells_of(compiled):
    """The cells (i, j) of rays from (0, 0), in order; and their box."""
    from mapping import raster_jit

    def cells_of(ends, ending=HIT):
        ends = np.array(ends, np.int32).reshape(-1, 2)
        rays = np.stack([*np.zeros_like(ends).T, *ends.T, np.full(len(ends), ending)])
        *box, most = raster_jit._measured(rays)
        assert most == (np.abs(ends).max(axis=1) + 1).sum()
        box = Box(*box)
        columns, row, column = box.lines
        progressions = np.empty((len(ends), 3), np.uint64)
        raster_jit._progressions(rays, progressions, box.ty * TILE, box.tx * TILE, *box.lines)
        first, step, visits = progressions.T
        k = np.arange(visits.max(initial=0), dtype=np.uint64)[:, None]
        addresses = ((first + k * step) >> np.uint64(FRACTION)).astype(np.int64).T[(k < visits).T]
        by_column = addresses >= columns
        lines = np.where(by_column, (addresses - columns) // column, addresses // row)
        asides = np.where(by_column, (addresses - columns) % column, addresses % row)
        i, j = np.where(by_column, lines, asides), np.where(by_column, asides, lines)
        return np.stack([i + box.tx * TILE, j + box.ty * TILE], axis=1), box

    return cells_of


def exactly(n, d, k):
    """k * d / n rounded, halves up: floor(k * d / n + 1 / 2) in integers."""
    return (2 * k * d + n) // (2 * n)


def exact_cells(n, slopes):
    """The cells of the rays from (0, 0) to (n, d), one d after the other."""
    d, k = np.array(slopes)[:, None], np.arange(n + 1)
    return np.stack([np.broadcast_to(k, (len(slopes), n + 1)).ravel(), exactly(n, d, k).ravel()], axis=1)


@given(st.data(), st.integers(1, MAX_RAY_CELLS))
def test_the_integer_form_of_the_exact_value_is_the_fraction(data, n):
    d, k = data.draw(st.integers(0, n)), data.draw(st.integers(0, n))
    assert exactly(n, d, k) == floor(Fraction(k * d, n) + Fraction(1, 2))


def test_every_short_ray_is_exact_to_either_side(cells_of):
    for n in range(1, 301):
        exact = exact_cells(n, range(n + 1))
        assert np.array_equal(cells_of([(n, d) for d in range(n + 1)])[0], exact), n
        assert np.array_equal(cells_of([(n, -d) for d in range(n + 1)])[0], exact * [1, -1]), n


@pytest.mark.parametrize("n", [1023, 4093, 4094, 4095])
def test_every_slope_of_a_long_ray_is_exact(cells_of, n):
    """Among them a prime and the longest allowed."""
    for first in range(0, n + 1, 512):
        slopes = range(first, min(first + 512, n + 1))
        assert np.array_equal(cells_of([(n, d) for d in slopes])[0], exact_cells(n, slopes))


def test_rays_of_every_length_are_exact_where_it_is_hardest(cells_of):
    """Ties, and the least that is possible below a whole number, at every length.

    Below: n odd, k = n - 1, d = (n + 1) / 2 gives k * d / n + 1 / 2 = a whole number - 1 / (2 n).
    """
    for n in range(1, MAX_RAY_CELLS + 1):
        slopes = [0, 1, n // 2, (n + 1) // 2, n - 1, n]
        exact = exact_cells(n, slopes)
        assert np.array_equal(cells_of([(n, d) for d in slopes])[0], exact), n
        assert np.array_equal(cells_of([(-d, n) for d in slopes])[0], exact[:, ::-1] * [-1, 1]), n


def test_the_error_bound_of_the_proof_holds_for_every_length():
    """At its last cell a progression is too large by less than 4096 * 2^-FRACTION, less than 1 / (2 n)."""
    assert Fraction(MAX_RAY_CELLS + 1, 2**FRACTION) < Fraction(1, 2 * MAX_RAY_CELLS)


steps = st.one_of(st.integers(-MAX_RAY_CELLS, MAX_RAY_CELLS), st.integers(-3, 3))


@given(st.lists(st.tuples(steps, steps), min_size=1, max_size=6), st.sampled_from([FREE, HIT, SILENT]))
def test_rays_in_all_directions_are_mirror_images(cells_of, ends, ending):
    expected = []
    for di, dj in ends:
        n = max(abs(di), abs(dj))
        expected += [
            [exactly(max(n, 1), abs(d), k) * (1 if d > 0 else -1) for d in (di, dj)]
            for k in range(n + (ending != SILENT))
        ]
    assert cells_of(ends, ending)[0].tolist() == expected


@given(st.lists(st.tuples(steps, steps), min_size=1, max_size=4))
def test_the_box_of_rays_is_the_smallest_of_whole_tiles(cells_of, ends):
    cells, box = cells_of(ends)
    (low_i, low_j), (high_i, high_j) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    assert box == Box.around(low_j, low_i, high_j, high_i)
