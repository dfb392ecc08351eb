"""Team-mates are not walls: what falls on whom, and two robots that look at each other."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.driver import ROBOT_RADIUS, Motion, WaypointDriver
from agent.team_mates import MARGIN, TeamMates, falls_on, without
from agent.tracks import WINDOW_MS
from mapping.evidence import EvidenceModel, occupied
from mapping.grid import Grid
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import FULL_TURN, Pose, QuantisedPose
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Beam, Sensor, orion
from mapping.tiles import map_digest, summed
from swarm.messages import Update
from swarm.scan_block import encode_scans
from swarm.session import Descriptor, Rules

LATTICE = Lattice(20)
MODEL = EvidenceModel()
ORIGIN = QuantisedPose(0, 0, 0)
STARTS = [Pose(0, 0, 0), Pose(1.0, 0, math.pi)]
WALLS = [[-0.5, -0.6, 1.5, -0.6], [1.5, -0.6, 1.5, 0.6], [1.5, 0.6, -0.5, 0.6], [-0.5, 0.6, -0.5, -0.6]]


def scans(*rows):
    """Rows of stamp, (x, y, yaw), ranges."""
    stamps, poses, ranges = zip(*rows, strict=True)
    return Scans(np.array(stamps, np.int64), np.array(poses, np.int32), np.array(ranges, np.uint16))


def descriptor(robot, session=b"mate-ses", start=ORIGIN):
    return Descriptor(robot, session, Rules(LATTICE, MODEL), orion(), start)


def says(mates, *track, robot="r2", session=b"mate-ses"):
    """A team-mate's update with its poses: stamp, x, y in mm."""
    block = encode_scans(scans(*((stamp, (x, y, 0), [NO_RETURN] * 5) for stamp, x, y in track)))
    mates(descriptor(robot, session), Update(session, 1, Update.SCANS, block, b"", 0))


def facing(stamp=1000, ahead=400):
    """A scan of a robot in the origin that faces +x and reads ``ahead`` mm in front, nothing else."""
    return scans((stamp, (0, 0, 0), [NO_RETURN, NO_RETURN, ahead, NO_RETURN, NO_RETURN]))


def mates_of(sensor=None):
    return TeamMates("r1", sensor or orion())


def masked(mates, scans):
    return without(scans, mates.masks(scans)).ranges.tolist()


def phantoms(robot):
    """How many occupied cells lie where only robots were: farther than 5 cm from every wall."""
    grid = Grid.of(robot.cells, LATTICE)
    x, y = grid.centres(occupied(grid.evidence)).T
    return int((np.minimum.reduce([x + 0.5, 1.5 - x, y + 0.6, 0.6 - y]) > 0.05).sum())


# What falls on whom


@given(
    st.tuples(st.integers(-2000, 2000), st.integers(-2000, 2000), st.integers(0, 65535)),
    st.lists(st.one_of(st.integers(1, 800), st.sampled_from([INVALID, NO_RETURN])), min_size=5, max_size=5),
    st.tuples(st.integers(-900, 900), st.integers(-900, 900)),
    st.sampled_from([0, 500, 2276]),
)
def test_a_reading_falls_on_a_robot_if_a_place_it_may_come_from_is_within_its_footprint(pose, ranges, offset, width):
    sensor = Sensor(tuple(beam._replace(half_width_turn16=width) for beam in orion().beams), 800)
    mate = np.array([[pose[0] + offset[0], pose[1] + offset[1]]], float)
    (got,) = falls_on(np.array([pose], np.int32), np.array([ranges], np.uint16), sensor, mate)
    limit = (ROBOT_RADIUS + MARGIN) * 1000
    for beam, reading, fell in zip(sensor.beams, ranges, got.tolist(), strict=True):
        if reading in {INVALID, NO_RETURN}:
            assert not fell
            continue
        yaw = pose[2] / FULL_TURN * math.tau
        x0 = pose[0] + beam.x_mm * math.cos(yaw)
        y0 = pose[1] + beam.x_mm * math.sin(yaw)
        aside = np.linspace(-width, width, 401) / FULL_TURN * math.tau
        angles = yaw + beam.bearing_turn16 / FULL_TURN * math.tau + aside
        ends = np.stack([x0 + reading * np.cos(angles), y0 + reading * np.sin(angles)], -1)
        nearest = np.hypot(*(ends - mate).T).min()
        assert fell == (nearest <= limit) or abs(nearest - limit) < 0.5


@given(
    st.lists(
        st.tuples(
            st.tuples(st.integers(-2000, 2000), st.integers(-2000, 2000), st.integers(0, 65535)),
            st.tuples(st.integers(-900, 900), st.integers(-900, 900)),
        ),
        min_size=1,
        max_size=20,
    )
)
def test_scan_by_scan_or_all_at_once_the_same_readings_fall(pairs):
    poses = np.array([pose for pose, _ in pairs], np.int32)
    points = np.array([(pose[0] + offset[0], pose[1] + offset[1]) for pose, offset in pairs], float)
    ranges = np.full((len(pairs), 5), 400, np.uint16)
    together = falls_on(poses, ranges, orion(), points)
    for k in range(len(pairs)):
        rows = slice(k, k + 1)
        assert together[k].tolist() == falls_on(poses[rows], ranges[rows], orion(), points[rows])[0].tolist()


# What a robot knows


def test_a_reading_on_a_team_mate_is_invalid():
    mates = mates_of()
    says(mates, (950, 490, 0))
    assert masked(mates, facing()) == [[NO_RETURN, NO_RETURN, INVALID, NO_RETURN, NO_RETURN]]


@pytest.mark.parametrize(
    ("stamp", "is_masked"), [(1000 - WINDOW_MS, True), (1000 + WINDOW_MS, True), (1001 + WINDOW_MS, False)]
)
def test_a_pose_counts_within_the_window(stamp, is_masked):
    mates = mates_of()
    says(mates, (stamp, 490, 0))
    says(mates, (1000, 2000, 0))  # where it is at that very time counts as well
    assert (masked(mates, facing())[0][2] == INVALID) == is_masked


def test_a_team_mate_that_says_nothing_stands_where_it_was():
    mates = mates_of()
    says(mates, (0, 490, 0))
    assert masked(mates, facing(60_000))[0][2] == INVALID


def test_a_team_mate_that_has_gone_on_is_no_longer_there():
    mates = mates_of()
    says(mates, (0, 490, 0), (30_000, 2000, 0))
    assert masked(mates, facing(60_000))[0][2] == 400


def test_a_team_mate_that_was_started_again_stands_only_where_it_is_now():
    mates = mates_of()
    says(mates, (0, 490, 0), session=b"earlier.")
    says(mates, (30_000, 2000, 0), session=b"restart.")
    assert masked(mates, facing(10_000))[0][2] == INVALID
    assert masked(mates, facing(60_000))[0][2] == 400


def test_the_wall_beside_a_team_mate_is_still_a_wall():
    mates = mates_of()
    says(mates, (1000, 490, 250))
    assert masked(mates, facing())[0][2] == 400


def test_ones_own_sessions_and_those_without_a_start_are_no_team_mates():
    mates = mates_of()
    says(mates, (1000, 490, 0), robot="r1")
    block = encode_scans(scans((1000, (490, 0, 0), [NO_RETURN] * 5)))
    mates(descriptor("r2", start=None), Update(b"mate-ses", 1, Update.SCANS, block, b"", 0))
    assert masked(mates, facing())[0][2] == 400
    assert mates.positions().shape == (0, 2)


def test_poses_come_out_of_trails_too_and_changed_cells_have_none():
    mates = mates_of()
    trail = encode_scans(Scans(np.array([1000]), np.array([[490, 0, 0]], np.int32), np.zeros((1, 0), np.uint16)))
    mates(descriptor("r2"), Update(b"mate-ses", 1, Update.TILES, b"", trail, 0))
    mates(descriptor("r2"), Update(b"mate-ses", 2, Update.CELLS, b"", b"", 0))
    assert mates.positions().tolist() == [[0.49, 0.0]]
    assert masked(mates, facing())[0][2] == INVALID


def test_what_cannot_be_read_is_counted():
    mates = mates_of()
    mates(descriptor("r2"), Update(b"mate-ses", 1, Update.SCANS, b"garbage", b"", 0))
    assert mates.counters["bad_poses"] == 1


def test_a_replaced_session_takes_its_track_with_it_and_another_one_brings_its_own():
    mates = mates_of()
    says(mates, (1000, 490, 0))
    mates.news()
    mates.replaced(b"mate-ses")
    assert masked(mates, facing())[0][2] == 400
    assert any(first <= 1000 <= last for first, last in mates.news())
    says(mates, (1100, 490, 0), session=b"mates-2.")
    assert masked(mates, facing())[0][2] == INVALID
    assert len(mates.news()) == 1
    mates.replaced(b"mate-ses")
    assert mates.news() == []


def test_news_tell_when_the_readings_were_that_they_concern():
    mates = mates_of()
    says(mates, (1000, 490, 0), (5000, 490, 0))
    assert [span.first_ms for span in mates.news()] == [1000 - WINDOW_MS]
    says(mates, (2000, 490, 0))
    assert [tuple(span) for span in mates.news()] == [(2000 - WINDOW_MS, 5000 + WINDOW_MS)]
    assert mates.news() == []


def test_a_wide_beam_that_meets_a_team_mate_at_its_edge_is_masked():
    sensor = Sensor((Beam(30, 0, 0, 2276),), 800)
    mates = mates_of(sensor)
    says(mates, (1000, 430, 170))  # its side is 12 degrees off the axis, its centre outside of the cone
    assert masked(mates, scans((1000, (0, 0, 0), [400]))) == [[INVALID]]


# Two robots that face each other


def patrol(robot):
    """Each to and fro before the other's eyes."""
    there, here = ((0.3, 0.1), (0.0, 0.0)) if robot.index == 0 else ((0.7, -0.1), (1.0, 0.0))
    return WaypointDriver([there, here] * 2)


def meeting(arena, **options):
    place = arena(WALLS, STARTS, patrol, **options)
    place.run(60, lambda: all(robot.body.done for robot in place.robots))
    place.settle()
    return place


def test_without_masking_robots_draw_each_other_as_walls_and_with_it_they_do_not(arena):
    without, masked = meeting(arena, masks=False), meeting(arena)
    assert all(phantoms(robot) > 5 for robot in without.robots)
    assert all(phantoms(robot) == 0 for robot in masked.robots)


def knew_all_along(one, two):
    """The digests of the maps of two robots that had these start poses and each other's poses from the beginning."""
    sensed = [
        robot.own.journal.scans(QuantisedPose.of(start), slice(None))
        for robot, start in zip((one, two), STARTS, strict=True)
    ]
    digests = []
    for robot, own, others in ((one, *sensed), (two, *reversed(sensed))):
        mates = TeamMates(robot.name, robot.sensor)
        mates(descriptor("mate"), Update(b"mate-ses", 1, Update.SCANS, encode_scans(others), b"", 0))
        knew = without(own, mates.masks(own))
        digests.append(map_digest(integrated({}, knew, robot.sensor, MODEL, LATTICE)))
    return digests


@pytest.mark.parametrize("delay", [0, 2, 30])
def test_robots_that_hear_late_of_each_other_end_up_as_if_they_had_known_in_time(arena, delay):
    """3 s late is far beyond the window: the phantoms are there until the news come."""
    place = meeting(arena, delay=delay)
    one, two = place.robots
    assert one.peer.fusion.digest() == two.peer.fusion.digest()
    for robot in (one, two):
        assert robot.own.counters["corrected"] > 0 or delay < 30
        assert phantoms(robot) == 0
    assert [map_digest(robot.cells) for robot in (one, two)] == knew_all_along(one, two)


class Shuttle:
    """To and fro, wherever it believes to be."""

    done, status = False, ""

    def drive(self, stamp, pose, points):
        return Motion(0.1 if int(stamp / 2) % 2 == 0 else -0.1, 0.0)

    def placed(self, T_after_before):
        pass


WRONG = [Pose(0.8, -0.55, 0.2), Pose(0.3, 0.6, math.pi - 0.2)]  # on walls that the other one sees


@pytest.mark.parametrize(
    "believed",
    [(STARTS[0], WRONG[1]), (STARTS[0], None), (WRONG[0], None)],
    ids=["one wrong", "one unknown", "one wrong, one unknown"],
)
@pytest.mark.parametrize("delay", [0, 5])
def test_after_any_corrections_the_map_is_that_of_robots_that_had_every_start_pose_right_from_the_start(
    arena, believed, delay
):
    """The law. Both see each other all the time, so each one's map depends on where the other says that it is."""
    place = arena(WALLS, STARTS, lambda robot: Shuttle(), believed=believed, delay=delay)
    one, two = place.robots
    place.run(6)
    place.settle()
    right = knew_all_along(one, two)
    assert all(map_digest(robot.cells) != digest for robot, digest in zip((one, two), right, strict=True))
    one.peer.set_start_pose("r2", QuantisedPose.of(WRONG[1]), place.now)  # the operator errs
    place.run(0.3)
    for robot, start, was in zip((one, two), STARTS, believed, strict=True):
        if was != start:
            one.peer.set_start_pose(robot.name, QuantisedPose.of(start), place.now)
    place.run(6)
    place.settle()
    assert all(robot.own.settled for robot in (one, two))
    assert [map_digest(robot.cells) for robot in (one, two)] == knew_all_along(one, two)
    assert phantoms(one) == phantoms(two) == 0
    assert one.peer.fusion.digest() == two.peer.fusion.digest() == map_digest(summed([one.cells, two.cells]))
