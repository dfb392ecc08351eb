"""Robots in one world: what they see, what stops them, and that the seed alone decides."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.errors import UserError
from agent.kinematics import ORION_CHASSIS, Chassis, arc
from agent.obstacle import Obstacle
from agent.occupied_cells import NO_CELLS, OccupiedCells
from agent.senses import NO_NOISE, ORION_NOISE, Noise
from agent.simulator import STEP, Readings, Simulator
from agent.world import World, load_world
from mapping.pose import Pose
from mapping.sensor import Sensor, laser, orion

ORION = orion()
PROMPT = Chassis(lag=0.0)
RADIUS = ORION_CHASSIS.radius
ONE_STEP = 0.1 * STEP + 1e-9
"""Metres in a step at the speed that most tests drive at."""


def room(*starts: Pose, right: float = 9, front: float = 9, left: float = 9, obstacles: object = ()) -> World:
    """A rectangular room around the origin; its walls as a robot sees them that faces +x there."""
    corners = np.array([(-9, -right), (front, -right), (front, left), (-9, left), (-9, -right)], dtype=np.float64)
    walls = np.hstack([corners[:-1], corners[1:]])
    return World("room", walls, starts or (Pose(),), (), tuple(obstacles))  # type: ignore[arg-type]


def simulate(world: World, *, sensor: Sensor = ORION, noise: Noise = NO_NOISE, seed: int = 1) -> Simulator:
    return Simulator(world, seed, len(world.starts), sensor, noise=noise, chassis=PROMPT)


def drive(simulator: Simulator, seconds: float, *wheels: tuple[float, float]) -> None:
    simulator.targets[:] = wheels
    simulator.advance(simulator.now_ms + round(seconds * 1000))


# What they see


def test_a_robot_facing_x_reads_right_to_left_as_in_table_i() -> None:
    """Right, right diagonal, front, left diagonal, left; the module sits 3 cm ahead of the centre (d_RS)."""
    ranges = simulate(room(right=0.2, front=0.4, left=0.5)).sense().ranges[0]
    np.testing.assert_allclose(ranges, [0.2, 0.2 * math.sqrt(2), 0.37, 0.37 * math.sqrt(2), 0.5])


def test_beams_start_at_their_own_place_on_the_turned_robot() -> None:
    """Facing +y at (1, 0.1): the module is 3 cm north of it."""
    ranges = simulate(room(Pose(1, 0.1, math.pi / 2), right=0.4, front=1.3, left=0.6)).sense().ranges[0]
    assert ranges[0] == pytest.approx(0.3)  # east
    assert ranges[2] == pytest.approx(0.47)  # north
    assert ranges[4] == math.inf  # west: ten metres


def test_a_laser_sees_the_same_walls() -> None:
    sensor = laser(4, first=0.0, step=math.pi / 2, max_range=20.0)
    ranges = simulate(room(right=1, front=2, left=3), sensor=sensor).sense().ranges[0]
    np.testing.assert_allclose(ranges, [2, 3, 9, 1])


def test_two_robots_that_face_each_other_see_each_others_fronts() -> None:
    """Centres 60 cm apart, a sensor 3 cm ahead of one and the other's front 6 cm ahead of the other."""
    ranges = simulate(room(Pose(0, 0, 0), Pose(0.6, 0, math.pi))).sense().ranges
    np.testing.assert_allclose(ranges[:, 2], 0.6 - 0.03 - 0.06)
    assert np.isinf(ranges[:, [0, 1, 3, 4]]).all()


def test_a_robot_turned_by_45_degrees_shows_its_corner() -> None:
    ranges = simulate(room(Pose(0, 0, 0), Pose(0.6, 0, math.pi / 4))).sense().ranges
    assert ranges[0, 2] == pytest.approx(0.6 - 0.03 - 0.06 * math.sqrt(2))


def test_a_robot_behind_another_is_hidden() -> None:
    ranges = simulate(room(Pose(0, 0, 0), Pose(0.3, 0, 0), Pose(0.6, 0, 0))).sense().ranges
    np.testing.assert_allclose(ranges[:2, 2], 0.3 - 0.03 - 0.06)
    assert ranges[2, 2] == math.inf


def test_obstacles_are_seen() -> None:
    disc = Obstacle("disc", 0.1, 0.0, np.array([[0.5, 0.0]]))
    box = Obstacle("box", 0.1, 0.0, np.array([[0.03, 0.5]]))
    ranges = simulate(room(obstacles=[disc, box])).sense().ranges[0]
    assert ranges[2] == pytest.approx(0.37)
    assert ranges[4] == pytest.approx(0.4)


def test_an_obstacle_is_seen_where_it_has_got_to() -> None:
    cart = Obstacle("box", 0.1, 0.2, np.array([[0.5, -1.0], [0.5, 1.0]]))
    simulator = simulate(room(obstacles=[cart]))
    assert simulator.sense().ranges[0, 2] == math.inf
    simulator.advance(5000)
    np.testing.assert_allclose(simulator.obstacles, [[0.5, 0.0]], atol=1e-9)
    assert simulator.sense().ranges[0, 2] == pytest.approx(0.37)


def test_a_wide_beam_reads_the_nearest_in_its_cone() -> None:
    """A pole 5 degrees off the axis: a thin ray misses it, a cone of 25 degrees does not."""
    off = 0.4 * np.array([math.cos(math.radians(5)), math.sin(math.radians(5))])
    pole = Obstacle("disc", 0.02, 0.0, off[None] + [0.03, 0])
    place = room(front=0.7, obstacles=[pole])
    wide = Sensor(tuple(beam._replace(half_width_turn16=2276) for beam in ORION.beams), ORION.max_range_mm)
    assert simulate(place).sense().ranges[0, 2] == pytest.approx(0.67)
    assert simulate(place, sensor=wide).sense().ranges[0, 2] == pytest.approx(0.38, abs=0.003)


def test_a_wide_beam_before_a_flat_wall_reads_its_distance() -> None:
    wide = Sensor(tuple(beam._replace(half_width_turn16=2276) for beam in ORION.beams), ORION.max_range_mm)
    assert simulate(room(front=0.5), sensor=wide).sense().ranges[0, 2] == pytest.approx(0.47)


def test_a_picture_of_a_room_is_the_same_room() -> None:
    """Walls on cell borders: the cells around a room of 1.2 x 0.8 m against four segments."""
    picture = np.ones((12, 16), np.bool_)
    picture[2:10, 2:14] = False
    starts = (Pose(0.35, 0.3, 0.4), Pose(0.8, 0.5, 2.0))
    drawn = World("drawn", np.zeros((0, 4)), starts, (), (), OccupiedCells(picture, (-0.2, -0.2), 0.1))
    corners = np.array([(0, 0), (1.2, 0), (1.2, 0.8), (0, 0.8), (0, 0)], dtype=np.float64)
    built = World("built", np.hstack([corners[:-1], corners[1:]]), starts, (), (), NO_CELLS)
    pair = simulate(drawn, noise=ORION_NOISE), simulate(built, noise=ORION_NOISE)
    for k in range(200):
        for simulator in pair:
            drive(simulator, 0.1, (0.05 * math.sin(k), 0.1), (0.1, 0.08))
        np.testing.assert_allclose(pair[0].poses, pair[1].poses, atol=1e-9)
        np.testing.assert_allclose(pair[0].sense().ranges, pair[1].sense().ranges, atol=1e-9)
    assert (pair[0].collisions == pair[1].collisions).all()
    assert pair[0].collisions.sum() > 0


# Where they go


def test_a_robot_drives_the_arc_that_its_wheels_say() -> None:
    simulator = simulate(room())
    drive(simulator, 3.0, (0.08, 0.12))
    np.testing.assert_allclose(simulator.poses, arc(np.zeros((1, 3)), np.array([[0.24, 0.36]]), 0.1), atol=1e-12)
    assert simulator.driven[0] == pytest.approx(0.3, rel=1e-4)  # chords of 1 mm
    assert simulator.sense().ticks.tolist() == [[int(0.24 * 13_926), int(0.36 * 13_926)]]


def test_stamps_are_simulated_time_and_the_truth_is_kept_at_each_sample() -> None:
    simulator = simulate(room())
    stamps = [simulator.sense().stamp_ms]
    for _ in range(3):
        drive(simulator, 0.1, (0.1, 0.1))
        stamps.append(simulator.sense().stamp_ms)
    assert stamps == simulator.stamps_ms == [0, 100, 200, 300]
    np.testing.assert_allclose(np.array(simulator.truth)[:, 0, 0], [0, 0.01, 0.02, 0.03])


def test_wheels_that_slip_count_more_than_the_robot_goes() -> None:
    starts = tuple(Pose(0, 3.0 * k, 0) for k in range(30))
    simulator = simulate(
        room(*starts, right=99, front=99, left=99), noise=replace(NO_NOISE, slip=0.05, slip_walk=0.004)
    )
    drive(simulator, 20.0, *[(0.1, 0.1)] * 30)
    assert np.abs(simulator.sense().ticks - 2 * 13_926).max() <= 1
    # Each wheel walks by 4 mm a root metre; the robot's way is the mean of two wheels.
    assert simulator.driven.mean() == pytest.approx(2.0 * 0.95, abs=0.004)
    turned = simulator.poses[:, 2]
    assert turned.std() == pytest.approx(0.004 * math.sqrt(2.0) * math.sqrt(2) / 0.1, rel=0.35)


# What stops them


def test_a_wall_stops_a_robot_and_its_wheels_slip_on() -> None:
    simulator = simulate(room(front=0.5))
    drive(simulator, 10.0, (0.1, 0.1))
    x, y, yaw = simulator.poses[0]
    assert 0.5 - RADIUS - ONE_STEP <= x <= 0.5 - RADIUS
    assert (y, yaw) == (0, 0)
    assert simulator.sense().ticks[0, 0] == pytest.approx(13_926, abs=1)
    assert simulator.collisions.tolist() == [1]
    assert simulator.driven[0] == pytest.approx(x)


def test_a_robot_at_a_wall_can_turn_and_leave_and_come_again() -> None:
    simulator = simulate(room(front=0.5))
    drive(simulator, 10.0, (0.1, 0.1))
    drive(simulator, 1.0, (-0.1, 0.1))
    assert simulator.poses[0, 2] == pytest.approx(2.0)
    drive(simulator, 1.0, (0.1, 0.1))
    assert simulator.poses[0, 0] == pytest.approx(0.5 - RADIUS + 0.1 * math.cos(2.0), abs=ONE_STEP)
    drive(simulator, 4.0, (-0.1, -0.1))
    assert simulator.collisions.tolist() == [2]


def test_a_robot_may_slide_along_a_wall_that_it_does_not_come_nearer_to() -> None:
    simulator = simulate(room(Pose(0, 0, 0), right=RADIUS + 0.0001))
    drive(simulator, 2.0, (0.1, 0.1))
    assert simulator.poses[0, 0] == pytest.approx(0.2)
    assert simulator.collisions.tolist() == [0]


def test_robots_stop_at_each_other() -> None:
    simulator = simulate(room(Pose(0, 0, 0), Pose(0.6, 0, math.pi)))
    drive(simulator, 10.0, (0.1, 0.1), (0.1, 0.1))
    gap = simulator.poses[1, 0] - simulator.poses[0, 0] - 2 * RADIUS
    assert abs(gap) <= 2 * ONE_STEP
    assert simulator.collisions.tolist() == [1, 1]
    drive(simulator, 1.0, (-0.1, -0.1), (0.1, 0.1))  # one flees, the other follows
    assert simulator.poses[0, 0] == pytest.approx(0.3 - RADIUS - 0.1, abs=0.003)


def test_a_robot_that_is_run_into_has_not_run_into_anything() -> None:
    simulator = simulate(room(Pose(0, 0, 0), Pose(0.6, 0, 0)))
    drive(simulator, 10.0, (0.1, 0.1), (0.0, 0.0))
    assert simulator.collisions.tolist() == [1, 0]
    np.testing.assert_array_equal(simulator.poses[1], [0.6, 0, 0])


@pytest.mark.parametrize("shape", ["disc", "box"])
def test_obstacles_stop_robots(shape: str) -> None:
    post = Obstacle(shape, 0.1, 0.0, np.array([[0.5, 0.0]]))  # type: ignore[arg-type]
    simulator = simulate(room(obstacles=[post]))
    drive(simulator, 10.0, (0.1, 0.1))
    assert 0.4 - RADIUS - ONE_STEP <= simulator.poses[0, 0] <= 0.4 - RADIUS


def test_an_obstacle_waits_for_a_robot_in_its_way() -> None:
    cart = Obstacle("disc", 0.1, 0.1, np.array([[-0.8, 0.0], [1.0, 0.0]]))
    simulator = simulate(room(obstacles=[cart]))
    simulator.advance(10_000)
    gap = -simulator.obstacles[0, 0] - 0.1 - RADIUS
    assert gap == pytest.approx(0.03, abs=0.002)
    drive(simulator, 5.0, (0.1, 0.1))
    assert simulator.obstacles[0, 0] > -0.3
    assert simulator.collisions.tolist() == [0]


@given(seed=st.integers(0, 2**16))
@settings(max_examples=5)
def test_nobody_ever_gets_into_anything(seed: int) -> None:
    """It also holds the shortcut to account that does not look for touches while there is room."""
    starts = tuple(Pose(0.3 * k, 0.0, float(k)) for k in range(4))
    people = (
        Obstacle("disc", 0.08, 0.3, np.array([[-0.2, 0.3], [1.1, 0.3]])),
        Obstacle("box", 0.06, 0.2, np.array([[-0.2, -0.25], [1.1, -0.25]]), loop=True),
    )
    simulator = Simulator(
        replace(room(*starts, right=0.4, front=1.3, left=0.45), obstacles=people), seed, 4, ORION, noise=ORION_NOISE
    )
    rng = np.random.default_rng(seed)
    world = room(right=0.4, front=1.3, left=0.45)
    step = ORION_CHASSIS.top_speed * STEP * 2
    for _ in range(40):
        simulator.targets[:] = rng.uniform(-0.4, 0.4, (4, 2))
        for _ in range(20):
            simulator.advance(simulator.now_ms + 10)
            at = simulator.poses[:, :2]
            assert world.clearance(at).min() >= RADIUS - 1e-9
            apart = np.hypot(*(at[:, None] - at).transpose(2, 0, 1)) + np.eye(4)
            assert apart.min() >= 2 * RADIUS - 2 * step
            disc = np.hypot(*(at - simulator.obstacles[0]).T)
            assert disc.min() >= RADIUS + 0.08 - step


# The seed decides


def run(simulator: Simulator, *, samples: int = 60) -> list[Readings]:
    readings = []
    for k in range(samples):
        drive(simulator, 0.1, *[(0.1, 0.1 + 0.02 * math.sin(k / 7))] * len(simulator.poses))
        readings.append(simulator.sense())
    return readings


def numbers(readings: list[Readings]) -> NDArray[np.float64]:
    rows = [np.column_stack([each.ticks, each.headings, np.nan_to_num(each.ranges, posinf=9)]) for each in readings]
    return np.array(rows)


def test_the_same_seed_gives_the_same_run() -> None:
    pair = [numbers(run(simulate(load_world("rooms"), noise=ORION_NOISE, seed=3))) for _ in range(2)]
    np.testing.assert_array_equal(*pair)


def test_another_seed_gives_another_run() -> None:
    pair = [numbers(run(simulate(load_world("rooms"), noise=ORION_NOISE, seed=seed))) for seed in (3, 4)]
    assert not np.array_equal(*pair)


def test_how_time_is_cut_does_not_matter() -> None:
    coarse, fine = (simulate(load_world("rooms"), noise=ORION_NOISE) for _ in range(2))
    for simulator in (coarse, fine):
        simulator.targets[:] = (0.1, 0.12)
    coarse.advance(3005)
    for until in range(0, 3005, 5):
        fine.advance(until)
    fine.advance(3005)
    assert coarse.now_ms == fine.now_ms == 3000
    np.testing.assert_array_equal(coarse.poses, fine.poses)


def test_robots_that_do_not_meet_do_not_change_each_other() -> None:
    place = load_world("rooms")
    alone = Simulator(replace(place, starts=place.starts[:1]), 3, 1, ORION)
    together = Simulator(place, 3, 4, ORION)
    np.testing.assert_array_equal(numbers(run(alone))[:, 0], numbers(run(together))[:, 0])


def test_without_noise_a_robot_reads_the_truth() -> None:
    simulator = simulate(load_world("office"))
    for reading in run(simulator, samples=20):
        np.testing.assert_allclose(
            reading.headings, simulator.truth[simulator.stamps_ms.index(reading.stamp_ms)][:, 2] - np.pi / 2
        )
    distances = simulator.distances()
    np.testing.assert_array_equal(simulator.sense().ranges, np.where(distances > 0.8, np.inf, distances))


# The rest


def test_a_robot_without_a_start_is_refused() -> None:
    with pytest.raises(UserError, match=r"has 2 starts.*robot 3"):
        Simulator(load_world("paper"), 1, 3, ORION)


def test_a_second_of_six_robots_takes_a_fraction_of_one() -> None:
    """Some 15 ms on an idle machine; the limit leaves room for a busy one."""
    simulator = Simulator(load_world("office"), 1, 6, ORION)
    took = []
    for _ in range(5):
        began = time.perf_counter()
        run(simulator, samples=10)
        took.append(time.perf_counter() - began)
    assert min(took) < 0.15
