"""The body behind a serial line: from frames to scans and drives, through silence, restarts and strangers."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from agent.body import BATCH
from agent.driver import ARRIVED, Motion, NoDriver, WaypointDriver
from agent.errors import UserError
from agent.senses import NO_NOISE, Noise
from agent.serial_body import SerialBody, greet
from mapping.grid import Grid
from mapping.pose import Pose, QuantisedPose
from mapping.scan import INVALID, NO_RETURN
from mapping.score import score
from mapping.sensor import ORION_OFFSET, orion
from transport import mcu_frames
from transport.mcu_frames import RANGE_INVALID, RANGE_NOTHING, RANGE_VALID, Hello, Range, Sample
from transport.mcu_link import LinkBack, LinkLost, Stalled

HELLO = Hello(1, 10_000, 100_000, 100, 1200, 3, 0, tuple(mcu_frames.Beam(*beam) for beam in orion().beams))
START = QuantisedPose.of(Pose(1.0, 2.0, math.pi / 2))
FAR = (Range(0, RANGE_NOTHING),) * 5
LOOP = [(1.0, 0.0), (1.0, 0.7), (0.0, 0.7), (0.0, 0.0)]
ROOM = [[-0.5, -0.5, 1.5, -0.5], [1.5, -0.5, 1.5, 1.2], [1.5, 1.2, -0.5, 1.2], [-0.5, 1.2, -0.5, -0.5]]


def sample(k, left=0, right=None, *, ranges=FAR, stamp_ms=None, heading=0, valid=0):
    """The k-th of ten a second."""
    right = left if right is None else right
    return Sample(k % 65536, 100 * k if stamp_ms is None else stamp_ms, left, right, heading, valid, ranges)


class Clock:
    unix_ms = 1_790_000_000_000
    seconds = 0.0


class Going:
    """A driver that always goes on."""

    done = False
    status = ""

    def drive(self, stamp, pose, points):
        self.seen = stamp, pose, points
        return Motion(0.1, 0.5)

    def placed(self, T_after_before):
        self.moved = T_after_before


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def body_of(link, clock):
    def make(hello=HELLO, **options):
        body = SerialBody(link, hello, unix_ms=lambda: clock.unix_ms, monotonic=lambda: clock.seconds, **options)
        body.place(START)
        return body

    return make


def scans(readings):
    """As the robot publishes them."""
    return readings.scans(START, orion())


# Readings


def test_samples_become_readings_in_the_start_frame_and_scans_in_the_common_one(link, body_of):
    """10 cm straight on from a start that faces +y."""
    body = body_of()
    link.inbox = [sample(0), sample(1, 1000, ranges=(Range(200, RANGE_VALID), *FAR[:3], Range(9, RANGE_INVALID)))]
    readings = body.read(math.inf)
    assert readings.poses.tolist() == [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
    np.testing.assert_array_equal(readings.ranges[1], [0.2, np.inf, np.inf, np.inf, np.nan])
    assert scans(readings).poses.tolist() == [[1000, 2000, 16384], [1000, 2100, 16384]]
    assert scans(readings).ranges[1].tolist() == [200, NO_RETURN, NO_RETURN, NO_RETURN, INVALID]
    assert body.sensor == orion()
    assert len(body.read(math.inf)) == 0


def test_a_turn_of_the_wheels_is_a_turn_of_the_robot(link, body_of):
    body = body_of()
    quarter = round(math.pi / 2 * 0.05 * 10_000)
    link.inbox = [sample(0), sample(1, -quarter, quarter)]
    assert scans(body.read(0)).poses[1].tolist() == pytest.approx([1000, 2000, 32768], abs=20)


def test_stamps_are_the_computers_time_where_the_robot_knows_none_and_else_swarm_time(link, body_of, clock):
    body = body_of()
    link.inbox = [sample(5), sample(6)]
    assert body.read(0).stamps_ms.tolist() == [clock.unix_ms, clock.unix_ms + 100]
    body = body_of(replace(HELLO, clock_ms=1_000_000))
    link.inbox = [sample(5), sample(6)]
    assert body.read(0).stamps_ms.tolist() == [1_000_500, 1_000_600]


def test_a_backlog_is_given_in_batches_without_loss(link, body_of):
    body = body_of()
    link.inbox = [sample(k) for k in range(BATCH + 10)]
    assert [len(body.read(0)) for _ in range(3)] == [BATCH, 10, 0]
    assert body.progress == (BATCH + 10, 0)


def test_a_robot_that_is_placed_anew_is_elsewhere_and_its_readings_are_what_they_were(link, body_of):
    driver = Going()
    body = body_of(driver=driver)
    link.inbox = [sample(0), sample(1, 1000)]
    before = body.read(0)
    body.place(QuantisedPose(0, 0, 0))
    assert body.pose == Pose(0.1, 0.0, 0.0)
    assert driver.moved.apply(np.array([1.0, 2.1])).tolist() == pytest.approx([0.1, 0.0])
    link.inbox = [sample(2, 2000)]
    after = body.read(0)
    assert np.concatenate([before.poses, after.poses])[:, 0].tolist() == pytest.approx([0.0, 0.1, 0.2])
    assert driver.seen[1] == body.pose


def test_what_a_robot_senses_that_is_lost_in_space_is_counted_and_dropped(link, body_of):
    body = body_of(replace(HELLO, ticks_per_metre=1))
    link.inbox = [sample(k, k * 2**30) for k in range(2)]
    body._is_jump = lambda *_: False
    assert len(body.read(0)) == 1
    assert body.counters["bad_pose"] == 1


# Drives


def test_the_newest_sample_is_answered_by_the_drivers_wish(link, body_of):
    driver = Going()
    body = body_of(driver=driver)
    link.inbox = [sample(7), sample(8, ranges=(*FAR[:2], Range(300, RANGE_VALID), *FAR[:2]))]
    body.read(0)
    (drive,) = link.drives
    assert (drive.answers, drive.left_mm_s, drive.right_mm_s) == (8, 75, 125)
    assert drive.valid_ms == 300
    _, pose, points = driver.seen
    assert pose == body.pose
    np.testing.assert_allclose(points, [[0.3 + ORION_OFFSET, 0.0]])


def test_a_robot_without_a_driver_is_told_to_stand_and_is_never_done(link, body_of):
    body = body_of(driver=NoDriver())
    link.inbox = [sample(0)]
    body.read(0)
    assert [(drive.left_mm_s, drive.right_mm_s) for drive in link.drives] == [(0, 0)]
    assert not body.done


def test_no_sample_no_drive(link, body_of):
    body = body_of(driver=Going())
    link.inbox = [LinkBack(), HELLO, Stalled(0.6)]
    body.read(0)
    assert link.drives == []


def test_a_slow_sampler_is_told_for_longer(link, body_of):
    body = body_of(replace(HELLO, sample_period_ms=250), driver=Going())
    link.inbox = [sample(0)]
    body.read(0)
    assert link.drives[0].valid_ms == 750


def test_done_is_when_the_driver_is_and_all_is_read(link, body_of):
    body = body_of(driver=WaypointDriver([(1.0, 2.0)]))
    assert not body.done
    link.inbox = [sample(k) for k in range(BATCH + 1)]
    body.read(0)
    assert not body.done
    body.read(0)
    assert body.done


def test_closing_closes_the_line(link, body_of):
    body_of().close()
    assert link.closed


# Trouble


def test_silence_is_told_and_over_when_samples_come_again(link, body_of):
    body = body_of()
    link.inbox = [sample(0)]
    body.read(0)
    assert body.status == ""
    link.inbox = [Stalled(0.62)]
    body.read(0)
    assert body.status == "the robot has sent no sample for 0.6 s"
    link.inbox = [LinkLost("unplugged")]
    body.read(0)
    assert body.status == "the robot is not connected: unplugged"
    link.inbox = [LinkBack()]
    body.read(0)
    assert body.status == "waits for the robot's first sample"
    link.inbox = [sample(9, 500)]
    assert scans(body.read(0)).poses[0].tolist() == [1000, 2050, 16384]
    assert body.status == ""


def test_the_drivers_trouble_is_told(link, body_of):
    driver = Going()
    driver.status = "lost its way"
    body = body_of(driver=driver)
    link.inbox = [sample(0)]
    body.read(0)
    assert body.status == "lost its way"


@pytest.mark.parametrize("again", [sample(0, -7), sample(0, 2**31 - 1)])
def test_a_restarted_microcontroller_does_not_move_the_robot(link, body_of, again):
    body = body_of()
    link.inbox = [sample(600), sample(601, 1000), again, replace(again, sequence=1, stamp_ms=100)]
    assert scans(body.read(0)).poses[1:].tolist() == [[1000, 2100, 16384]] * 3
    assert body.counters["restarts"] == 1


def test_ticks_that_no_wheel_could_roll_do_not_move_the_robot(link, body_of):
    body = body_of()
    link.inbox = [sample(0, 50_000), sample(1, 0), sample(2, 1000)]
    assert scans(body.read(0)).poses[:, 1].tolist() == [2000, 2000, 2100]


def test_a_restart_during_an_outage_does_not_move_the_robot(link, body_of, clock):
    body = body_of()
    link.inbox = [sample(30, 400)]
    body.read(0)
    clock.seconds = 60.0
    link.inbox = [LinkLost("unplugged"), LinkBack(), sample(50, 0)]
    assert scans(body.read(0)).poses[0].tolist() == [1000, 2000, 16384]
    assert body.counters["restarts"] == 1


def test_a_robot_that_became_another_one_is_refused_until_it_is_itself_again(link, body_of):
    body = body_of()
    other = replace(HELLO, beams=HELLO.beams[:4])
    link.inbox = [sample(0), other, sample(1, ranges=FAR[:4]), sample(2)]
    assert len(body.read(0)) == 1
    assert body.counters["other_sensor"] == 2
    assert "other sensors" in body.status
    link.inbox = [HELLO, sample(3)]
    assert len(body.read(0)) == 1
    assert body.status == ""


def test_a_robot_with_other_wheels_is_another_one(link, body_of):
    body = body_of()
    link.inbox = [replace(HELLO, ticks_per_metre=9999), sample(0)]
    assert len(body.read(0)) == 0


# Greeting


def test_the_hello_is_waited_for(link):
    link.inbox = [LinkBack(), sample(0), HELLO]
    assert greet(link, 1.0) == HELLO


@pytest.mark.parametrize(
    ("inbox", "reason"),
    [([], "nothing came"), ([LinkLost("no such port")], "no such port"), ([sample(0)], "samples come, but no hello")],
)
def test_who_never_greets_is_told_of_with_the_remedy(link, inbox, reason):
    link.inbox = inbox
    with pytest.raises(UserError, match=reason) as error:
        greet(link, 0.01, where="/dev/ttyACM0")
    assert error.value.where == "/dev/ttyACM0"


# The closed loop


@pytest.mark.parametrize("noise", [NO_NOISE, Noise()])
def test_a_loop_of_waypoints_is_driven_and_the_robot_knows_where_it_is(arena, noise):
    """Ideal sensors: within 3 cm of every line. A well-kept Orion: within 6 cm, on its own reckoning alone."""
    allowed = 0.03 if noise is NO_NOISE else 0.06
    place = arena(ROOM, [Pose(0, 0, 0)], lambda robot: WaypointDriver(LOOP), noise=noise)
    (robot,) = place.robots
    place.run(90, lambda: robot.body.done)
    assert robot.body.done
    assert robot.driver.given_up == []
    truth = np.array(place.simulator.truth)[:, 0]
    corners = np.array([(0.0, 0.0), *LOOP])
    off = []
    for a, b in pairwise(corners):
        share = np.clip((truth[:, :2] - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        off.append(np.hypot(*(truth[:, :2] - a - share[:, None] * (b - a)).T))
    assert np.min(off, axis=0).max() < allowed
    for x, y in LOOP:
        assert np.hypot(*(truth[:, :2] - (x, y)).T).min() < allowed
    error = math.hypot(robot.body.pose.x - truth[-1, 0], robot.body.pose.y - truth[-1, 1])
    assert error < (0.001 if noise is NO_NOISE else allowed)
    assert place.simulator.collisions.tolist() == [0]
    assert math.hypot(robot.body.pose.x, robot.body.pose.y) <= ARRIVED + 0.01


def test_the_map_of_wide_beams_keeps_its_walls(arena):
    """One loop through a room, readings and poses noisy. Fans whose middle ray alone marked its end kept 0.50 of the
    walls, those that mark the inner half 0.77; a thin ray, which knows where its echo came from, 0.94."""

    sensor = orion(view=math.radians(25))
    place = arena(ROOM, [Pose(0, 0, 0)], lambda robot: WaypointDriver(LOOP), sensor=sensor, noise=Noise())
    (robot,) = place.robots
    place.run(90, lambda: robot.body.done)
    place.settle()
    worth = score(Grid.of(robot.cells, robot.rules.lattice), np.array(ROOM), 0.04)
    assert worth.recall > 0.7
    assert worth.precision > 0.8


def test_a_robot_whose_microcontroller_restarts_on_the_way_closes_its_loop(arena):
    place = arena(ROOM, [Pose(0, 0, 0)], lambda robot: WaypointDriver(LOOP))
    (robot,) = place.robots
    place.run(12)
    before = place.simulator.now_ms
    offset = np.array([5000, -3000])
    restarted = robot.mcu.sample

    def sample_anew(readings):
        """Stamps, counters and heading begin elsewhere."""
        return restarted(replace(readings, stamp_ms=readings.stamp_ms - before, ticks=readings.ticks + offset))

    robot.mcu.sample = sample_anew
    place.run(90, lambda: robot.body.done)
    truth = np.array(place.simulator.truth)[:, 0]
    assert robot.body.counters["restarts"] == 1
    assert math.hypot(robot.body.pose.x - truth[-1, 0], robot.body.pose.y - truth[-1, 1]) < 0.03


@pytest.mark.parametrize(("period_ms", "valid_ms"), [(1, 300), (100, 300), (200, 600), (1000, 1000), (65_535, 1000)])
def test_a_drive_holds_for_two_lost_samples_and_never_for_long(body_of, link, period_ms, valid_ms):
    """A robot that sensed every 22 s was to be told to drive for longer than a frame can say, which ended its agent."""
    body = body_of(replace(HELLO, sample_period_ms=period_ms), driver=Going())
    link.inbox.append(sample(0))
    body.read(0.0)
    (drive,) = link.drives
    assert drive.valid_ms == valid_ms
    mcu_frames.encode(drive)
