"""Canvases: a ray's addresses are an arithmetic progression, exact for every ray that there may be."""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.canvas import FRACTION, Box, box_of, progressions, tiles_of
from mapping.lattice import MAX_RAY_CELLS, TILE
from mapping.rays import FREE, HIT, SILENT, Rays


def rays_to(ends, ending=HIT):
    """Rays from (0, 0)."""
    ends = np.array(ends, np.int64).reshape(-1, 2)
    return Rays(np.zeros_like(ends), ends, np.full(len(ends), ending, np.uint8))


def cells_of(rays):
    """The cells (i, j) of the rays' addresses, in order."""
    box = box_of(rays)
    columns, row, column = box.lines
    first, step, visits = progressions(rays, box)
    k = np.arange(visits.max(initial=0), dtype=np.uint64)[:, None]
    addresses = ((first + k * step) >> np.uint64(FRACTION)).astype(np.int64).T[(k < visits.astype(np.uint64)).T]
    by_column = addresses >= columns
    lines = np.where(by_column, (addresses - columns) // column, addresses // row)
    asides = np.where(by_column, (addresses - columns) % column, addresses % row)
    i, j = np.where(by_column, lines, asides), np.where(by_column, asides, lines)
    return np.stack([i + box.tx * TILE, j + box.ty * TILE], axis=1)


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


def test_every_short_ray_is_exact_to_either_side():
    for n in range(1, 301):
        exact = exact_cells(n, range(n + 1))
        assert np.array_equal(cells_of(rays_to([(n, d) for d in range(n + 1)])), exact), n
        assert np.array_equal(cells_of(rays_to([(n, -d) for d in range(n + 1)])), exact * [1, -1]), n


@pytest.mark.parametrize("n", [1023, 4093, 4094, 4095])
def test_every_slope_of_a_long_ray_is_exact(n):
    """Among them a prime and the longest allowed."""
    for first in range(0, n + 1, 512):
        slopes = range(first, min(first + 512, n + 1))
        assert np.array_equal(cells_of(rays_to([(n, d) for d in slopes])), exact_cells(n, slopes))


def test_rays_of_every_length_are_exact_where_it_is_hardest():
    """Ties, and the least that is possible below a whole number, at every length.

    Below: n odd, k = n - 1, d = (n + 1) / 2 gives k * d / n + 1 / 2 = a whole number - 1 / (2 n).
    """
    for n in range(1, MAX_RAY_CELLS + 1):
        slopes = [0, 1, n // 2, (n + 1) // 2, n - 1, n]
        exact = exact_cells(n, slopes)
        assert np.array_equal(cells_of(rays_to([(n, d) for d in slopes])), exact), n
        assert np.array_equal(cells_of(rays_to([(-d, n) for d in slopes])), exact[:, ::-1] * [-1, 1]), n


def test_the_error_bound_of_the_proof_holds_for_every_length():
    """At its last cell a progression is too large by less than 4096 * 2^-FRACTION, less than 1 / (2 n)."""
    assert Fraction(MAX_RAY_CELLS + 1, 2**FRACTION) < Fraction(1, 2 * MAX_RAY_CELLS)


steps = st.one_of(st.integers(-MAX_RAY_CELLS, MAX_RAY_CELLS), st.integers(-3, 3))


@given(st.lists(st.tuples(steps, steps), min_size=1, max_size=6), st.sampled_from([FREE, HIT, SILENT]))
def test_rays_in_all_directions_are_mirror_images(ends, ending):
    expected = []
    for di, dj in ends:
        n = max(abs(di), abs(dj))
        expected += [
            [exactly(max(n, 1), abs(d), k) * (1 if d > 0 else -1) for d in (di, dj)]
            for k in range(n + (ending != SILENT))
        ]
    assert cells_of(rays_to(ends, ending)).tolist() == expected


@given(st.lists(st.tuples(steps, steps), min_size=1, max_size=6), st.sampled_from([FREE, HIT, SILENT]))
def test_the_compiled_progressions_are_the_same(drawn_compiled, ends, ending):
    from mapping import raster_jit

    rays = rays_to(ends, ending)
    box = box_of(rays)
    columns = np.stack([*rays.start.T, *rays.end.T, rays.ending]).astype(np.int32)
    assert raster_jit._measured(columns) == (*box, sum(max(map(abs, end)) + 1 for end in ends))
    compiled = np.empty((len(rays), 3), np.uint64)
    raster_jit._progressions(columns, compiled, box.ty * TILE, box.tx * TILE, *box.lines)
    first, step, visits = progressions(rays, box)
    assert compiled.tolist() == np.stack([first, step, visits.view(np.uint64)], axis=1).tolist()


@given(st.lists(st.tuples(steps, steps), min_size=1, max_size=4), st.integers(-(10**9), 10**9))
def test_the_box_of_rays_is_the_smallest_of_whole_tiles(ends, place):
    rays = rays_to(ends)
    rays = Rays(rays.start + place, rays.end + place, rays.ending)
    tiles = cells_of(rays) // TILE
    (tx, ty), (tx_last, ty_last) = tiles.min(axis=0).tolist(), tiles.max(axis=0).tolist()
    assert box_of(rays) == Box(ty, tx, ty_last - ty + 1, tx_last - tx + 1)


@given(st.builds(Box, *[st.integers(-9, 9)] * 2, *[st.integers(1, 4)] * 2), st.integers(0, 2**32))
def test_tiles_are_the_sum_of_rows_and_columns(box, seed):
    chance = np.random.default_rng(seed)
    columns, row, column = box.lines
    canvas = box.canvas()
    expected = np.zeros((box.rows * TILE, box.columns * TILE), np.int32)
    for _ in range(8):
        j, i, units = chance.integers(box.rows * TILE), chance.integers(box.columns * TILE), chance.integers(-5, 5)
        canvas[j * row + i if units % 2 else columns + i * column + j] += units
        expected[j, i] += units
    known = np.zeros_like(expected)
    for (ty, tx), cells in tiles_of(canvas, box):
        assert cells.any()
        y, x = (ty - box.ty) * TILE, (tx - box.tx) * TILE
        known[y : y + TILE, x : x + TILE] = cells
    assert np.array_equal(known, expected)
