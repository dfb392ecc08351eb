"""Steering on the robot's own estimate: it gets there, keeps its limits, and stops for what stands ahead."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from agent.driver import (
    ARRIVED,
    BLOCKED_AFTER,
    STILL,
    Limits,
    Motion,
    NoDriver,
    WaypointDriver,
    held_back,
    room_ahead,
    steer,
)
from agent.odometry import along_arc
from mapping.pose import Pose

NOTHING = np.zeros((0, 2))
DT = 0.1
LOOP = [(1.0, 0.0), (1.0, 0.7), (0.0, 0.7), (0.0, 0.0)]

poses = st.builds(Pose, st.floats(-2, 2), st.floats(-2, 2), st.floats(-7, 7))
places = st.tuples(st.floats(-2, 2), st.floats(-2, 2))


def follow(driver, pose, seconds, seen=lambda stamp, pose: NOTHING):
    """An ideal robot that obeys one sample late; its poses."""
    track, motion = [pose], STILL
    for step in range(round(seconds / DT)):
        following = driver.drive(step * DT, pose, seen(step * DT, pose))
        pose = along_arc(pose, motion.speed * DT, motion.turn_rate * DT)
        track.append(pose)
        motion = following
        if driver.done:
            break
    return track


def distance_to_line(point, a, b):
    point, a, b = (np.array(it, float) for it in (point, a, b))
    share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return float(np.hypot(*(point - a - share * (b - a))))


# Steering


@given(poses, places)
def test_no_limit_is_ever_exceeded(pose, place):
    limits = Limits()
    motion = steer(pose, *place, limits)
    assert 0 <= motion.speed <= limits.speed
    assert abs(motion.turn_rate) <= limits.turn_rate


@given(poses, places)
@example(Pose(1.0, -0.0, 0.0), (0.0, -0.0))  # to the left, then, as the zero loses its sign, to the right, and so on
def test_every_place_is_reached(pose, place):
    track = follow(WaypointDriver([place]), pose, 80)
    end = track[-1]
    assert math.hypot(end.x - place[0], end.y - place[1]) <= ARRIVED


def test_a_robot_turns_on_the_spot_towards_what_lies_behind_it():
    motion = steer(Pose(), -1.0, 0.1, Limits())
    assert motion.speed == 0
    assert motion.turn_rate == Limits().turn_rate


def test_it_slows_down_near_the_goal():
    speeds = [steer(Pose(), x, 0.0, Limits()).speed for x in (1.0, 0.05, 0.03)]
    assert speeds[0] == Limits().speed > speeds[1] > speeds[2] > 0


@given(st.floats(-0.2, 0.2), st.floats(-2, 2), st.floats(0.05, 0.3))
def test_wheel_speeds_make_the_motion(speed, turn_rate, base):
    left, right = Motion(speed, turn_rate).wheels(base)
    assert (left + right) / 2 == pytest.approx(speed)
    assert (right - left) / base == pytest.approx(turn_rate)


def test_a_loop_of_waypoints_is_followed_within_three_centimetres():
    track = follow(WaypointDriver(LOOP), Pose(0, 0, 0.4), 120)
    corners = [(0.0, 0.0), *LOOP]
    lines = list(pairwise(corners))
    assert max(min(distance_to_line((p.x, p.y), *line) for line in lines) for p in track) < 0.03
    for x, y in LOOP:
        assert min(math.hypot(p.x - x, p.y - y) for p in track) <= ARRIVED


def test_done_is_done():
    driver = WaypointDriver([(0.0, 0.0)])
    assert driver.drive(0.0, Pose(), NOTHING) == STILL
    assert driver.done
    assert driver.given_up == []
    assert WaypointDriver([]).done


def test_a_robot_that_learns_that_it_is_elsewhere_drives_to_the_same_waypoints_from_there():
    driver = WaypointDriver([(1.0, 0.0)])
    assert driver.drive(0.0, Pose(), NOTHING).turn_rate == 0.0
    driver.placed(Pose(0.0, 0.0, math.pi / 2))
    assert driver.drive(0.1, Pose(0.0, 0.0, math.pi / 2), NOTHING).turn_rate < 0.0


def test_a_robot_without_a_driver_stands_and_is_never_done():
    assert NoDriver().drive(0.0, Pose(), NOTHING) == STILL
    assert not NoDriver().done


# What stands ahead


def test_only_what_lies_on_the_way_counts():
    limits = Limits()
    points = np.array([[0.3, 0.02], [0.2, limits.half_width + 0.001], [-0.1, 0.0], [0.5, 0.0]])
    assert room_ahead(points, limits) == 0.3
    assert room_ahead(NOTHING, limits) == math.inf


@given(st.floats(0.01, 0.5), st.floats(-0.07, 0.07))
def test_the_nearer_the_slower_and_never_beyond_the_stop(ahead, aside):
    limits, wanted = Limits(), Motion(0.1, 0.5)
    got = held_back(wanted, np.array([[ahead, aside]]), limits)
    assert got.turn_rate == wanted.turn_rate
    assert 0 <= got.speed <= wanted.speed
    assert got.speed == 0 if ahead <= limits.stop else got.speed > 0


def wall_at(x):
    """The front beam of a robot that looks at a wall across its way; and two that look at it slantwise."""

    def seen(stamp, pose):
        away = x - pose.x
        bearings = np.array([-math.pi / 4, 0, math.pi / 4]) + pose.yaw
        reach = away / np.cos(bearings)
        reach = reach[(np.cos(bearings) > 1e-6) & (reach < 0.8)]
        bearings = bearings[(np.cos(bearings) > 1e-6) & (away / np.cos(bearings) < 0.8)] - pose.yaw
        return np.stack([reach * np.cos(bearings), reach * np.sin(bearings)], axis=1)

    return seen


def test_it_stops_before_a_wall_and_gives_up_a_waypoint_behind_it():
    driver = WaypointDriver([(1.0, 0.0), (0.0, 0.0)])
    track = follow(driver, Pose(), 200, wall_at(0.6))
    assert max(pose.x for pose in track) < 0.6 - 0.085
    assert driver.given_up == [0]
    assert driver.done


def test_what_goes_away_in_time_costs_no_detour():
    driver = WaypointDriver([(1.0, 0.0)])
    late = BLOCKED_AFTER / 2

    def seen(stamp, pose):
        return np.array([[0.09, 0.0]]) if 2 < stamp < 2 + late else NOTHING

    track = follow(driver, Pose(), 60, seen)
    assert driver.done
    assert driver.given_up == []
    assert max(abs(pose.y) for pose in track) < 0.01


def test_it_says_what_keeps_it():
    driver = WaypointDriver([(1.0, 0.0)])
    driver.drive(0.0, Pose(), NOTHING)
    assert driver.status == ""
    driver.drive(0.1, Pose(), np.array([[0.09, 0.0]]))
    assert driver.status == "something stands before waypoint 1"


def test_a_post_in_the_way_is_gone_round_on_the_right_first():
    """A thin post that only the front beam meets."""
    driver = WaypointDriver([(1.0, 0.0)])

    def seen(stamp, pose):
        ((x, y),) = pose.inverse().apply(np.array([[0.5, 0.0]])).tolist()
        return np.array([[x, y]]) if math.hypot(x, y) < 0.8 else NOTHING

    track = follow(driver, Pose(), 200, seen)
    assert driver.done
    assert driver.given_up == []
    assert min(math.hypot(pose.x - 0.5, pose.y) for pose in track) > 0.06
    assert min(pose.y for pose in track) < -0.1


def test_two_robots_that_meet_head_on_pass_each_other(arena):
    goals = [(1.6, 0.0), (-0.1, 0.0)]
    walls = [[-0.5, -0.8, 2.0, -0.8], [2.0, -0.8, 2.0, 0.8], [2.0, 0.8, -0.5, 0.8], [-0.5, 0.8, -0.5, -0.8]]
    place = arena(walls, [Pose(0, 0, 0), Pose(1.5, 0, math.pi)], lambda robot: WaypointDriver([goals[robot.index]]))
    place.run(150, lambda: all(robot.body.done for robot in place.robots))
    assert [robot.driver.given_up for robot in place.robots] == [[], []]
    assert all(robot.body.done for robot in place.robots)
    assert place.simulator.collisions.tolist() == [0, 0]
