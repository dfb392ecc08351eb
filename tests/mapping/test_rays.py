import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.lattice import Lattice
from mapping.pose import Pose
from mapping.rays import Rays, rays_of
from mapping.scan import INVALID, NO_RETURN, Scans, quantise
from mapping.sensor import Beam, Sensor, sensor

few = settings(max_examples=40, deadline=None)
AHEAD = Sensor((Beam(0, 0, 0),), 1000)
coordinates = st.one_of(st.integers(-(10**9), 10**9), st.integers(-2000, 2000))
poses = st.tuples(coordinates, coordinates, st.integers(0, 65535))
offsets = st.one_of(st.integers(-32767, 32767), st.integers(-50, 50))
beams = st.builds(Beam, offsets, offsets, st.integers(0, 65535), st.just(0))


def scans_at(poses, ranges):
    return Scans(np.zeros(len(poses), np.int64), np.array(poses, np.int32), np.array(ranges, np.uint16))


@st.composite
def scans_and_sensors(draw):
    several = Sensor(tuple(draw(st.lists(beams, min_size=1, max_size=4))), draw(st.integers(1, 65_000)))
    readings = st.one_of(st.integers(1, several.max_range_mm), st.sampled_from([INVALID, NO_RETURN]))
    count = draw(st.integers(1, 4))
    width = len(several.beams)
    rows = st.lists(st.lists(readings, min_size=width, max_size=width), min_size=count, max_size=count)
    return scans_at(draw(st.lists(poses, min_size=count, max_size=count)), draw(rows)), several


@given(scans_and_sensors(), st.integers(1, 10_000))
@few
def test_rays_start_and_end_where_the_law_says(law, case, cell_mm):
    scans, several = case
    rays = rays_of(scans, several, Lattice(cell_mm))
    expected = [ray for scan in law.rays(scans, several, cell_mm) for ray in scan]
    got = zip(map(tuple, rays.start.tolist()), map(tuple, rays.end.tolist()), rays.hit.tolist(), strict=True)
    assert list(got) == expected


@given(scans_and_sensors(), st.integers(1, 10_000))
@few
def test_the_number_of_steps_is_the_longer_side(case, cell_mm):
    rays = rays_of(*case, Lattice(cell_mm))
    sides = np.abs(rays.end - rays.start)
    assert rays.steps.tolist() == [max(di, dj) for di, dj in sides.tolist()]


@given(poses, st.integers(0, 65535), st.integers(1, 15))
def test_a_range_within_the_bound_draws_no_more_than_4095_steps(pose, bearing, cell_mm):
    """The bound is on the range; a ray's ends are floors, so that one cell more could have been expected."""
    longest = Sensor((Beam(0, 0, bearing),), 4095 * cell_mm)
    Lattice(cell_mm).check_range(longest.max_range_mm)
    assert rays_of(scans_at([pose], [[NO_RETURN]]), longest, Lattice(cell_mm)).steps[0] <= 4095


def test_the_longest_range_along_an_axis_is_4095_steps():
    longest = Sensor((Beam(0, 0, 0),), 65_000)
    assert rays_of(scans_at([(7, 7, 0)], [[4095 * 15]]), longest, Lattice(15)).steps.tolist() == [4095]


@given(
    st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-4, 4)),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-4, 4)),
    st.floats(0.001, 5),
)
def test_a_reading_lies_where_metres_and_radians_put_it(robot, beam, reading):
    """Eq. 1 to 4 in floats; at 1 mm a cell the integers stay within what quantising can move."""
    x, y, bearing = beam
    scans = quantise([0.0], [robot], [[reading]], sensor([beam], 6.0))
    rays = rays_of(scans, sensor([beam], 6.0), Lattice(1))
    points_robot = np.array([[x, y], [x + reading * math.cos(bearing), y + reading * math.sin(bearing)]])
    expected = Pose(*robot).apply(points_robot)
    centres = (np.concatenate([rays.start, rays.end]) + 0.5) / 1000
    assert np.abs(centres - expected).max() < 0.0035  # pose, origin, range 0.5 mm each, angles 0.5, floor 0.5


def test_an_invalid_reading_gives_no_ray():
    assert len(rays_of(scans_at([(0, 0, 0)], [[INVALID]]), AHEAD, Lattice(50))) == 0


def test_nothing_in_range_gives_a_ray_to_the_end_of_the_range_without_a_hit():
    rays = rays_of(scans_at([(0, 0, 0)] * 2, [[NO_RETURN], [1000]]), AHEAD, Lattice(50))
    assert rays.end.tolist() == [[20, 0], [20, 0]]
    assert rays.hit.tolist() == [False, True]


def test_cells_are_floors_on_both_sides_of_the_origin():
    rays = rays_of(scans_at([(x, 0, 0) for x in (-51, -50, -1, 0, 49, 50)], [[1]] * 6), AHEAD, Lattice(50))
    assert rays.start[:, 0].tolist() == [-2, -1, -1, 0, 0, 1]
    assert rays.end[:, 0].tolist() == [-1, -1, 0, 0, 1, 1]


def test_no_scans_give_no_rays():
    rays = rays_of(Scans.empty(1), AHEAD, Lattice(50))
    assert len(rays) == 0
    assert rays.start.shape == rays.end.shape == (0, 2)
    assert rays.steps.shape == (0,)


@given(scans_and_sensors(), st.integers(0, 16), st.integers(0, 16))
@few
def test_a_slice_of_rays_is_the_slice_of_each_column(case, first, last):
    rays = rays_of(*case, Lattice(50))
    part = rays[first:last]
    assert isinstance(part, Rays)
    for name in ("start", "end", "hit", "steps"):
        assert np.array_equal(getattr(part, name), getattr(rays, name)[first:last])


def test_scans_of_another_sensor_are_no_rays_of_this_one():
    with pytest.raises(ValueError, match="broadcast"):
        rays_of(scans_at([(0, 0, 0)], [[1, 2, 3]]), Sensor((Beam(0, 0, 0),) * 2, 1000), Lattice(50))
