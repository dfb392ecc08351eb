"""Strokes: the closed form is exact in int32 for every ray that there may be, as NumPy and as numba make them."""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.lattice import MAX_RAY_CELLS
from mapping.rays import FREE, HIT, SILENT, Rays
from mapping.strokes import LENGTH, SHIFT, STROKE, Box, box_of, strokes_of


def rays_to(ends, ending=HIT):
    """Rays from (0, 0)."""
    ends = np.array(ends, np.int64).reshape(-1, 2)
    return Rays(np.zeros_like(ends), ends, np.full(len(ends), ending, np.uint8))


def cells_of(strokes):
    """The cells (i, j) that strokes visit, in order: the kernels' expression, in their int32."""
    k = np.arange(LENGTH, dtype=np.int32)
    aside = (strokes["intercept"][:, None] + k * strokes["slope"][:, None]) >> SHIFT
    assert aside.dtype == np.int32
    i = strokes["i"][:, None] + k * strokes["major_i"][:, None] + aside * strokes["minor_i"][:, None]
    j = strokes["j"][:, None] + k * strokes["major_j"][:, None] + aside * strokes["minor_j"][:, None]
    visited = k < strokes["visits"][:, None]
    return np.stack([i[visited], j[visited]], axis=1)


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


def test_every_short_ray_is_exact():
    for n in range(1, 301):
        strokes = strokes_of(rays_to([(n, d) for d in range(n + 1)]))
        assert np.array_equal(cells_of(strokes), exact_cells(n, range(n + 1))), n


@pytest.mark.parametrize("n", [1023, 4093, 4094, 4095])
def test_every_slope_of_a_long_ray_is_exact(n):
    """Among them a prime and the longest allowed."""
    for first in range(0, n + 1, 512):
        slopes = range(first, min(first + 512, n + 1))
        assert np.array_equal(cells_of(strokes_of(rays_to([(n, d) for d in slopes]))), exact_cells(n, slopes))


def test_rays_of_every_length_are_exact_where_it_is_hardest():
    """Ties, and the least that is possible below a whole number, at every length.

    Below: n odd, k = n - 1, d = (n + 1) / 2 gives k * d / n + 1 / 2 = a whole number - 1 / (2 n).
    """
    for n in range(1, MAX_RAY_CELLS + 1):
        slopes = [0, 1, n // 2, (n + 1) // 2, n - 1, n]
        assert np.array_equal(cells_of(strokes_of(rays_to([(n, d) for d in slopes]))), exact_cells(n, slopes)), n


def test_the_error_bound_of_the_proof_holds_for_every_length():
    """At its last cell a stroke is too large by less than 256 * 2^-SHIFT, which must stay below 1 / (2 n)."""
    assert Fraction(LENGTH, 2**SHIFT) < Fraction(1, 2 * MAX_RAY_CELLS)
    assert (LENGTH + 1) * 2**SHIFT < 2**31


steps = st.one_of(
    st.integers(-MAX_RAY_CELLS, MAX_RAY_CELLS), st.integers(-3, 3), st.sampled_from([-256, 255, 256, 512])
)


@given(st.lists(st.tuples(steps, steps), max_size=6), st.sampled_from([FREE, HIT, SILENT]))
def test_rays_in_all_directions_are_mirror_images(ends, ending):
    rays = rays_to(ends, ending)
    expected = []
    for di, dj in ends:
        n = max(abs(di), abs(dj))
        for k in range(n + (ending != SILENT)):
            i, j = (exactly(max(n, 1), abs(d), k) * (1 if d > 0 else -1) for d in (di, dj))
            expected.append([i, j])
    strokes = strokes_of(rays)
    assert cells_of(strokes).tolist() == expected
    assert strokes["hit"].sum() == (len(ends) if ending == HIT else 0)
    assert all(1 <= visits <= LENGTH for visits in strokes["visits"].tolist())


@given(st.lists(st.tuples(steps, steps), max_size=6), st.sampled_from([FREE, HIT, SILENT]))
def test_the_compiled_strokes_are_the_same(drawn_compiled, ends, ending):
    from mapping import raster_jit

    rays = rays_to(ends, ending)
    compiled = raster_jit._of_rays(rays.start, rays.end, rays.ending.astype(np.int64))
    strokes = strokes_of(rays)
    assert compiled.dtype == strokes.dtype == STROKE
    assert compiled.tolist() == strokes.tolist()
    if len(strokes):
        assert raster_jit._box_of(compiled) == box_of(strokes)


@given(st.lists(st.tuples(steps, steps), min_size=1, max_size=4), st.integers(-(10**9), 10**9))
def test_the_box_of_strokes_is_the_smallest_of_whole_tiles(ends, place):
    rays = rays_to(ends)
    strokes = strokes_of(Rays(rays.start + place, rays.end + place, rays.ending))
    tiles = cells_of(strokes) // 32
    (tx, ty), (tx_last, ty_last) = tiles.min(axis=0).tolist(), tiles.max(axis=0).tolist()
    assert box_of(strokes) == Box(ty, tx, ty_last - ty + 1, tx_last - tx + 1)


@given(st.lists(st.builds(Box, *[st.integers(-9, 9)] * 2, *[st.integers(1, 9)] * 2), min_size=1, max_size=4))
def test_a_box_around_boxes_has_their_tiles_and_is_the_smallest(boxes):
    whole = Box.around(boxes)
    assert (whole.ty, whole.tx) == (min(box.ty for box in boxes), min(box.tx for box in boxes))
    assert whole.ty + whole.rows == max(box.ty + box.rows for box in boxes)
    assert whole.tx + whole.columns == max(box.tx + box.columns for box in boxes)
