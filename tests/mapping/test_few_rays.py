"""Few rays in plain Python: the same rays as of many scans, and the law's cells."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.canvas import Box
from mapping.evidence import EvidenceModel
from mapping.few_rays import drawn, raster, rays_of_one
from mapping.lattice import Lattice
from mapping.rays import FREE, HIT, SILENT, rays_of
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Beam, Sensor, orion

MODEL = EvidenceModel()
readings = st.one_of(st.sampled_from([INVALID, NO_RETURN, 1, 800]), st.integers(1, 800))


@given(
    st.tuples(*[st.integers(-(10**8), 10**8)] * 2, st.integers(0, 65535)),
    st.lists(readings, min_size=5, max_size=5),
    st.sampled_from([0.0, 0.4]),
    st.sampled_from([1, 20, 37]),
)
def test_the_rays_of_a_scan_are_those_of_many_scans(pose, ranges, view, cell_mm):
    sensor, lattice = orion(view=view), Lattice(cell_mm)
    scan = Scans(np.zeros(1, np.int64), np.array([pose], np.int32), np.array([ranges], np.uint16))
    rays = rays_of(scan, sensor, lattice)
    few = list(rays_of_one(scan, sensor, lattice))
    assert few == [
        (*start, *end, ending)
        for start, end, ending in zip(*(x.tolist() for x in (rays.start, rays.end, rays.ending)), strict=True)
    ]


steps = st.one_of(st.integers(-70, 70), st.integers(-3, 3))
rays = st.tuples(steps, steps, steps, steps, st.sampled_from([FREE, HIT, SILENT]))


@given(st.lists(rays, max_size=8))
@settings(deadline=None)
def test_the_evidence_is_the_laws(law, several):
    expected = law.evidence([(r[:2], r[2:4], r[4] == HIT) for r in several], MODEL.occupied, MODEL.free)
    for ray in several:
        if ray[4] == SILENT:  # it says nothing of its end
            expected[ray[2:4]] -= MODEL.free
    assert law.known(drawn(several, Box(-5, -5, 10, 10), MODEL)) == {
        cell: units for cell, units in expected.items() if units
    }


def scan(*ranges):
    return Scans(np.zeros(1, np.int64), np.zeros((1, 3), np.int32), np.array([ranges], np.uint16))


def test_a_scan_of_an_orion_is_few_rays_and_others_are_left_to_arrays(law):
    few, lattice = scan(800, 400, INVALID, NO_RETURN, 17), Lattice(20)
    assert law.known(raster(few, orion(), lattice, MODEL)) == law.map(few, orion(), MODEL, lattice)
    assert raster(Scans.join([few, few]), orion(), lattice, MODEL) is None
    assert raster(few, orion(), Lattice(1), MODEL) is None  # long
    assert raster(few, orion(view=0.4), Lattice(20), MODEL) is None  # many
    apart = Sensor((Beam(-32_000, 0, 0), Beam(32_000, 30_000, 0)), 100)
    assert raster(scan(100, 100), apart, Lattice(1), MODEL) is None
    assert list(raster(scan(*[INVALID] * 5), orion(), lattice, MODEL)) == []


def test_a_scan_of_another_sensor_is_refused():
    with pytest.raises(ValueError, match="4 readings"):
        raster(scan(1, 1, 1, 1), orion(), Lattice(20), MODEL)
