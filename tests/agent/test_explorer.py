"""Exploring: small places are explored completely, without touching a wall, and then the robot is done."""

import math

import numpy as np
import pytest

from agent.driver import ROBOT_RADIUS, STILL
from agent.explorer import WAITS, Explorer, blind_angle
from agent.frontier import terrain_of
from agent.senses import NO_NOISE, Noise
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.pose import Pose, QuantisedPose
from mapping.sensor import laser, orion
from mapping.sensor import sensor as sensor_of

NOTHING = np.zeros((0, 2))


def box(x0, y0, x1, y1):
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


MAZE = [*box(0, 0, 2.4, 1.6), [0.8, 0, 0.8, 1.0], [1.6, 1.6, 1.6, 0.6]]
"""Three chambers in a row, joined by gaps of 60 cm at alternate ends."""


def explorer(robot):
    return Explorer(lambda: robot.own.map, robot.rules.lattice, robot.mates.positions, look=blind_angle(robot.sensor))


def known_share(robot, x1, y1):
    """Of the coarse cells of [0, x1) x [0, y1), the share that the map knows."""
    terrain = terrain_of(robot.peer.fusion.tiles, robot.rules.lattice, np.array([[0.0, 0.0]]))
    points = np.stack(np.meshgrid(np.arange(0.02, x1, 0.04), np.arange(0.02, y1, 0.04)), -1).reshape(-1, 2)
    return float((~terrain.unknown)[tuple(terrain.cells(points).T)].mean())


@pytest.mark.parametrize(
    ("noise", "view_deg"),
    [
        pytest.param(NO_NOISE, 0, id="ideal"),
        pytest.param(Noise(), 0, id="noisy"),
        pytest.param(Noise(), 25, id="cones"),
    ],
)
def test_a_small_maze_is_explored_completely(arena, noise, view_deg):
    """Where a cone's whole arc was taken for occupied, the gaps closed and half of the maze was never seen."""
    sensor = orion(view=math.radians(view_deg))
    place = arena(MAZE, [Pose(0.4, 0.4, math.pi / 2)], explorer, noise=noise, sensor=sensor)
    (robot,) = place.robots
    place.run(600, lambda: robot.body.done)
    assert robot.body.done
    assert known_share(robot, 2.4, 1.6) > 0.95
    assert place.simulator.collisions.tolist() == [0]
    truth = np.array(place.simulator.truth)[:, 0, :2]
    assert place.world.clearance(truth).min() > ROBOT_RADIUS


def test_a_robot_that_learns_on_the_way_where_it_started_goes_on_and_explores_the_rest(arena):
    start = Pose(0.4, 0.4, math.pi / 2)
    place = arena(MAZE, [start], explorer, believed=[None])
    (robot,) = place.robots
    place.run(30)
    assert not robot.body.done
    robot.peer.set_start_pose("r1", QuantisedPose.of(start), place.now)
    place.run(600, lambda: robot.body.done)
    assert robot.body.done
    assert known_share(robot, 2.4, 1.6) > 0.95
    assert place.simulator.collisions.tolist() == [0]


def test_what_a_driver_has_looked_at_moves_with_it_and_a_way_is_planned_anew():
    tiles = corridor()
    driver = Explorer(lambda: tiles, Lattice(20), look=0.0)
    assert driver.drive(0.0, Pose(0.3, 0.2, 0.0), NOTHING).speed > 0
    driver._looked_at.append((1.0, 0.0))
    driver.placed(Pose(0.0, 1.0, math.pi / 2))
    assert driver._looked_at == [pytest.approx((0.0, 2.0))]
    assert driver._corners == []
    assert driver.drive(0.1, Pose(0.3, 0.2, 0.0), NOTHING).speed > 0


def test_two_robots_explore_together_and_agree(arena):
    place = arena(MAZE, [Pose(0.4, 0.3, math.pi / 2), Pose(2.0, 1.3, -math.pi / 2)], explorer)
    place.run(600, lambda: all(robot.body.done for robot in place.robots))
    place.settle()
    one, two = place.robots
    assert one.body.done
    assert two.body.done
    assert one.peer.fusion.digest() == two.peer.fusion.digest()
    assert known_share(one, 2.4, 1.6) > 0.95
    assert place.simulator.collisions.tolist() == [0, 0]


def test_a_closed_room_is_looked_at_and_done(arena):
    place = arena(box(0, 0, 0.8, 0.8), [Pose(0.4, 0.4, 0)], explorer)
    (robot,) = place.robots
    place.run(120, lambda: robot.body.done)
    assert robot.body.done
    assert place.simulator.driven[0] < 0.5


def test_without_a_map_it_stands_and_is_not_done_and_says_why():
    driver = Explorer(dict, Lattice(20), look=0.0)
    assert driver.drive(0.0, Pose(), NOTHING) == STILL
    assert not driver.done
    assert driver.status == "has seen nothing free around it"


def test_a_way_that_a_team_mate_closes_is_waited_for_and_then_given_up():
    tiles = corridor()
    mates = [np.array([[0.7, 0.2]])]
    driver = Explorer(lambda: tiles, Lattice(20), lambda: mates[0], look=0.0)
    pose = Pose(0.3, 0.2, 0.0)
    assert driver.drive(0.0, pose, NOTHING) == STILL
    assert driver.status == "waits for its way to become free"
    assert not driver.done
    mates[0] = np.zeros((0, 2))
    assert driver.drive(2.0, pose, NOTHING).speed > 0
    assert driver.status == ""
    mates[0] = np.array([[0.7, 0.2]])
    driver.drive(4.0, pose, NOTHING)
    assert not driver.done
    driver.drive(4.0 + WAITS + 1, pose, NOTHING)
    assert driver.done


def corridor():
    """40 cm wide along x, known from 0 to 1.2 m, closed at its beginning."""
    cells = np.full((20, 60), -40, np.int32)
    cells[[0, -1]] = 85
    cells[:, 0] = 85
    return Grid(cells, 0, 0, Lattice(20)).tiles()


def test_what_stands_in_the_way_and_is_not_on_the_map_is_waited_for_and_then_done_without():
    """Something that only the front beam sees, wherever the robot turns to."""
    tiles = corridor()
    driver = Explorer(lambda: tiles, Lattice(20), look=0.0)
    pose, stamp = Pose(0.3, 0.2, 0.0), 0.0
    assert driver.drive(stamp, pose, NOTHING).speed > 0
    while not driver.done and stamp < 200:
        stamp += 0.1
        motion = driver.drive(stamp, pose, np.array([[0.12, 0.0]]))
        assert motion.speed == 0.0
        pose = Pose(pose.x, pose.y, pose.yaw + 0.1 * motion.turn_rate)
    assert driver.done


def test_the_blind_angle_is_the_widest_gap_between_beams():
    assert blind_angle(orion()) == pytest.approx(math.pi, abs=1e-3)
    assert blind_angle(laser(360, first=0, step=math.radians(1), max_range=4)) == pytest.approx(
        math.radians(1), abs=1e-3
    )
    assert blind_angle(sensor_of([(0, 0, 0.3)], 1.0)) == pytest.approx(math.tau)
