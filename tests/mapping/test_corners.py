"""Corners: where a ray goes from one line to the next, exact for every ray that there may be."""

from fractions import Fraction
from math import ceil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.canvas import FRACTION
from mapping.corners import Drawing, courses
from mapping.evidence import EvidenceModel
from mapping.lattice import MAX_RAY_CELLS, TILE
from mapping.raster import box_of
from mapping.rays import FREE, HIT, SILENT, Rays

MODEL = EvidenceModel()


def rays_to(ends, ending=HIT):
    """Rays from (0, 0)."""
    ends = np.array(ends, np.int32).reshape(-1, 2)
    return Rays(np.zeros_like(ends), ends, np.full(len(ends), ending, np.uint8))


def places_of(rays):
    """The place of each corner along its line and the line before it, ray after ray: shape (corners, 2)."""
    box = box_of([rays])
    columns, row, column = box.lines
    course = courses(rays, box)
    counts = np.abs(course.corners)
    m = np.arange(counts.max(initial=0))[:, None]
    addresses = ((course.first + m.view(np.uint64) * course.step) >> np.uint64(FRACTION)).view(np.int64).T
    addresses = addresses[(m < counts).T]
    by_column = addresses >= columns
    addresses = np.where(by_column, addresses - columns, addresses)
    length, (line, place) = (
        np.where(by_column, column, row),
        np.where(by_column, [[box.tx], [box.ty]], [[box.ty], [box.tx]]),
    )
    lines, places = addresses // length + line * TILE, addresses % length + place * TILE
    return np.stack([places, lines], axis=1)


def exact_places(n, slopes):
    """Of the rays from (0, 0) to (n, d), one d after the other: corner m is before the first cell with m aside."""
    return [(-(-(2 * m - 1) * n // (2 * d)), m - 1) for d in slopes for m in range(1, d + 1)]


@given(st.data(), st.integers(1, MAX_RAY_CELLS))
def test_a_corner_is_before_the_first_cell_that_is_rounded_so_far_aside(data, n):
    d = data.draw(st.integers(1, n))
    m = data.draw(st.integers(1, d))
    aside = [(2 * k * d + n) // (2 * n) for k in range(n + 1)]
    assert exact_places(n, [d])[m - 1] == (aside.index(m), m - 1)
    assert aside.index(m) == ceil(Fraction((2 * m - 1) * n, 2 * d))


def test_every_short_ray_is_exact_in_all_directions():
    for n in range(1, 201):
        exact = np.array(exact_places(n, range(n + 1))).reshape(-1, 2)
        place, line = exact.T
        for right in (1, -1):
            for up in (1, -1):
                along = place if right > 0 else 1 - place  # both times the cell with the larger coordinate
                beside = line if up > 0 else -1 - line
                got = places_of(rays_to([(right * n, up * d) for d in range(n + 1)]))
                assert np.array_equal(got, np.stack([along, beside], axis=1)), (n, right, up)
                if n > 1:  # with d = n it would be along x again
                    got = places_of(rays_to([(up * d, right * n) for d in range(n)]))
                    assert np.array_equal(got, np.stack([along, beside], axis=1)[: len(got)]), (n, right, up)


@pytest.mark.parametrize("n", [1023, 4093, 4094, 4095])
def test_every_slope_of_a_long_ray_is_exact(n):
    """Among them a prime and the longest allowed."""
    for first in range(0, n + 1, 512):
        slopes = range(first, min(first + 512, n + 1))
        d = np.repeat(slopes, slopes)
        m = np.concatenate([np.arange(1, d + 1) for d in slopes])
        exact = -(-(2 * m - 1) * n // (2 * np.maximum(d, 1)))
        assert np.array_equal(places_of(rays_to([(n, d) for d in slopes])), np.stack([exact, m - 1], axis=1))
        assert np.array_equal(places_of(rays_to([(-n, d) for d in slopes])), np.stack([1 - exact, m - 1], axis=1))


def test_the_error_bound_of_the_proof_holds_for_every_length():
    """At its last corner a progression is too small by less than 8192 * 2^-FRACTION, less than 1 / (2 d)."""
    assert Fraction(2 * (MAX_RAY_CELLS + 1), 2**FRACTION) < Fraction(1, 2 * MAX_RAY_CELLS)


steps = st.one_of(st.integers(-150, 150), st.integers(-3, 3))
rays = st.tuples(steps, steps, steps, steps, st.sampled_from([FREE, HIT, SILENT]))


@given(st.lists(rays, min_size=1, max_size=12), st.integers(0, 12))
def test_the_sums_are_the_evidence_however_the_rays_are_batched(law, several, cut):
    drawn = Rays(
        *(np.array(x, np.int32) for x in ([r[:2] for r in several], [r[2:4] for r in several])),
        np.array([r[4] for r in several], np.uint8),
    )
    drawing = Drawing(box_of([drawn]), MODEL)
    drawing.add(drawn[:cut])
    drawing.add(drawn[cut:])
    silent = [(r[:2], r[2:4], False) for r in several if r[4] == SILENT]
    expected = law.evidence([(r[:2], r[2:4], r[4] == HIT) for r in several], MODEL.occupied, MODEL.free)
    for _, end, _ in silent:  # it says nothing of its end
        expected[end] -= MODEL.free
    assert law.known(drawing.evidence()) == {cell: units for cell, units in expected.items() if units}
