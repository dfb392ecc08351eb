"""Scans into maps: both kernels against the law in plain integers, and the sum over robots against the single grid."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping import raster
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import TILE, Lattice
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Beam, Sensor
from mapping.tiles import map_digest, summed

INTEL = "carmen/intel-corrected.log.gz"
DRONES = "nano_swarm/exp2_two-drones"
few = settings(max_examples=25, deadline=None)  # the law is slow, and numba may have to compile
LONGEST = 90  # cells of a ray: enough for four tiles, few enough for the slow law

models = st.builds(EvidenceModel, st.integers(1, 200), st.integers(-200, -1))
limited = st.builds(EvidenceModel, st.integers(1, 200), st.integers(-200, -1), st.integers(1, 400))


@st.composite
def cases(draw):
    """A lattice, a sensor, and scans at tile borders, around the origin, and 1000 km away."""
    cell_mm = draw(st.sampled_from([1, 7, 20, 50, 333, 10_000]))
    max_range_mm = draw(st.integers(1, min(65_000, LONGEST * cell_mm)))
    origin = st.one_of(st.integers(-60, 60), st.sampled_from([-32_767, 32_767]))
    beam = st.builds(
        Beam, origin, origin, st.one_of(st.integers(0, 65_535), st.sampled_from([0, 8192, 49_152])), st.just(0)
    )
    sensor = Sensor(tuple(draw(st.lists(beam, min_size=1, max_size=5))), max_range_mm)

    side = TILE * cell_mm
    border = st.builds(lambda tile, off: tile * side + off, st.integers(-2, 2), st.integers(-1, 1))
    far = st.sampled_from([-(10**9), 10**9])
    coordinate = st.one_of(border, st.integers(-side, side), far)
    yaw = st.one_of(st.integers(0, 65_535), st.sampled_from([0, 16_384, 32_768, 49_152]))
    reading = st.one_of(st.integers(1, max_range_mm), st.sampled_from([INVALID, NO_RETURN, 1, max_range_mm]))
    readings = st.tuples(*[reading] * len(sensor.beams))
    rows = draw(st.lists(st.tuples(coordinate, coordinate, yaw, readings), max_size=5))
    scans = Scans(
        np.arange(len(rows), dtype=np.int64),
        np.array([row[:3] for row in rows], np.int32).reshape(-1, 3),
        np.array([row[3] for row in rows], np.uint16).reshape(-1, len(sensor.beams)),
    )
    return scans, sensor, Lattice(cell_mm)


def in_batches(scans, cuts):
    """The scans between one cut and the next."""
    bounds = [0, *sorted(cuts), len(scans)]
    return [scans[first:last] for first, last in pairwise(bounds)]


def mapped(batches, sensor, model, lattice, kernel):
    """A session's map after some batches."""
    tiles = {}
    for scans in batches:
        tiles.update(integrated(tiles, scans, sensor, model, lattice, kernel))
    return tiles


def in_order(scans, order):
    """The scans in another order."""
    return Scans(scans.stamps_ms[order], scans.poses[order], scans.ranges[order])


# The law


@given(cases(), st.one_of(models, limited))
@few
def test_a_map_is_what_the_law_says(kernel, law, case, model):
    scans, sensor, lattice = case
    assert law.known(integrated({}, scans, sensor, model, lattice, kernel)) == law.map(scans, sensor, model, lattice)


@given(cases(), st.one_of(models, limited), st.data())
@few
def test_a_map_grows_by_what_the_law_says(kernel, law, case, model, data):
    scans, sensor, lattice = case
    cut = data.draw(st.integers(0, len(scans)))
    before = mapped([scans[:cut]], sensor, model, lattice, kernel)
    after = {**before, **integrated(before, scans[cut:], sensor, model, lattice, kernel)}
    known = law.map(scans[:cut], sensor, model, lattice)
    assert law.known(after) == law.map(scans[cut:], sensor, model, lattice, before=known)


@given(cases(), st.one_of(models, limited), st.data())
@few
def test_batches_of_any_size_make_the_same_map(kernel, case, model, data):
    scans, sensor, lattice = case
    cuts = data.draw(st.lists(st.integers(0, len(scans)), max_size=4))
    whole = mapped([scans], sensor, model, lattice, kernel)
    assert map_digest(mapped(in_batches(scans, cuts), sensor, model, lattice, kernel)) == map_digest(whole)


@given(cases(), limited)
@few
def test_a_limit_holds_after_every_scan(kernel, law, case, model):
    scans, sensor, lattice = case
    tiles = {}
    for row in range(len(scans)):
        tiles.update(integrated(tiles, scans[row : row + 1], sensor, model, lattice, kernel))
        assert all(abs(units) <= model.limit for units in law.known(tiles).values())


@given(cases(), st.one_of(models, limited))
@few
def test_the_map_before_is_left_alone(kernel, case, model):
    scans, sensor, lattice = case
    before = mapped([scans], sensor, model, lattice, kernel)
    keys, digest = list(before), map_digest(before)
    after = integrated(before, scans, sensor, model, lattice, kernel)
    assert (list(before), map_digest(before)) == (keys, digest)
    assert not any(tile.flags.writeable for tile in after.values())


@given(st.one_of(models, limited))
@few
def test_no_scans_change_nothing(kernel, model):
    assert integrated({}, Scans.empty(1), Sensor((Beam(0, 0, 0),), 800), model, Lattice(20), kernel) == {}


def test_without_a_word_the_kernel_is_numpys():
    assert integrated.__defaults__ == (raster.raster,)


# The sum over robots is the single grid


@given(cases(), models, st.data())
@few
def test_the_sum_over_robots_is_the_single_grid(kernel, case, model, data):
    """Whoever sensed a scan, in whatever order, in batches of whatever size: one map."""
    scans, sensor, lattice = case
    single = mapped([scans], sensor, model, lattice, kernel)
    shuffled = in_order(scans, np.array(data.draw(st.permutations(range(len(scans)))), np.int64))
    robots = data.draw(st.lists(st.integers(0, len(scans)), max_size=3))
    maps = []
    for own in in_batches(shuffled, robots):
        cuts = data.draw(st.lists(st.integers(0, len(own)), max_size=3))
        maps.append(mapped(in_batches(own, cuts), sensor, model, lattice, kernel))
    assert map_digest(summed(maps)) == map_digest(single)
    assert map_digest(summed(maps[::-1])) == map_digest(single)


def test_a_limit_is_each_robots_own_and_not_the_sums(kernel, law):
    """Two robots that are both sure are surer together: the limit is never applied to a sum."""
    wall = Scans(np.zeros(9, np.int64), np.zeros((9, 3), np.int32), np.full((9, 1), 100, np.uint16))
    model = EvidenceModel(limit=200)
    one = mapped([wall], Sensor((Beam(0, 0, 0),), 800), model, Lattice(50), kernel)
    assert law.known(one) == {(0, 0): -200, (1, 0): -200, (2, 0): 200}
    assert law.known(summed([one, one])) == {(0, 0): -400, (1, 0): -400, (2, 0): 400}


# Real runs


@pytest.mark.recordings
@pytest.mark.parametrize("limit", [0, 300])
def test_a_slice_of_the_intel_log_is_mapped_by_the_law(kernel, law, recorded, limit):
    ((scans, sensor),) = recorded(INTEL)
    some, model, lattice = in_order(scans, np.arange(7, len(scans), 75)), EvidenceModel(limit=limit), Lattice(100)
    got = integrated({}, some, sensor, model, lattice, kernel)
    assert law.known(got) == law.map(some, sensor, model, lattice)


@pytest.mark.recordings
@pytest.mark.parametrize("limit", [0, 300])
def test_the_drones_log_is_mapped_by_the_law(kernel, law, recorded, limit):
    model, lattice = EvidenceModel(limit=limit), Lattice(50)
    for scans, sensor in recorded(DRONES):
        got = integrated({}, scans[:100], sensor, model, lattice, kernel)
        assert law.known(got) == law.map(scans[:100], sensor, model, lattice)


@pytest.mark.recordings
@pytest.mark.parametrize(("name", "cell_mm"), [(INTEL, 50), (DRONES, 20)])
def test_both_kernels_make_the_same_map_of_a_whole_log(compiled, recorded, name, cell_mm):
    for scans, sensor in recorded(name):
        one = integrated({}, scans, sensor, EvidenceModel(), Lattice(cell_mm), raster.raster)
        other = integrated({}, scans, sensor, EvidenceModel(), Lattice(cell_mm), compiled)
        assert one.keys() == other.keys()
        assert all(np.array_equal(tile, other[key]) for key, tile in one.items())


@pytest.mark.recordings
def test_both_kernels_make_the_same_map_of_a_log_with_a_limit(compiled, recorded):
    for scans, sensor in recorded(DRONES):
        one, other = (
            integrated({}, scans, sensor, EvidenceModel(limit=500), Lattice(50), kernel)
            for kernel in (raster.raster, compiled)
        )
        assert map_digest(one) == map_digest(other)


@pytest.mark.recordings
def test_a_log_that_three_robots_share_makes_the_single_grid(compiled, recorded):
    """Scans dealt to three robots like cards, in batches of 64, 7 and 1: the digest is the single grid's."""
    ((scans, sensor),) = recorded(INTEL)
    model, lattice = EvidenceModel(), Lattice(50)
    maps = []
    for robot, size in enumerate((64, 7, 1)):
        own = in_order(scans, np.arange(robot, len(scans), 3))
        maps.append(mapped(in_batches(own, range(size, len(own), size)), sensor, model, lattice, compiled))
    assert map_digest(summed(maps)) == map_digest(mapped([scans], sensor, model, lattice, compiled))
