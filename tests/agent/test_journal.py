"""The journal: it keeps what was sensed, all of it, and gives any of it as the scans of any start pose."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.column import Column
from agent.journal import MAX_BYTES, Journal, JournalFullError
from agent.playback import RecordedBody, read
from agent.readings import Readings
from mapping.pose import Pose, QuantisedPose
from mapping.scan import Scans, quantise
from mapping.sensor import orion

START = QuantisedPose(2150, 1450, 50972)


def readings(count, first=0):
    stamps = np.arange(first, first + count, dtype=np.int64)
    poses = np.column_stack([np.sin(stamps), np.cos(stamps), stamps / 7])
    return Readings(stamps, poses, np.where(stamps[:, None] % 5 == np.arange(5), np.inf, stamps[:, None] / 1000 % 0.8))


def same(one: Scans, other: Scans):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("stamps_ms", "poses", "ranges"))


@given(st.lists(st.integers(0, 150), max_size=8))
def test_however_it_came_it_is_kept_in_order_and_to_the_bit(counts):
    journal, first = Journal(orion()), 0
    for count in counts:
        journal.append(readings(count, first))
        first += count
    whole = readings(first)
    assert len(journal) == first
    assert np.array_equal(journal.stamps_ms, whole.stamps_ms)
    assert np.array_equal(journal[:].poses, whole.poses)
    assert np.array_equal(journal[:].ranges, whole.ranges)
    assert same(journal.scans(START, slice(None)), whole.scans(START, orion()))


def test_some_rows_are_the_same_scans_as_among_all():
    journal = Journal(orion())
    journal.append(readings(100))
    every = journal.scans(START, slice(None))
    rows = np.array([3, 50, 99])
    assert journal.scans(START, rows).poses.tolist() == every.poses[rows].tolist()
    assert same(journal.scans(START, slice(10, 20)), every[10:20])


def test_a_full_journal_takes_nothing_more_and_keeps_what_it_has():
    journal = Journal(orion(), max_bytes=10 * (8 + 24 + 5 * 8))
    journal.append(readings(8))
    with pytest.raises(JournalFullError, match="8 scans"):
        journal.append(readings(3, 8))
    assert len(journal) == 8
    journal.append(readings(2, 8))
    assert len(journal) == 10


def test_it_holds_hours():
    """Ten scans a second: of an Orion 200 hours, of a laser with 180 beams 10."""
    for beams, hours in ((5, 200), (180, 9.9)):
        assert MAX_BYTES / (8 + 24 + beams * 8) / 10 / 3600 > hours


@given(st.lists(st.lists(st.integers(-9, 9), max_size=70), max_size=6))
def test_a_column_is_what_was_put_into_it(batches):
    column = Column(np.int32)
    for batch in batches:
        column.append(np.array(batch, np.int32))
    assert column.rows.tolist() == [number for batch in batches for number in batch]
    column.replace(column.rows[::-1])
    assert column.rows.tolist() == [number for batch in batches for number in batch][::-1]
    column.clear()
    assert len(column) == 0


@pytest.mark.recordings
def test_recorded_readings_become_the_scans_that_a_robot_with_that_start_always_had(recordings_dir):
    """The published way of a robot whose start was right: its recorded poses composed and rounded once, all at once."""
    (recording,) = read(recordings_dir / "carmen" / "intel_2robots_r1.log.gz")
    start = QuantisedPose.of(Pose(1.25, -3.5, math.radians(-37)))
    journal, body = Journal(recording.sensor), RecordedBody(recording)
    while len(batch := body.read(math.inf)):
        journal.append(batch)
    expected = quantise(recording.due, start.pose().compose(recording.poses), recording.ranges, recording.sensor)
    assert len(journal) == len(recording)
    assert same(journal.scans(start, slice(None)), expected)
    pieces = [journal.scans(start, slice(first, first + 100)) for first in range(0, len(journal), 100)]
    assert same(Scans.join(pieces), expected)


def test_a_simulated_robots_readings_become_the_scans_of_where_it_really_stood(arena):
    """Its body was placed wrongly all along; the journal knows nothing of it."""
    walls = [[-0.5, -0.6, 1.5, -0.6], [1.5, -0.6, 1.5, 0.6], [1.5, 0.6, -0.5, 0.6], [-0.5, 0.6, -0.5, -0.6]]
    wrong = arena(walls, [Pose(0, 0, 0)], believed=[Pose(1.0, 2.0, 3.0)])
    right = arena(walls, [Pose(0, 0, 0)])
    for place in (wrong, right):
        place.run(3)
    start = QuantisedPose(0, 0, 0)
    assert same(
        wrong.robots[0].own.journal.scans(start, slice(None)), right.robots[0].own.journal.scans(start, slice(None))
    )
    assert len(wrong.robots[0].own.journal) == 30
