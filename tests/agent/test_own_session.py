"""A robot's own session: from its journal to the swarm, and right afterwards whatever was known when."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import agent.own_session
from agent.own_session import OWN_FRAME, OwnSession
from agent.readings import FARTHEST_START_MM, Readings
from agent.team_mates import NoMates, TeamMates, without
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import Pose, QuantisedPose
from mapping.raster import raster
from mapping.sensor import laser, orion
from mapping.tiles import map_digest
from swarm.limits import MAX_VISITS
from swarm.messages import Hello, Update
from swarm.peer import Peer
from swarm.scan_block import encode_scans
from swarm.session import Descriptor, Rules

LATTICE = Lattice(20)
ORIGIN = QuantisedPose(0, 0, 0)
ELSEWHERE = QuantisedPose(1230, -450, 9000)


class Body:
    """Something with a sensor that remembers where it was placed."""

    def __init__(self, sensor) -> None:
        self.sensor = sensor
        self.placed = []

    def place(self, start) -> None:
        self.placed.append(start)


class Robot:
    """r1 at work, and an observer who hears all that it says."""

    def __init__(self, start=ORIGIN, *, model=None, sensor=None, mates=None) -> None:
        rules = Rules(LATTICE, model or EvidenceModel())
        sensor = sensor or orion()
        self.body = Body(sensor)
        self.mates = TeamMates("r1", sensor) if mates is None else mates
        self.peer = self._peer(rules, Hello(Hello.ROBOT, b"r1", b"test"), self.mates)
        self.observer = self._peer(rules, Hello(Hello.OBSERVER, b"o", b"test"), lambda descriptor, update: None)
        self.own = OwnSession(self.peer, "r1", self.body, mates=self.mates, start=start, publish="auto", kernel=raster)
        self.now = 0.0

    @staticmethod
    def _peer(rules, hello, listener) -> Peer:
        return Peer(hello, rules, seed=hello.name, mtu=60_000, now=0.0, listener=listener)

    def sense(self, *rows) -> None:
        """Rows of stamp and what a robot at its start reads straight ahead, in millimetres."""
        self.own.journal.append(readings(*rows))

    def turn(self) -> None:
        """A turn of its loop."""
        self.now += 1.0
        self.own.publish()
        self._say()
        self.own.correct(self.now)
        self._say()

    def _say(self) -> None:
        for outgoing in self.peer.poll(self.now):
            self.observer.receive("r1", outgoing.payload, self.now)

    def settle(self) -> None:
        for _ in range(100):
            self.turn()
            if self.own.settled:
                return
        pytest.fail("it does not come to rest")

    @property
    def digest(self) -> bytes:
        return map_digest(self.own.writer.replica.state.cells)

    def hears(self, *track, session=b"mate-ses") -> None:
        """A team-mate's poses: stamp, x, y in millimetres of the common frame."""
        says(self.mates, *track, session=session)


def readings(*rows) -> Readings:
    ranges = np.full((len(rows), 5), np.inf)
    ranges[:, 2] = [ahead / 1000 for _, ahead in rows]
    return Readings(np.array([stamp for stamp, _ in rows], np.int64), np.zeros((len(rows), 3)), ranges)


def says(mates, *track, session=b"mate-ses") -> None:
    stamps, x, y = np.array(track, np.int64).T
    sensed = Readings(stamps, np.column_stack([x / 1000, y / 1000, 0 * x]), np.full((len(x), 5), np.inf))
    descriptor = Descriptor("r2", session, Rules(LATTICE, EvidenceModel()), orion(), ORIGIN)
    mates(descriptor, Update(session, 1, Update.SCANS, encode_scans(sensed.scans(ORIGIN, orion())), b"", 0))


def right_from_the_start(rows, track=(), start=ORIGIN) -> bytes:
    """The digest of a robot that knew all this in time."""
    mates = TeamMates("r1", orion())
    if track:
        says(mates, *track)
    scans = readings(*rows).scans(start, orion())
    return map_digest(integrated({}, without(scans, mates.masks(scans)), orion(), EvidenceModel(), LATTICE))


# Late news of a team-mate


def test_what_is_known_in_time_is_masked_before_it_is_published() -> None:
    robot = Robot()
    robot.hears((950, 490, 0))
    robot.sense((1000, 400))
    robot.settle()
    assert robot.digest == right_from_the_start([(1000, 400)], [(950, 490, 0)])
    assert (robot.own.counters["masked"], robot.own.counters["corrected"]) == (1, 0)


def test_a_late_pose_is_corrected_to_what_it_would_have_been() -> None:
    robot = Robot()
    robot.sense((1000, 400))
    robot.settle()
    assert robot.digest == right_from_the_start([(1000, 400)])
    robot.hears((1000, 490, 0))
    robot.settle()
    assert robot.digest == right_from_the_start([(1000, 400)], [(1000, 490, 0)]) == robot.observer.fusion.digest()
    assert robot.own.counters["corrected"] == 1


def test_a_reading_that_was_masked_wrongly_comes_back() -> None:
    """The team-mate was believed to stand there still; late news tell that it had gone."""
    robot = Robot()
    robot.hears((0, 490, 0))
    robot.sense((5000, 400))
    robot.settle()
    robot.hears((4000, 2000, 0))
    robot.settle()
    assert robot.digest == right_from_the_start([(5000, 400)])


def test_news_of_hours_ago_correct_what_was_sensed_hours_ago() -> None:
    robot = Robot()
    rows = [(hour * 3_600_000, 400) for hour in range(9)]
    robot.sense(*rows)
    robot.settle()
    robot.hears((0, 490, 0), (100, 3000, 0))
    robot.settle()
    assert robot.digest == right_from_the_start(rows, [(0, 490, 0), (100, 3000, 0)])
    assert robot.own.counters["corrected"] == 1


def test_under_a_limit_nothing_can_be_taken_back_and_it_is_counted_once() -> None:
    robot = Robot(model=EvidenceModel(85, -40, 200))
    robot.sense((1000, 400))
    robot.settle()
    before = robot.digest
    for pose in ((1000, 490, 0), (1010, 495, 0)):
        robot.hears(pose)
        robot.settle()
    assert robot.digest == before
    assert robot.own.counters["uncorrectable"] == 1


# Another start pose


def test_a_robot_that_learns_another_start_pose_publishes_all_of_it_anew_and_goes_on() -> None:
    robot = Robot()
    robot.sense((0, 400), (100, 410))
    robot.settle()
    before = robot.own.descriptor
    robot.peer.set_start_pose("r1", ELSEWHERE, robot.now)
    robot.sense((200, 420))
    robot.settle()
    after = robot.own.descriptor
    assert (after.start, after.replaces) == (ELSEWHERE, before.session)
    assert robot.body.placed == [ORIGIN, ELSEWHERE]
    assert robot.digest == right_from_the_start([(0, 400), (100, 410), (200, 420)], start=ELSEWHERE)
    assert robot.observer.fusion.digest() == robot.digest
    robot.settle()
    assert robot.own.descriptor is after


def test_a_robot_whose_start_pose_nobody_knows_maps_apart_until_somebody_does() -> None:
    robot = Robot(start=None)
    robot.hears((0, 490, 0))  # a place in a frame that means nothing to it
    robot.sense((0, 400))
    robot.settle()
    assert not robot.own.placed
    assert robot.own.map is robot.own.writer.replica.state.cells
    assert robot.digest == right_from_the_start([(0, 400)])
    assert robot.observer.fusion.tiles == {}
    robot.peer.set_start_pose("r1", ORIGIN, robot.now)
    robot.settle()
    assert robot.body.placed == [OWN_FRAME, ORIGIN]
    assert robot.own.map is robot.peer.fusion.tiles
    assert robot.digest == right_from_the_start([(0, 400)], [(0, 490, 0)]) == robot.observer.fusion.digest()


def test_a_record_is_stronger_than_the_configuration_also_at_the_start() -> None:
    robot = Robot()
    robot.peer.set_start_pose("r1", ELSEWHERE, 0.0)
    own = OwnSession(robot.peer, "r1", robot.body, mates=robot.mates, start=ORIGIN, publish="auto", kernel=raster)
    assert own.descriptor.start == ELSEWHERE


def test_a_start_pose_from_which_the_map_could_be_left_is_told_and_does_not_count() -> None:
    robot = Robot()
    robot.peer.set_start_pose("r1", QuantisedPose(FARTHEST_START_MM + 1, 0, 0), 0.0)
    robot.settle()
    assert robot.own.descriptor.start == ORIGIN
    assert "too far out" in robot.own.status
    robot.peer.set_start_pose("r1", ELSEWHERE, 0.0)
    robot.settle()
    assert robot.own.status == ""
    assert robot.own.descriptor.start == ELSEWHERE


def test_a_session_that_somebody_else_replaced_is_told_and_written_no_more() -> None:
    """A copied card: two robots of one name, of which the other has published this one's session anew."""
    robot = Robot()
    robot.sense((0, 400))
    robot.settle()
    mine = robot.own.descriptor
    thief = Robot._peer(mine.rules, Hello(Hello.ROBOT, b"r1", b"test"), NoMates())
    for outgoing in robot.peer.poll(robot.now + 9):
        thief.receive("r1", outgoing.payload, robot.now)
    thief._know(mine)
    thief.open_session(Descriptor("r1", b"thief...", mine.rules, mine.sensor, ORIGIN, mine.session))
    for outgoing in thief.poll(0.0):
        robot.peer.receive("thief", outgoing.payload, robot.now)
    robot.sense((100, 400))
    robot.turn()
    assert "another r1" in robot.own.status
    assert robot.own.descriptor == mine
    assert not robot.own.settled


# Steps


def test_a_long_journal_is_handed_over_in_steps_and_what_is_sensed_meanwhile_comes_in_its_order(monkeypatch) -> None:
    monkeypatch.setattr(agent.own_session, "_MOST_ROWS", 10)
    robot = Robot()
    rows = [(k, 300 + k) for k in range(100)]
    robot.sense(*rows[:95])
    robot.own.publish()
    assert robot.own.unpublished == 85
    robot.own.publish()  # the writer has not published yet: that is enough
    assert robot.own.unpublished == 85
    robot.turn()
    robot.sense(*rows[95:])
    robot.settle()
    assert robot.digest == right_from_the_start(rows)


def test_a_laser_hands_over_fewer_scans_than_five_beams_do() -> None:
    steps = {}
    for beams in (5, 180):
        sensor = laser(beams, first=-1.5, step=3 / beams, max_range=2.0)
        robot = Robot(sensor=sensor, mates=NoMates())
        robot.own.journal.append(Readings(np.arange(9000), np.zeros((9000, 3)), np.full((9000, beams), np.nan)))
        robot.own.publish()
        steps[beams] = 9000 - robot.own.unpublished
    assert steps == {5: 4096, 180: 2 * (MAX_VISITS // (180 * 102))}


def test_a_long_correction_goes_in_steps_too(monkeypatch) -> None:
    monkeypatch.setattr(agent.own_session, "_CORRECTED_ROWS", 10)
    robot = Robot()
    rows = [(k * 100, 400) for k in range(100)]
    robot.sense(*rows)
    robot.settle()
    robot.hears((0, 490, 0))
    robot.turn()
    assert robot.own.counters["corrected"] == 10
    assert not robot.own.settled
    robot.settle()
    assert robot.own.counters["corrected"] == 100
    assert robot.digest == right_from_the_start(rows, [(0, 490, 0)])


times = st.integers(0, 40).map(lambda k: k * 50)
tracks = st.lists(st.tuples(times, st.integers(300, 700), st.integers(-150, 150)), min_size=1, max_size=6)
own = st.lists(st.tuples(times, st.integers(200, 800)), min_size=1, max_size=10)
starts = st.lists(st.builds(QuantisedPose, st.integers(-50, 50), st.integers(-50, 50), st.integers(0, 900)), max_size=3)


@given(own, tracks, tracks, starts, st.booleans(), st.randoms(use_true_random=False))
@settings(max_examples=60)
def test_whatever_comes_when_the_map_is_that_of_who_knew_it_all_from_the_start(
    rows, track, wrong_track, corrections, placed, random_
) -> None:
    """News in any order, a team-mate's wrong session that is replaced, start poses, all between own scans."""
    rows = sorted(rows)
    track = list({stamp: (stamp, x, y) for stamp, x, y in track}.values())
    robot = Robot(start=ORIGIN if placed or not corrections else None)
    late = [
        *(lambda pose=pose: robot.hears(pose) for pose in track),
        lambda: robot.mates.replaced(b"wrong...") or said_wrong.clear(),
    ]
    said_wrong = [lambda pose=pose: robot.hears(pose, session=b"wrong...") for pose in wrong_track]
    random_.shuffle(late)
    events = [lambda row=row: robot.sense(row) for row in rows]
    for pose in corrections:
        events.insert(
            random_.randrange(len(events) + 1), lambda pose=pose: robot.peer.set_start_pose("r1", pose, robot.now)
        )
    for news in late:
        events.insert(random_.randrange(len(events) + 1), news)
    for event in events:
        if said_wrong and random_.random() < 0.5:
            said_wrong.pop()()
        event()
        if random_.random() < 0.5:
            robot.turn()
    robot.settle()
    record = robot.peer.controls.start_pose("r1")
    assert (record is None) == (not corrections)
    start = ORIGIN if record is None else record.pose
    assert robot.digest == right_from_the_start(rows, track, start)
    assert robot.observer.fusion.digest() == robot.digest


def test_poses_are_those_of_the_start_frame_wherever_it_lies() -> None:
    """Also where the robot drove on after it was placed: T_common_start @ T_start_robot throughout."""
    robot = Robot()
    along = Readings(np.arange(3), np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0.5]]), np.full((3, 5), 0.3))
    robot.own.journal.append(along)
    robot.peer.set_start_pose("r1", ELSEWHERE, 0.0)
    robot.settle()
    poses = robot.own.journal.scans(ELSEWHERE, slice(None)).poses.tolist()
    assert poses == [list(QuantisedPose.of(ELSEWHERE.pose() @ Pose(*pose))) for pose in along.poses.tolist()]
