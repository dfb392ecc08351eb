"""The simulated robot: where it drives, what it sees, and that its seed alone decides."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.body import BATCH, Body
from agent.errors import UserError
from agent.simulation import NO_NOISE, Noise, SimulatedBody, drive
from agent.world import World, load_world, world_names
from mapping.pose import FULL_TURN, Pose, QuantisedPose
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import laser, orion

ORION = orion()


def room(
    *, right: float, front: float, left: float, start: Pose | None = None, waypoints: object = ((0.0, 0.0),)
) -> World:
    """A rectangular room around the origin; its walls as a robot sees them that faces +x there."""
    corners = np.array([(-9, -right), (front, -right), (front, left), (-9, left), (-9, -right)], dtype=np.float64)
    walls = np.hstack([corners[:-1], corners[1:]])
    return World("room", walls, (start or Pose(),), (np.array(waypoints, dtype=np.float64),))


def all_of(body: Body) -> Scans:
    batches = []
    while not body.done:
        batches.append(body.read(math.inf))
    return Scans.join(batches)


def same(a: Scans, b: Scans) -> bool:
    return bool(
        np.array_equal(a.stamps_ms, b.stamps_ms)
        and np.array_equal(a.poses, b.poses)
        and np.array_equal(a.ranges, b.ranges)
    )


def hits(scans: Scans) -> NDArray[np.float64]:
    """Where the readings of an Orion fall, metres, from the whole numbers that it publishes."""
    poses = scans.poses * [0.001, 0.001, 2 * np.pi / FULL_TURN]
    points = []
    for k, beam in enumerate(ORION.beams):
        read = (scans.ranges[:, k] != INVALID) & (scans.ranges[:, k] != NO_RETURN)
        bearing = poses[read, 2] + beam.bearing_turn16 * 2 * np.pi / FULL_TURN
        in_robot = np.array([[beam.x_mm, beam.y_mm]]) / 1000
        centre = [Pose(*pose).apply(in_robot)[0] for pose in poses[read]]
        reach = scans.ranges[read, k, None] / 1000
        points.append(np.reshape(centre, (-1, 2)) + reach * np.column_stack([np.cos(bearing), np.sin(bearing)]))
    return np.concatenate(points)


# What it sees


def test_a_robot_facing_x_reads_right_to_left_as_in_table_i() -> None:
    """Right, right diagonal, front, left diagonal, left; the module sits 3 cm ahead of the centre."""
    body = SimulatedBody(room(right=0.2, front=0.4, left=0.5), 0, ORION, seed=1, noise=NO_NOISE)
    scans = all_of(body)
    assert len(scans) == 1
    diagonal_right, diagonal_left = 0.2 * math.sqrt(2), 0.37 * math.sqrt(2)
    expected = [0.2, diagonal_right, 0.37, diagonal_left, 0.5]
    np.testing.assert_allclose(scans.ranges[0], np.rint(np.array(expected) * 1000), atol=0)


def test_beams_start_at_their_own_place_on_the_turned_robot() -> None:
    """Facing +y at (1, 0.1): the module is 3 cm north of it."""
    place = room(right=0.4, front=1.3, left=0.6, start=Pose(1, 0.1, math.pi / 2), waypoints=[(1.0, 0.1)])
    ranges = all_of(SimulatedBody(place, 0, ORION, seed=1, noise=NO_NOISE)).ranges[0]
    assert ranges[0] == 300  # east
    assert ranges[2] == 600 - 130  # north
    assert ranges[4] == NO_RETURN  # west: ten metres


def test_what_lies_beyond_the_range_is_no_return() -> None:
    body = SimulatedBody(room(right=0.2, front=5, left=0.81), 0, ORION, seed=1, noise=NO_NOISE)
    assert all_of(body).ranges[0].tolist() == [200, 283, NO_RETURN, NO_RETURN, NO_RETURN]


def test_a_laser_sees_the_same_walls() -> None:
    sensor = laser(4, first=0.0, step=math.pi / 2, max_range=20.0)
    body = SimulatedBody(room(right=1, front=2, left=3), 0, sensor, seed=1, noise=NO_NOISE)
    assert all_of(body).ranges[0].tolist() == [2000, 3000, 9000, 1000]


# Noise


def many_still_scans(noise: Noise) -> Scans:
    """A robot which goes so slowly along a corridor that its side walls are as good as still: 3001 scans."""
    place = room(right=0.3, front=9, left=0.6, waypoints=[(3.0, 0.0)])
    return all_of(SimulatedBody(place, 0, ORION, seed=7, speed_m_s=0.01, noise=noise))


@pytest.mark.parametrize(("beam", "distance"), [(0, 0.3), (4, 0.6)])
def test_ranges_scatter_by_a_floor_and_a_share(beam: int, distance: float) -> None:
    scans = many_still_scans(Noise(dropout=0.0))
    ranges = scans.ranges[:, beam] / 1000
    assert ranges.mean() == pytest.approx(distance, abs=0.001)
    assert ranges.std() == pytest.approx(0.003 + 0.01 * distance, rel=0.05)


def test_some_readings_drop_out() -> None:
    scans = many_still_scans(Noise(dropout=0.1))
    assert np.mean(scans.ranges == INVALID) == pytest.approx(0.1, abs=0.01)


def test_noise_alone_makes_no_reading_invalid() -> None:
    """Touching a wall a noisy range may fall below zero; a sensor would still say "very near"."""
    place = room(right=0.0001, front=9, left=0.6, waypoints=[(1.0, 0.0)])
    scans = all_of(SimulatedBody(place, 0, ORION, seed=1, noise=Noise(dropout=0.0)))
    assert not (scans.ranges == INVALID).any()


def test_reported_poses_scatter_around_the_truth() -> None:
    place = room(right=0.3, front=9, left=0.6, waypoints=[(3.0, 0.0)])
    body = SimulatedBody(place, 0, ORION, seed=7, speed_m_s=0.01, noise=Noise(position=0.01, heading=0.02))
    error = all_of(body).poses * [0.001, 0.001, 2 * np.pi / FULL_TURN] - body.truth
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(error.std(axis=0), [0.01, 0.01, 0.02], rtol=0.05)
    np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=0.002)


# The seed decides


def test_the_same_seed_gives_the_same_run() -> None:
    place = load_world("paper")
    assert same(all_of(SimulatedBody(place, 0, ORION, seed=3)), all_of(SimulatedBody(place, 0, ORION, seed=3)))


def test_another_seed_gives_other_noise_on_the_same_way() -> None:
    place = load_world("paper")
    one, other = SimulatedBody(place, 0, ORION, seed=3), SimulatedBody(place, 0, ORION, seed=4)
    np.testing.assert_array_equal(one.truth, other.truth)
    assert not same(all_of(one), all_of(other))


def test_robots_do_not_share_their_noise() -> None:
    place = room(right=0.3, front=9, left=0.6, waypoints=[(1.0, 0.0)])
    twins = World("twins", place.walls, place.starts * 2, place.waypoints * 2)
    first, second = (all_of(SimulatedBody(twins, index, ORION, seed=3)) for index in (0, 1))
    assert not np.array_equal(first.ranges, second.ranges)


# Reading


@given(steps=st.lists(st.one_of(st.floats(0, 8), st.just(math.inf)), max_size=30))
def test_any_way_of_reading_gives_the_same_scans(steps: list[float]) -> None:
    place = load_world("paper")
    body = SimulatedBody(place, 1, ORION, seed=5)
    now, batches = 0.0, [Scans.empty(5)]
    for step in steps:
        now += step
        batch = body.read(now)
        assert len(batch) <= BATCH
        assert (batch.stamps_ms < now * 1000).all()
        batches.append(batch)
    batches += [all_of(body)] if not body.done else []
    assert same(Scans.join(batches), all_of(SimulatedBody(place, 1, ORION, seed=5)))


def test_nothing_is_sensed_before_time_begins_and_one_scan_at_its_beginning() -> None:
    body = SimulatedBody(load_world("paper"), 0, ORION, seed=1)
    assert len(body.read(-1.0)) == 0
    assert len(body.read(0.0)) == 0
    assert body.read(0.05).stamps_ms.tolist() == [0]
    assert body.read(0.25).stamps_ms.tolist() == [100, 200]


def test_a_reader_who_goes_back_in_time_gets_nothing_and_loses_nothing() -> None:
    body = SimulatedBody(load_world("paper"), 0, ORION, seed=1)
    body.read(1.0)
    assert len(body.read(0.5)) == 0
    assert body.read(1.15).stamps_ms.tolist() == [1000, 1100]


def test_progress_counts_to_the_end() -> None:
    body = SimulatedBody(load_world("paper"), 1, ORION, seed=1)
    given, total = body.progress
    assert given == 0
    assert not body.done
    body.read(math.inf)
    assert body.progress == (BATCH, total)
    all_of(body)
    assert body.progress == (total, total)
    assert body.done
    assert len(body.read(math.inf)) == 0


# Where it drives


def test_a_robot_turns_towards_a_waypoint_and_then_drives_straight_to_it() -> None:
    times, knots = drive(Pose(0, 0, 0), np.array([[0.0, 1.0], [1.0, 1.0]]), speed=0.1, turn_rate=math.pi)
    np.testing.assert_allclose(times, [0, 0.5, 10.5, 11.0, 21.0])
    quarter = math.pi / 2
    np.testing.assert_allclose(
        knots, [[0, 0, 0], [0, 0, quarter], [0, 1, quarter], [0, 1, 0], [1, 1, 0]], rtol=0, atol=1e-12
    )


def test_a_robot_turns_the_short_way_and_about_turns_go_left() -> None:
    waypoints = np.array([[-1.0, -1.0], [-1.0, 1.0], [-1.0, 0.0], [-1.0, 2.0]])
    _, knots = drive(Pose(0, 0, math.pi * 0.9), waypoints, speed=1, turn_rate=1)
    turns = np.diff(knots[:, 2])[::2]
    np.testing.assert_allclose(turns, np.array([0.35, -0.75, 1.0, 1.0]) * math.pi)


def test_a_waypoint_underfoot_is_passed_over() -> None:
    times, knots = drive(Pose(1, 2, 3), np.array([[1.0, 2.0]]), speed=1, turn_rate=1)
    assert times.tolist() == [0]
    assert knots.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("name", world_names())
def test_robots_never_exceed_their_speed_and_turn_rate(name: str) -> None:
    place = load_world(name)
    for index in range(len(place.starts)):
        body = SimulatedBody(place, index, ORION, seed=1, speed_m_s=0.15, turn_rad_s=1.0)
        steps = np.diff(body.truth, axis=0) / np.diff(body.stamps)[:, None]
        assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.15 + 1e-9
        assert np.abs(steps[:, 2]).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("name", world_names())
def test_the_run_starts_at_the_start_and_ends_at_the_last_waypoint(name: str) -> None:
    place = load_world(name)
    for index, start in enumerate(place.starts):
        body = SimulatedBody(place, index, ORION, seed=1)
        np.testing.assert_array_equal(body.truth[0], [start.x, start.y, start.yaw])
        assert np.linalg.norm(body.truth[-1, :2] - place.waypoints[index][-1]) <= 0.1 / 10 + 1e-9


# The common frame


@pytest.mark.parametrize("name", world_names())
def test_a_right_start_reports_the_truth(name: str) -> None:
    place = load_world(name)
    for index, start in enumerate(place.starts):
        told = SimulatedBody(place, index, ORION, start=QuantisedPose.of(start), seed=1, noise=NO_NOISE)
        scans = all_of(told)
        assert same(scans, all_of(SimulatedBody(place, index, ORION, seed=1, noise=NO_NOISE)))
        np.testing.assert_allclose(scans.poses[:, :2] / 1000, told.truth[:, :2], atol=0.00051)
        wrong = scans.poses[:, 2] / FULL_TURN - told.truth[:, 2] / (2 * np.pi)
        assert np.abs(wrong - np.rint(wrong)).max() <= 0.51 / FULL_TURN


def test_a_wrong_start_turns_and_shifts_the_run_as_a_whole_and_nothing_else() -> None:
    place = load_world("paper")
    believed = Pose(-1.0, 0.5, math.radians(30))
    honest = SimulatedBody(place, 1, ORION, seed=1)
    mistaken = SimulatedBody(place, 1, ORION, start=QuantisedPose.of(believed), seed=1)
    right, wrong = all_of(honest), all_of(mistaken)
    np.testing.assert_array_equal(right.ranges, wrong.ranges)
    np.testing.assert_array_equal(honest.truth, mistaken.truth)
    moved = (believed @ place.starts[1].inverse()).apply(right.poses[:, :2] / 1000)
    np.testing.assert_allclose(wrong.poses[:, :2] / 1000, moved, atol=0.0015)
    np.testing.assert_array_equal(wrong.poses[0, 2] - right.poses[0, 2], round(20 / 360 * FULL_TURN))


# The packaged worlds, driven


@pytest.mark.parametrize("name", world_names())
def test_the_robots_together_see_the_walls(name: str) -> None:
    """At least 95 % of the points every 1 cm along the walls lie within 4 cm of a reading."""
    place = load_world(name)
    runs = [all_of(SimulatedBody(place, index, ORION, seed=1)) for index in range(len(place.starts))]
    points = np.unique(np.rint(np.concatenate([hits(run) for run in runs]) * 200), axis=0) / 200  # 5 mm, for speed
    lengths = np.hypot(*(place.walls[:, 2:] - place.walls[:, :2]).T)
    along = [
        np.linspace(wall[:2], wall[2:], math.ceil(length / 0.01) + 1)
        for wall, length in zip(place.walls, lengths, strict=True)
    ]
    gaps = [np.linalg.norm(points - wall_point, axis=1).min() for wall_point in np.concatenate(along)]
    assert np.mean(np.array(gaps) <= 0.04) >= 0.95


def test_every_room_is_seen_by_its_own_robot_and_by_another() -> None:
    """Else the overlap of the robots' maps would be the corridor alone."""
    rooms = {"r1": (0, 2.2, 0, 1.48), "r2": (2.2, 5, 0, 1.48), "r3": (0, 2.9, 2.52, 4), "r4": (2.9, 5, 2.52, 4)}
    place = load_world("rooms")
    visitors = dict.fromkeys(rooms, 0)
    for index in range(4):
        x, y = hits(all_of(SimulatedBody(place, index, ORION, seed=1, noise=NO_NOISE))).T
        for room, (west, east, south, north) in rooms.items():
            inside = (x > west - 0.02) & (x < east + 0.02) & (y > south - 0.02) & (y < north + 0.02)
            visitors[room] += int(inside.sum() > 20)
    assert visitors == {"r1": 2, "r2": 2, "r3": 2, "r4": 2}


@pytest.mark.parametrize("name", world_names())
def test_a_run_takes_a_few_minutes_and_is_laid_out_at_once(name: str) -> None:
    place = load_world(name)
    began = time.perf_counter()
    bodies = [SimulatedBody(place, index, ORION, seed=1) for index in range(len(place.starts))]
    assert time.perf_counter() - began < 1.0
    assert all(body.stamps[-1] < 200 for body in bodies)


# What the user can get wrong


def test_a_robot_without_a_start_is_refused() -> None:
    with pytest.raises(UserError, match=r"has 2 starts.*robot 3"):
        SimulatedBody(load_world("paper"), 2, ORION, seed=1)


def test_a_way_of_hours_is_refused() -> None:
    place = room(right=1, front=1, left=1, waypoints=[(900.0, 0.0)])
    with pytest.raises(UserError, match=r"starts\[0\].waypoints.*9000 s"):
        SimulatedBody(place, 0, ORION, seed=1)
