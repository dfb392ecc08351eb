"""Both kernels: the cells are the law's, and memory is never more than the scans are worth."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping import raster as module
from mapping.evidence import EvidenceModel
from mapping.lattice import MAX_RAY_CELLS, Lattice
from mapping.rays import Rays
from mapping.scan import Scans
from mapping.sensor import orion
from mapping.tiles import added, map_digest

MODEL = EvidenceModel()
few = settings(max_examples=30, deadline=None)  # the law is slow, and numba may have to compile


def rays_between(*cells):
    """Rays of (start, end, hit)."""
    return Rays(
        np.array([start for start, _, _ in cells], np.int32).reshape(-1, 2),
        np.array([end for _, end, _ in cells], np.int32).reshape(-1, 2),
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

# The cells


@given(rays_in_places)
@few
def test_evidence_is_the_laws(drawn, law, rays):
    expected = {cell: units for cell, units in law.evidence(rays, 85, -40).items() if units}
    assert law.known(drawn(rays_between(*rays), MODEL)) == expected


@given(st.data(), st.integers(0, MAX_RAY_CELLS), st.booleans())
@few
def test_rays_of_any_length_have_the_laws_cells(drawn, law, data, n, hit):
    d = data.draw(st.integers(-n, n))
    start = data.draw(st.tuples(st.integers(-40, 40), st.integers(-40, 40)))
    di, dj = data.draw(st.sampled_from([(n, d), (-n, d), (d, n), (d, -n)]))
    rays = [(start, (start[0] + di, start[1] + dj), hit)]
    assert law.known(drawn(rays_between(*rays), MODEL)) == dict(law.evidence(rays, 85, -40))


@given(rays_in_places, st.integers(1, 10_000), st.integers(-10_000, -1))
@few
def test_both_kernels_give_the_same_evidence(drawn_compiled, rays, occupied, free):
    rays, model = rays_between(*rays), EvidenceModel(occupied, free)
    one, other = module.raster_rays(rays, model), drawn_compiled(rays, model)
    assert np.array_equal(one.keys, other.keys)
    assert np.array_equal(one.cells, other.cells)
    assert (one.keys.dtype, one.cells.dtype) == (other.keys.dtype, other.cells.dtype) == (np.int32, np.int32)


@given(rays_in_places)
@few
def test_tiles_come_once_and_in_order(drawn, rays):
    keys = [key for key, _ in drawn(rays_between(*rays), MODEL)]
    assert keys == sorted(set(keys))


def test_ties_are_rounded_away_from_the_start(drawn, law):
    """From (0, 0) one up at the half-way of two, whichever way: a ray and its reverse are different rays."""
    for i, j in ((2, 1), (2, -1), (-2, 1), (-2, -1)):
        there = law.known(drawn(rays_between(((0, 0), (i, j), True)), MODEL))
        assert there == {(0, 0): -40, (i // 2, j): -40, (i, j): 85}
        back = law.known(drawn(rays_between(((i, j), (0, 0), True)), MODEL))
        assert back == {(i, j): -40, (i // 2, 0): -40, (0, 0): 85}


def test_a_ray_within_one_cell_is_its_end(drawn, law):
    assert law.known(drawn(rays_between(((5, -5), (5, -5), True)), MODEL)) == {(5, -5): 85}
    assert law.known(drawn(rays_between(((5, -5), (5, -5), False)), MODEL)) == {(5, -5): -40}


def test_every_ray_counts_even_the_same_one(drawn, law):
    ray = ((0, 0), (2, 0), True)
    assert law.known(drawn(rays_between(*[ray] * 7), MODEL)) == {(0, 0): -280, (1, 0): -280, (2, 0): 595}


def test_no_rays_are_no_evidence(drawn):
    evidence = drawn(rays_between(), MODEL)
    assert list(evidence) == []
    assert evidence.keys.shape == (0, 2)
    assert evidence.cells.shape == (0, 32, 32)


def test_batches_of_scans_lose_none(kernel, law, monkeypatch):
    """Far more scans than go through the stages together, and not a whole number of batches."""
    monkeypatch.setattr(module, "BATCH", 10)
    chance = np.random.default_rng(3)
    poses = np.column_stack([chance.integers(-2000, 2000, (37, 2)), chance.integers(0, 65536, 37)]).astype(np.int32)
    scans = Scans(np.zeros(37, np.int64), poses, chance.integers(0, 800, (37, 5)).astype(np.uint16))
    assert law.known(kernel(scans, orion(), Lattice(20), MODEL)) == law.map(scans, orion(), MODEL, Lattice(20))


def test_scans_of_another_sensor_are_refused(kernel):
    scans = Scans(np.zeros(1, np.int64), np.zeros((1, 3), np.int32), np.ones((1, 4), np.uint16))
    with pytest.raises(ValueError, match="4 readings"):
        kernel(scans, orion(), Lattice(20), MODEL)


# int32


@pytest.mark.parametrize("sign", [1, -1])
def test_sums_beyond_int32_wrap_around_without_a_word_and_in_any_order(drawn, sign):
    """A cell holds 2^31 / 85 readings; nobody gets there, and whoever does agrees with everybody else."""
    model = EvidenceModel(10_000, -10_000)
    count = 2**31 // 10_000 + 1
    rays = rays_between(*[((3, 3), (3, 3), sign > 0)] * count)
    expected = (sign * 10_000 * count + 2**31) % 2**32 - 2**31
    assert expected * sign < 0
    for cut in (0, 1, count // 2):
        parts = [drawn(rays[cut:], model), drawn(rays[:cut], model)]
        forwards, backwards = {}, {}
        for part in parts:
            forwards |= added(forwards, part)
        for part in reversed(parts):
            backwards |= added(backwards, part)
        assert forwards[0, 0][3, 3] == backwards[0, 0][3, 3] == expected
        assert map_digest(forwards) == map_digest(backwards)


# Boxes


@given(rays_in_places)
@few
def test_every_canvas_is_worth_its_area(several):
    rays, areas = rays_between(*several), []

    def noted(box, count):
        areas.append(box.area)
        return canvases(box, count)

    canvases = module.Box.canvases
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module.Box, "canvases", noted)
        module.raster_rays(rays, MODEL)
    assert all(area <= 2**16 + 64 * int((rays.steps + 1).sum()) for area in areas)


@given(st.integers(0, 4095), st.integers(0, 4095))
@few
def test_no_single_ray_needs_a_large_canvas(drawn, law, di, dj):
    ray = ((31, 31), (31 + di, 31 - dj), True)
    drawn(rays_between(ray), MODEL)  # compiled, if need be
    tracemalloc.start()
    try:
        evidence = drawn(rays_between(ray), MODEL)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 << 20
    assert law.known(evidence) == law.evidence([ray], MODEL.occupied, MODEL.free)


def test_a_robot_that_is_carried_100_km_costs_no_memory(drawn, law):
    """Their common box has 15 thousand million tiles; the few that are touched are all that is held."""
    here, there = ((0, 0), (20, 5), True), ((4_000_000, -4_000_000), (4_000_003, -4_000_020), True)
    rays = rays_between(*([here] * 50 + [there] * 50) * 3)
    assert module.box_of([rays]).area > 10**13
    drawn(rays, MODEL)  # compiled, if need be
    tracemalloc.start()
    try:
        evidence = drawn(rays, MODEL)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 << 20
    assert law.known(evidence) == {
        cell: 150 * units for cell, units in law.evidence([here, there], MODEL.occupied, MODEL.free).items()
    }


def test_scans_that_touch_too_many_tiles_are_refused_before_they_cost_memory(drawn, monkeypatch):
    """A few kilobytes on the wire can name thousands of places far apart."""
    monkeypatch.setattr(module, "MAX_TILES", 99)
    drawn(rays_between(*[((k * 1000, 0), (k * 1000, 1), True) for k in range(99)]), MODEL)
    with pytest.raises(ValueError, match="touch more than 99 tiles"):
        drawn(rays_between(*[((k * 1000, 0), (k * 1000, 1), True) for k in range(100)]), MODEL)


def test_tiles_that_several_chunks_touch_count_once(drawn, monkeypatch, law):
    """Whether an update is refused must not depend on how a drawn cuts it."""
    monkeypatch.setattr(module, "MAX_TILES", 3)
    monkeypatch.setattr(module, "_AREA", 0)
    monkeypatch.setattr(module, "_AREA_A_VISIT", 1)
    rays = [((0, 0), (40, 40), True)] * 20
    evidence = drawn(rays_between(*rays), MODEL)
    assert law.known(evidence) == law.evidence(rays, MODEL.occupied, MODEL.free)
