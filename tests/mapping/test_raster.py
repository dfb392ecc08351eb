"""Both kernels: the closed form is exact, the cells are the law's, and a chunk is never larger than it must be."""

import tracemalloc
from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping import raster as module
from mapping.evidence import EvidenceModel
from mapping.lattice import MAX_RAY_CELLS
from mapping.raster import SHIFT, slopes, split, tile_box
from mapping.rays import Rays
from mapping.tiles import added, map_digest

MODEL = EvidenceModel()
few = settings(max_examples=30, deadline=None)  # the law is slow, and numba may have to compile


def rays_between(*cells):
    """Rays of (start, end, hit)."""
    return Rays(
        np.array([start for start, _, _ in cells], np.int64).reshape(-1, 2),
        np.array([end for _, end, _ in cells], np.int64).reshape(-1, 2),
        np.array([hit for _, _, hit in cells], np.bool_),
    )


near = st.tuples(st.integers(-70, 70), st.integers(-70, 70))
steps = st.one_of(near, st.tuples(st.integers(-2, 2), st.integers(-2, 2)))


@st.composite
def rays_somewhere(draw):
    """(start, end, hit) around a few places, tile borders and far ones among them."""
    place = draw(st.sampled_from([(0, 0), (32, -32), (-(10**9), 10**9), (31_250_000, -31)]))
    rays = []
    for (i, j), (di, dj), hit in draw(st.lists(st.tuples(near, steps, st.booleans()), max_size=8)):
        start = (place[0] + i, place[1] + j)
        rays.append((start, (start[0] + di, start[1] + dj), hit))
    return rays


rays_in_places = st.lists(rays_somewhere(), max_size=3).map(lambda several: [ray for rays in several for ray in rays])

# The closed form


def minor(n, d, k):
    """The kernels' fixed-point expression, on arrays."""
    f = -((-d << SHIFT) // n)
    return (k * f + (1 << SHIFT - 1)) >> SHIFT


def exactly(n, d, k):
    """k * d / n rounded, halves up: floor(k * d / n + 1 / 2) in integers."""
    return (2 * k * d + n) // (2 * n)


@given(st.data(), st.integers(1, MAX_RAY_CELLS + 1))
def test_the_integer_form_of_the_exact_value_is_the_fraction(data, n):
    d, k = data.draw(st.integers(0, n)), data.draw(st.integers(0, n))
    assert exactly(n, d, k) == floor(Fraction(k * d, n) + Fraction(1, 2))


@given(st.data(), st.integers(1, MAX_RAY_CELLS))
def test_the_slopes_are_those_of_the_proof(data, n):
    d = data.draw(st.integers(-n, n))
    for end in ((n, d), (-n, d), (d, n), (d, -n)):
        steps, f, sign = slopes(rays_between(((0, 0), end, True)))
        assert steps.tolist() == [n]
        assert f.tolist() == [[-((-abs(side) << SHIFT) // n) for side in end]]
        assert sign.tolist() == [[(side > 0) - (side < 0) for side in end]]


def test_the_closed_form_is_exact_for_all_short_rays():
    for n in range(1, 301):
        d, k = np.ogrid[0 : n + 1, 0 : n + 1]
        assert np.array_equal(minor(n, d, k), exactly(n, d, k)), n


@pytest.mark.parametrize("n", [4093, 4095, 4096])
def test_the_closed_form_is_exact_for_the_longest_rays(n):
    """Every slope and step of three of them: a prime, the longest allowed, and the power of two above."""
    k = np.arange(n + 1)
    for first in range(0, n + 1, 512):
        d = np.arange(first, min(first + 512, n + 1))[:, None]
        assert np.array_equal(minor(n, d, k), exactly(n, d, k))


def test_the_closed_form_is_exact_where_it_is_hardest():
    """Every length's hardest steps: k * d / n a half (a tie), and the least that is possible below a half.

    Below: n odd, k = n - 1, d = (n + 1) / 2 gives k * d / n + 1 / 2 = a whole number - 1 / (2 n).
    """
    odd = np.arange(1, MAX_RAY_CELLS + 2, 2)
    d, k = (odd + 1) // 2, odd - 1
    assert ((2 * k * d + odd) % (2 * odd) == 2 * odd - 1).all()
    assert np.array_equal(minor(odd, d, k), exactly(odd, d, k))
    even = np.arange(2, MAX_RAY_CELLS + 2, 2)
    for k in (even // 2, even - 1):
        for d in (np.ones_like(even), even // 2, even - 1):
            assert np.array_equal(minor(even, d, k), exactly(even, d, k))


def test_the_closed_form_is_exact_on_a_million_samples():
    random = np.random.default_rng(1)
    n = random.integers(1, MAX_RAY_CELLS + 2, 1_000_000)
    d, k = random.integers(0, n + 1), random.integers(0, n + 1)
    assert np.array_equal(minor(n, d, k), exactly(n, d, k))


def test_the_error_bound_of_the_proof_holds_for_every_length():
    """The slope is too large by less than 2^-SHIFT, so k times it is less than 1 / (2 n) too large."""
    longest = MAX_RAY_CELLS + 1
    assert Fraction(longest, 2**SHIFT) < Fraction(1, 2 * longest)


# The cells


@given(rays_in_places)
@few
def test_evidence_is_the_laws(kernel, law, rays):
    expected = {cell: units for cell, units in law.evidence(rays, 85, -40).items() if units}
    assert law.known(kernel(rays_between(*rays), MODEL)) == expected


@given(st.data(), st.integers(0, MAX_RAY_CELLS), st.booleans())
@few
def test_rays_of_any_length_have_the_laws_cells(kernel, law, data, n, hit):
    d = data.draw(st.integers(-n, n))
    start = data.draw(st.tuples(st.integers(-40, 40), st.integers(-40, 40)))
    di, dj = data.draw(st.sampled_from([(n, d), (-n, d), (d, n), (d, -n)]))
    rays = [(start, (start[0] + di, start[1] + dj), hit)]
    assert law.known(kernel(rays_between(*rays), MODEL)) == dict(law.evidence(rays, 85, -40))


@given(rays_in_places, st.integers(1, 10_000), st.integers(-10_000, -1))
@few
def test_both_kernels_give_the_same_evidence(compiled, rays, occupied, free):
    rays, model = rays_between(*rays), EvidenceModel(occupied, free)
    one, other = module.raster(rays, model), compiled(rays, model)
    assert np.array_equal(one.keys, other.keys)
    assert np.array_equal(one.cells, other.cells)
    assert (one.keys.dtype, one.cells.dtype) == (other.keys.dtype, other.cells.dtype) == (np.int32, np.int32)


@given(rays_in_places)
@few
def test_tiles_come_once_and_in_order(kernel, rays):
    keys = [key for key, _ in kernel(rays_between(*rays), MODEL)]
    assert keys == sorted(set(keys))


def test_ties_are_rounded_away_from_the_start(kernel, law):
    """From (0, 0) one up at the half-way of two, whichever way: a ray and its reverse are different rays."""
    for i, j in ((2, 1), (2, -1), (-2, 1), (-2, -1)):
        there = law.known(kernel(rays_between(((0, 0), (i, j), True)), MODEL))
        assert there == {(0, 0): -40, (i // 2, j): -40, (i, j): 85}
        back = law.known(kernel(rays_between(((i, j), (0, 0), True)), MODEL))
        assert back == {(i, j): -40, (i // 2, 0): -40, (0, 0): 85}


def test_a_ray_within_one_cell_is_its_end(kernel, law):
    assert law.known(kernel(rays_between(((5, -5), (5, -5), True)), MODEL)) == {(5, -5): 85}
    assert law.known(kernel(rays_between(((5, -5), (5, -5), False)), MODEL)) == {(5, -5): -40}


def test_every_ray_counts_even_the_same_one(kernel, law):
    ray = ((0, 0), (2, 0), True)
    assert law.known(kernel(rays_between(*[ray] * 7), MODEL)) == {(0, 0): -280, (1, 0): -280, (2, 0): 595}


def test_no_rays_are_no_evidence(kernel):
    evidence = kernel(rays_between(), MODEL)
    assert list(evidence) == []
    assert evidence.keys.shape == (0, 2)
    assert evidence.cells.shape == (0, 32, 32)


def test_large_batches_are_cut_into_chunks_of_cells_without_loss(monkeypatch, law):
    """Chunks of at most ten cells; a single ray may be longer."""
    rays = [((0, 0), (k % 13, -k % 7), k % 3 > 0) for k in range(100)]
    whole = module.raster(rays_between(*rays), MODEL)
    sizes = []
    chunk = module._raster_chunk

    def watched(rays, model):
        sizes.append((len(rays), int((rays.steps + 1).sum())))
        return chunk(rays, model)

    monkeypatch.setattr(module, "_CHUNK_CELLS", 10)
    monkeypatch.setattr(module, "_raster_chunk", watched)
    assert law.known(module.raster(rays_between(*rays), MODEL)) == law.known(whole)
    assert sum(count for count, _ in sizes) == 100
    assert all(count == 1 or cells <= 10 for count, cells in sizes)
    assert max(cells for _, cells in sizes) == 13


# int32


@pytest.mark.parametrize("sign", [1, -1])
def test_sums_beyond_int32_wrap_around_without_a_word_and_in_any_order(kernel, sign):
    """A cell holds 2^31 / 85 readings; nobody gets there, and whoever does agrees with everybody else."""
    model = EvidenceModel(10_000, -10_000)
    count = 2**31 // 10_000 + 1
    rays = rays_between(*[((3, 3), (3, 3), sign > 0)] * count)
    expected = (sign * 10_000 * count + 2**31) % 2**32 - 2**31
    assert expected * sign < 0
    for cut in (0, 1, count // 2):
        parts = [kernel(rays[cut:], model), kernel(rays[:cut], model)]
        forwards, backwards = {}, {}
        for part in parts:
            forwards |= added(forwards, part)
        for part in reversed(parts):
            backwards |= added(backwards, part)
        assert forwards[0, 0][3, 3] == backwards[0, 0][3, 3] == expected
        assert map_digest(forwards) == map_digest(backwards)


# Chunks of tiles


@given(rays_somewhere().filter(len))
@few
def test_the_box_of_tiles_is_the_smallest_around_the_rays(law, rays):
    cells = [cell for start, end, _ in rays for cell in law.ray(start, end)]
    rows, columns = [j // 32 for _, j in cells], [i // 32 for i, _ in cells]
    height, width = max(rows) - min(rows) + 1, max(columns) - min(columns) + 1
    assert tile_box(rays_between(*rays)) == (min(rows), min(columns), height, width)


@given(rays_in_places, st.integers(1, 50))
@few
def test_splitting_keeps_every_ray_in_order_and_every_box_small(several, most_tiles):
    rays = rays_between(*several)
    parts = split(rays, most_tiles)
    for name in ("start", "end", "hit"):
        joined = [row for part in parts for row in getattr(part, name).tolist()]
        assert joined == getattr(rays, name).tolist()
    for part in parts:
        _, _, rows, columns = tile_box(part)
        assert len(part) == 1 or rows * columns <= most_tiles


def test_a_robot_that_is_carried_100_km_costs_no_memory(kernel, law):
    """Their common box has 15 thousand million tiles; the few that are touched are all that is held."""
    here, there = ((0, 0), (20, 5), True), ((4_000_000, -4_000_000), (4_000_003, -4_000_020), True)
    rays = rays_between(*([here] * 50 + [there] * 50) * 3)
    _, _, rows, columns = tile_box(rays)
    assert rows * columns > 10**10
    kernel(rays, MODEL)  # compiled, if need be
    tracemalloc.start()
    try:
        evidence = kernel(rays, MODEL)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 << 20
    assert len(split(rays)) <= 32
    assert law.known(evidence) == {
        cell: 150 * units for cell, units in law.evidence([here, there], MODEL.occupied, MODEL.free).items()
    }


def test_scans_that_touch_too_many_tiles_are_refused_before_they_cost_memory(kernel, monkeypatch):
    """A few kilobytes on the wire can name thousands of places far apart."""
    monkeypatch.setattr(module, "MAX_TILES", 99)
    kernel(rays_between(*[((k * 1000, 0), (k * 1000, 1), True) for k in range(99)]), MODEL)
    with pytest.raises(ValueError, match="touch more than 99 tiles"):
        kernel(rays_between(*[((k * 1000, 0), (k * 1000, 1), True) for k in range(100)]), MODEL)


def test_tiles_that_several_chunks_touch_count_once(kernel, monkeypatch, law):
    """Whether an update is refused must not depend on how a kernel cuts it."""
    monkeypatch.setattr(module, "MAX_TILES", 3)
    monkeypatch.setattr(module, "_CHUNK_CELLS", 10)
    rays = [((0, 0), (40, 40), True)] * 20
    evidence = kernel(rays_between(*rays), MODEL)
    assert law.known(evidence) == law.evidence(rays, MODEL.occupied, MODEL.free)
