"""Beams with a width: the fan they are cut into, and that both kernels draw it as the law says it in plain integers."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.cosine import cosine, sine
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import MAX_RAY_CELLS, Lattice
from mapping.rays import FREE, HIT, SILENT, Rays, fan, rays_of, spread
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import MAX_HALF_WIDTH_TURN16, MAX_WIDTHS_TURN16, Beam, Sensor, orion

MODEL = EvidenceModel()
few = settings(max_examples=60, deadline=None)  # the law is slow, and numba may have to compile

VL53L0X = 2276
"""12.5 degrees: half of the field of view that its data sheet gives."""


def wide(sensor, half_width):
    return Sensor(tuple(beam._replace(half_width_turn16=half_width) for beam in sensor.beams), sensor.max_range_mm)


def scan(ranges, pose=(0, 0, 0)):
    return Scans(np.zeros(1, np.int64), np.array([pose], np.int32), np.array([ranges], np.uint16))


# The law, a second time


def law_of_the_fan(half_width, max_range_mm, cell_mm):
    """Offsets of the rays from the bearing."""
    if half_width == 0:
        return [0]
    largest = (65536 * 113 * cell_mm) // (710 * max_range_mm)
    m = 1
    while m * largest < half_width:
        m += 1
    step = half_width // m
    return [k * step for k in range(-m, m + 1)]


def law_of_a_scan(law, scans, sensor, model, cell_mm):
    """Cells with evidence after scans of wide beams."""
    cells = Counter()
    for pose, ranges in zip(scans.poses.tolist(), scans.ranges.tolist(), strict=True):
        for beam, reading in zip(sensor.beams, ranges, strict=True):
            if reading == INVALID:
                continue
            reach = sensor.max_range_mm if reading == NO_RETURN else reading
            offsets = law_of_the_fan(beam.half_width_turn16, sensor.max_range_mm, cell_mm)
            for offset in offsets:
                thin = (beam.x_mm, beam.y_mm, beam.bearing_turn16 + offset)
                *before, last = law.ray(*law.ends(pose, thin, reach, cell_mm))
                for cell in before:
                    cells[cell] += model.free
                if reading == NO_RETURN:
                    cells[last] += model.free
                elif 2 * abs(offset) <= offsets[-1]:
                    cells[last] += model.occupied
        if model.limit:
            cells = Counter({cell: max(-model.limit, min(model.limit, units)) for cell, units in cells.items()})
    return {cell: units for cell, units in cells.items() if units}


# The fan

half_widths = st.one_of(st.integers(1, MAX_HALF_WIDTH_TURN16), st.integers(1, 20))


@st.composite
def ranges_and_cells(draw):
    cell_mm = draw(st.integers(1, 10_000))
    return draw(st.integers(1, min(65_000, MAX_RAY_CELLS * cell_mm))), cell_mm


@given(half_widths, ranges_and_cells())
def test_neighbouring_rays_are_at_most_one_cell_apart_at_the_maximum_range(half_width, case):
    max_range_mm, cell_mm = case
    _, step = spread(half_width, max_range_mm, cell_mm)
    assert 2 * np.pi * step / 65536 * max_range_mm <= cell_mm


@given(half_widths, ranges_and_cells())
def test_the_fan_fills_the_beam_and_not_more(half_width, case):
    """Less than one unit a ray is lost to rounding: at most 2 % of a cell, as a step is the larger part of a cell."""
    m, step = spread(half_width, *case)
    assert m >= 1
    assert step >= 1
    assert half_width - m < m * step <= half_width


@given(half_widths, ranges_and_cells())
def test_no_fan_has_more_rays_than_it_needs(half_width, case):
    max_range_mm, cell_mm = case
    m, _ = spread(half_width, max_range_mm, cell_mm)
    too_coarse = -(-half_width // max(1, m - 1))
    assert m == 1 or 710 * max_range_mm * too_coarse > 113 * 65536 * cell_mm - 710 * max_range_mm


def test_the_longest_range_leaves_a_step():
    assert spread(MAX_HALF_WIDTH_TURN16, MAX_RAY_CELLS * 15, 15) == (8192, 2)


def test_the_orions_fan_at_two_centimetres():
    """260 units apart would be 19.9 mm at 0.8 m; nine such steps would be a little more than 12.5 degrees."""
    assert spread(VL53L0X, 800, 20) == (9, 252)


def test_a_thin_beam_is_one_ray():
    rays = fan(orion(), Lattice(20))
    assert rays.beam.tolist() == [0, 1, 2, 3, 4]
    assert rays.bearing_turn16.tolist() == [beam.bearing_turn16 for beam in orion().beams]
    assert set(rays.ending.tolist()) == {HIT}


# The rays


def test_only_the_rays_of_the_inner_half_say_what_is_at_their_ends():
    rays = rays_of(scan([500]), Sensor((Beam(0, 0, 0, VL53L0X),), 800), Lattice(20))
    assert rays.ending.tolist() == [SILENT] * 5 + [HIT] * 9 + [SILENT] * 5
    assert (rays.visits == rays.steps + rays.hit).all()


def test_nothing_in_range_frees_the_whole_fan_to_its_end():
    rays = rays_of(scan([NO_RETURN]), Sensor((Beam(0, 0, 0, VL53L0X),), 800), Lattice(20))
    assert rays.ending.tolist() == [FREE] * 19
    assert (rays.visits == rays.steps + 1).all()


def test_an_invalid_reading_of_a_wide_beam_gives_no_ray():
    assert len(rays_of(scan([INVALID]), Sensor((Beam(0, 0, 0, VL53L0X),), 800), Lattice(20))) == 0


@given(st.integers(0, 65535), st.integers(1, 2000), st.integers(1, MAX_HALF_WIDTH_TURN16))
def test_every_cell_of_the_sector_next_to_the_range_is_near_a_ray(yaw, reading, half_width):
    """Any point at the reading's distance within the beam lies within a cell's side of a ray's end."""
    sensor, cell_mm = Sensor((Beam(0, 0, 0, half_width),), 2000), 50
    m, step = spread(half_width, 2000, cell_mm)
    ends = np.arange(-m, m + 1) * step + yaw
    angles = np.linspace(yaw - m * step, yaw + m * step, 50).astype(np.int64)
    points = reading * np.stack([cosine(angles), sine(angles)], -1) / 16384
    rays = reading * np.stack([cosine(ends), sine(ends)], -1) / 16384
    nearest = np.hypot(*(points[:, None] - rays).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() <= cell_mm / 2 + 1
    assert len(rays) == len(rays_of(scan([reading], (0, 0, yaw)), sensor, Lattice(cell_mm)))


# The cells

offsets = st.integers(-60, 60)
widths = st.one_of(st.just(0), st.integers(1, 4000))
beams = st.builds(Beam, offsets, offsets, st.integers(0, 65535), widths)
places = st.sampled_from([(0, 0), (32 * 50, -32 * 50), (-(10**9), 10**9)])


@st.composite
def scans_of_wide_beams(draw):
    sensor = Sensor(tuple(draw(st.lists(beams, min_size=1, max_size=3))), draw(st.integers(1, 1500)))
    x, y = draw(places)
    readings = st.one_of(st.integers(1, sensor.max_range_mm), st.sampled_from([INVALID, NO_RETURN]))
    count = draw(st.integers(0, 3))
    poses = [(x + draw(offsets), y + draw(offsets), draw(st.integers(0, 65535))) for _ in range(count)]
    ranges = [[draw(readings) for _ in sensor.beams] for _ in range(count)]
    scans = Scans(
        np.zeros(count, np.int64),
        np.array(poses, np.int32).reshape(-1, 3),
        np.array(ranges, np.uint16).reshape(-1, len(sensor.beams)),
    )
    return scans, sensor


@given(scans_of_wide_beams(), st.integers(15, 200))
@few
def test_the_cells_are_the_laws(kernel, law, case, cell_mm):
    scans, sensor = case
    tiles = integrated({}, scans, sensor, MODEL, Lattice(cell_mm), kernel)
    assert law.known(tiles) == law_of_a_scan(law, scans, sensor, MODEL, cell_mm)


@given(scans_of_wide_beams(), st.integers(15, 200), st.integers(1, 200))
@few
def test_the_cells_are_the_laws_under_a_limit_too(kernel, law, case, cell_mm, limit):
    scans, sensor = case
    model = EvidenceModel(85, -40, limit)
    tiles = integrated({}, scans, sensor, model, Lattice(cell_mm), kernel)
    assert law.known(tiles) == law_of_a_scan(law, scans, sensor, model, cell_mm)


near = st.tuples(st.integers(-40, 40), st.integers(-40, 40))


@given(st.lists(st.tuples(near, near, st.sampled_from([FREE, HIT, SILENT])), max_size=8))
@few
def test_both_kernels_give_the_same_evidence_for_all_kinds_of_ends(drawn_compiled, rays):
    from mapping.raster import raster_rays

    starts, ends, endings = zip(*rays, strict=True) if rays else ((), (), ())
    several = Rays(
        np.array(starts, np.int64).reshape(-1, 2), np.array(ends, np.int64).reshape(-1, 2), np.array(endings, np.uint8)
    )
    one, other = raster_rays(several, MODEL), drawn_compiled(several, MODEL)
    assert np.array_equal(one.keys, other.keys)
    assert np.array_equal(one.cells, other.cells)


def test_a_silent_end_says_nothing(drawn, law):
    ray = Rays(np.array([[0, 0]]), np.array([[3, 0]]), np.array([SILENT], np.uint8))
    assert law.known(drawn(ray, MODEL)) == {(0, 0): -40, (1, 0): -40, (2, 0): -40}


def test_a_silent_ray_within_one_cell_says_nothing_at_all(drawn):
    ray = Rays(np.array([[40, 0]]), np.array([[40, 0]]), np.array([SILENT], np.uint8))
    assert list(drawn(ray, MODEL)) == []


def test_a_silent_end_touches_no_tile_of_its_own(drawn):
    ray = Rays(np.array([[31, 0]]), np.array([[32, 0]]), np.array([SILENT], np.uint8))
    assert [key for key, _ in drawn(ray, MODEL)] == [(0, 0)]


def test_a_wide_beam_sees_past_the_thin_ray_at_a_corner(kernel, law):
    """Nothing in range: cells beside the axis are known to be free, which a thin ray leaves unknown."""
    thin, broad = (
        law.known(integrated({}, scan([NO_RETURN] * 5), sensor, MODEL, Lattice(20), kernel))
        for sensor in (orion(), wide(orion(), VL53L0X))
    )
    assert thin.keys() < broad.keys()
    assert len(broad) > 3 * len(thin)


# What is refused


@pytest.mark.parametrize("half_width", [-1, MAX_HALF_WIDTH_TURN16 + 1])
def test_a_beam_wider_than_half_a_turn_is_refused(half_width):
    with pytest.raises(ValueError, match="half_width"):
        Sensor((Beam(0, 0, 0, half_width),), 800)


def test_more_than_two_turns_of_view_are_refused():
    half_width = MAX_WIDTHS_TURN16 // 32
    Sensor((Beam(0, 0, 0, half_width),) * 32, 800)
    with pytest.raises(ValueError, match="two turns of view"):
        Sensor((Beam(0, 0, 0, half_width),) * 33, 800)
