"""Team-mates are not walls: two robots that look at each other, with and without masking, in time and late."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.driver import ROBOT_RADIUS, WaypointDriver
from agent.team_mates import MARGIN, WINDOW_MS, TeamMates, falls_on
from mapping.evidence import EvidenceModel, occupied
from mapping.grid import Grid
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import FULL_TURN, Pose, QuantisedPose
from mapping.raster import raster
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Beam, Sensor, orion
from mapping.tiles import map_digest
from swarm.messages import Update
from swarm.replica import Replica
from swarm.scan_block import encode_scans
from swarm.session import Descriptor, Rules
from swarm.writer import Writer

LATTICE = Lattice(20)
MODEL = EvidenceModel()
ORIGIN = QuantisedPose(0, 0, 0)
WALLS = [[-0.5, -0.6, 1.5, -0.6], [1.5, -0.6, 1.5, 0.6], [1.5, 0.6, -0.5, 0.6], [-0.5, 0.6, -0.5, -0.6]]


def scans(*rows):
    """Rows of stamp, (x, y, yaw), ranges."""
    stamps, poses, ranges = zip(*rows, strict=True)
    return Scans(np.array(stamps, np.int64), np.array(poses, np.int32), np.array(ranges, np.uint16))


def descriptor(robot, session=b"mate-ses", start=ORIGIN):
    return Descriptor(robot, session, Rules(LATTICE, MODEL), orion(), start)


def says(mates, *track, robot="r2"):
    """A team-mate's update with its poses: stamp, x, y in mm."""
    block = encode_scans(scans(*((stamp, (x, y, 0), [NO_RETURN] * 5) for stamp, x, y in track)))
    mates(descriptor(robot), Update(b"mate-ses", 1, Update.SCANS, block, b"", 0))


def facing(stamp=1000, ahead=400):
    """A scan of a robot in the origin that faces +x and reads ``ahead`` mm in front, nothing else."""
    return scans((stamp, (0, 0, 0), [NO_RETURN, NO_RETURN, ahead, NO_RETURN, NO_RETURN]))


def mates_of(model=MODEL, sensor=None):
    return TeamMates("r1", sensor or orion(), model, LATTICE)


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
    got = falls_on(np.array(pose, np.int32), np.array(ranges, np.uint16), sensor, mate)
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


# In time


def test_a_reading_on_a_team_mate_is_invalid_before_it_is_published():
    mates = mates_of()
    says(mates, (950, 490, 0))
    assert mates.masked(facing()).ranges.tolist() == [[NO_RETURN, NO_RETURN, INVALID, NO_RETURN, NO_RETURN]]
    assert mates.counters["masked"] == 1
    assert mates.corrections({}) == {}


@pytest.mark.parametrize(
    ("stamp", "is_masked"), [(1000 - WINDOW_MS, True), (1000 + WINDOW_MS, True), (1001 + WINDOW_MS, False)]
)
def test_a_pose_counts_within_the_window(stamp, is_masked):
    mates = mates_of()
    says(mates, (stamp, 490, 0))
    says(mates, (1000, 2000, 0))  # where it is at that very time counts as well
    assert (mates.masked(facing()).ranges[0, 2] == INVALID) == is_masked


def test_a_team_mate_that_says_nothing_stands_where_it_was():
    mates = mates_of()
    says(mates, (0, 490, 0))
    assert mates.masked(facing(60_000)).ranges[0, 2] == INVALID


def test_a_team_mate_that_has_gone_on_is_no_longer_there():
    mates = mates_of()
    says(mates, (0, 490, 0), (30_000, 2000, 0))
    assert mates.masked(facing(60_000)).ranges[0, 2] == 400


def test_the_wall_beside_a_team_mate_is_still_a_wall():
    mates = mates_of()
    says(mates, (1000, 490, 250))
    assert mates.masked(facing()).ranges[0, 2] == 400


def test_ones_own_sessions_and_those_without_a_start_are_no_team_mates():
    mates = mates_of()
    says(mates, (1000, 490, 0), robot="r1")
    block = encode_scans(scans((1000, (490, 0, 0), [NO_RETURN] * 5)))
    mates(descriptor("r2", start=None), Update(b"mate-ses", 1, Update.SCANS, block, b"", 0))
    assert mates.masked(facing()).ranges[0, 2] == 400
    assert mates.positions().shape == (0, 2)


def test_poses_come_out_of_trails_too_and_changed_cells_have_none():
    mates = mates_of()
    trail = encode_scans(Scans(np.array([1000]), np.array([[490, 0, 0]], np.int32), np.zeros((1, 0), np.uint16)))
    mates(descriptor("r2"), Update(b"mate-ses", 1, Update.TILES, b"", trail, 0))
    mates(descriptor("r2"), Update(b"mate-ses", 2, Update.CELLS, b"", b"", 0))
    assert mates.positions().tolist() == [[0.49, 0.0]]
    assert mates.masked(facing()).ranges[0, 2] == INVALID


def test_what_cannot_be_read_is_counted():
    mates = mates_of()
    mates(descriptor("r2"), Update(b"mate-ses", 1, Update.SCANS, b"garbage", b"", 0))
    assert mates.counters["bad_poses"] == 1


# Late


def test_a_late_pose_is_corrected_to_what_it_would_have_been():
    late, in_time = mates_of(), mates_of()
    says(in_time, (1000, 490, 0))
    as_published = integrated({}, late.masked(facing()), orion(), MODEL, LATTICE)
    as_it_should_be = integrated({}, in_time.masked(facing()), orion(), MODEL, LATTICE)
    assert map_digest(as_published) != map_digest(as_it_should_be)
    says(late, (1000, 490, 0))
    corrected = {**as_published, **late.corrections(as_published)}
    assert map_digest(corrected) == map_digest(as_it_should_be)
    assert late.counters["corrected"] == 1
    assert late.corrections(corrected) == {}


def test_a_reading_that_was_masked_wrongly_comes_back():
    """The team-mate was believed to stand there still; late news tell that it had gone."""
    mates = mates_of()
    says(mates, (0, 490, 0))
    tiles = integrated({}, mates.masked(facing(5000)), orion(), MODEL, LATTICE)
    says(mates, (4000, 2000, 0))
    corrected = {**tiles, **mates.corrections(tiles)}
    assert map_digest(corrected) == map_digest(integrated({}, facing(5000), orion(), MODEL, LATTICE))


times = st.integers(0, 40).map(lambda k: k * 50)
tracks = st.lists(st.tuples(times, st.integers(300, 700), st.integers(-150, 150)), min_size=1, max_size=6)
own = st.lists(st.tuples(times, st.integers(200, 800)), min_size=1, max_size=10)


@given(own, tracks, st.randoms(use_true_random=False))
@settings(max_examples=60)
def test_whatever_comes_late_and_in_whatever_order_the_tiles_are_those_of_who_knew_in_time(readings, track, random_):
    """News in any order and mixture with own scans, corrections at any time, through a real writer and its replica."""
    readings = sorted(readings)
    track = list({stamp: (stamp, x, y) for stamp, x, y in track}.values())
    in_time, late = mates_of(), mates_of()
    for pose in track:
        says(in_time, pose)
    every = Scans.join([facing(*reading) for reading in readings])
    expected = integrated({}, in_time.masked(every), orion(), MODEL, LATTICE)

    replica = Replica(descriptor("r1", b"own-sess"), raster)
    writer = Writer(replica, raster, mtu=60_000)
    follower = Replica(replica.descriptor, raster)
    events = [("scan", reading) for reading in readings]
    for pose in random_.sample(track, len(track)):
        events.insert(random_.randrange(len(events) + 1), ("news", pose))
    for kind, event in [*events, ("end", None)]:
        if kind == "scan":
            writer.sense(late.masked(facing(*event)))
        elif kind == "news":
            says(late, event)
        if kind == "end" or random_.random() < 0.5:
            for update, _ in [*writer.updates(), *writer.correct(late.corrections(replica.state.cells))]:
                list(follower.offer(update))
    for update, _ in writer.correct(late.corrections(replica.state.cells)):
        list(follower.offer(update))
    assert map_digest(replica.state.cells) == map_digest(expected)
    assert map_digest(follower.state.cells) == map_digest(expected)


def test_under_a_limit_nothing_can_be_taken_back_and_it_is_counted():
    mates = mates_of(EvidenceModel(85, -40, 200))
    tiles = integrated({}, mates.masked(facing()), orion(), MODEL, LATTICE)
    says(mates, (1000, 490, 0))
    assert mates.corrections(tiles) == {}
    assert mates.counters["uncorrectable"] == 1
    says(mates, (1010, 495, 0))
    assert mates.corrections(tiles) == {}
    assert mates.counters["uncorrectable"] == 1


def test_the_journal_and_the_tracks_are_bounded():
    mates = mates_of()
    for minute in range(10):
        stamps = range(minute * 60_000, (minute + 1) * 60_000, 1000)
        says(mates, *((stamp, 2000, 0) for stamp in stamps))
        for stamp in stamps:
            mates.masked(facing(stamp))
    assert len(mates._sensed) <= 122
    assert len(mates._tracks["r2"].points) <= 130


# Two robots that face each other


def patrol(robot):
    """Each to and fro before the other's eyes."""
    there, here = ((0.3, 0.1), (0.0, 0.0)) if robot.index == 0 else ((0.7, -0.1), (1.0, 0.0))
    return WaypointDriver([there, here] * 2)


def meeting(arena, **options):
    place = arena(WALLS, [Pose(0, 0, 0), Pose(1.0, 0, math.pi)], patrol, **options)
    place.run(60, lambda: all(robot.body.done for robot in place.robots))
    place.settle()
    return place


def test_without_masking_robots_draw_each_other_as_walls_and_with_it_they_do_not(arena):
    without, masked = meeting(arena, masks=False), meeting(arena)
    assert all(phantoms(robot) > 5 for robot in without.robots)
    assert all(phantoms(robot) == 0 for robot in masked.robots)


@pytest.mark.parametrize("delay", [0, 2, 30])
def test_robots_that_hear_late_of_each_other_end_up_as_if_they_had_known_in_time(arena, delay):
    """3 s late is far beyond the window: the phantoms are there until the news come."""
    place = meeting(arena, delay=delay)
    one, two = place.robots
    assert one.peer.fusion.digest() == two.peer.fusion.digest()
    for robot, other in ((one, two), (two, one)):
        assert robot.mates.counters["corrected"] > 0 or delay < 30
        in_time = TeamMates(robot.name, robot.sensor, MODEL, LATTICE)
        every = Scans.join(other.mates._sensed)
        block = encode_scans(every)
        in_time(other.writer.replica.descriptor, Update(bytes([other.index] * 8), 1, Update.SCANS, block, b"", 0))
        knew = integrated({}, in_time.masked(Scans.join(robot.mates._sensed)), robot.sensor, MODEL, LATTICE)
        assert map_digest(robot.cells) == map_digest(knew)
        assert phantoms(robot) == 0


def test_a_wide_beam_that_meets_a_team_mate_at_its_edge_is_masked():
    sensor = Sensor((Beam(30, 0, 0, 2276),), 800)
    mates = mates_of(sensor=sensor)
    says(mates, (1000, 430, 170))  # its side is 12 degrees off the axis, its centre outside of the cone
    scan = scans((1000, (0, 0, 0), [400]))
    assert mates.masked(scan).ranges.tolist() == [[INVALID]]
