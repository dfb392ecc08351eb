"""A team-mate's track against a plain list of poses, in any order, with sessions that go."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.tracks import MAX_POSES, MOST_AROUND, WINDOW_MS, Track

SESSIONS = (b"session1", b"session2")
stamps = st.integers(0, 60).map(lambda k: k * 100)
batches = st.lists(
    st.tuples(st.sampled_from(SESSIONS), st.lists(st.tuples(stamps, st.integers(-9, 9)), min_size=1, max_size=5)),
    max_size=8,
)


def add(track, session, poses):
    return track.add(session, np.array([t for t, _ in poses], np.int64), np.array([(x, 0) for _, x in poses], np.int32))


def around(poses, stamp):
    """The law, plainly: x of the poses within the window, else of the last one before."""
    within = [x for t, x in poses if abs(t - stamp) <= WINDOW_MS]
    before = [x for t, x in poses if t < stamp - WINDOW_MS]
    return within[-MOST_AROUND:] or before[-1:]


def places(track, when):
    which, points = track.around(np.array(when, np.int64))
    return [points[which == k, 0].tolist() for k in range(len(when))]


@given(batches, st.sampled_from([None, *SESSIONS]))
def test_whatever_came_in_whatever_order_it_is_where_it_said_to_be(said, dropped):
    track, poses = Track(), []
    for session, batch in said:
        add(track, session, batch)
        poses += [(t, x, session) for t, x in batch]
    if dropped:
        track.drop(dropped)
    poses = [(t, x) for t, x, session in sorted(poses, key=lambda pose: pose[0]) if session != dropped]
    when = list(range(-1000, 8000, 50))
    assert places(track, when) == [around(poses, stamp) for stamp in when]


@given(batches, st.sampled_from(SESSIONS))
def test_a_change_concerns_every_reading_for_which_anything_changes(said, dropped):
    track, when = Track(), list(range(-1000, 8000, 50))
    changes = [lambda session=session, batch=batch: add(track, session, batch) for session, batch in said]
    for change in [*changes, lambda: track.drop(dropped)]:
        before = places(track, when)
        span = change()
        for stamp, old, new in zip(when, before, places(track, when), strict=True):
            assert old == new or span.first_ms <= stamp <= span.last_ms


def test_a_pose_that_comes_in_time_concerns_nothing_that_was_long_ago():
    track = Track()
    add(track, SESSIONS[0], [(k * 100, k) for k in range(1000)])
    assert add(track, SESSIONS[0], [(100_000, 0)]).first_ms == 100_000 - WINDOW_MS
    assert add(track, SESSIONS[0], [(50_050, 0)]).last_ms <= 50_100 + WINDOW_MS


def test_a_session_that_said_nothing_goes_without_a_trace():
    track = Track()
    add(track, SESSIONS[0], [(0, 1)])
    assert track.drop(SESSIONS[1]) is None
    assert len(track) == 1


def test_a_track_is_bounded_and_forgets_the_oldest():
    track = Track(max_poses=800)
    for k in range(1000):
        add(track, SESSIONS[0], [(k * 1000, k)])
        assert len(track) <= 800
    assert track.newest.tolist() == [999, 0]
    assert places(track, [999_000, 500_000, 100]) == [[999], [500], []]


def test_a_track_covers_a_day_of_ten_poses_a_second():
    assert MAX_POSES / 10 / 3600 > 24


def test_stamps_without_measure_and_thousands_at_one_time_do_no_harm():
    track = Track()
    add(track, SESSIONS[0], [(-(2**63), 1), (2**63 - 1, 2), *[(0, k) for k in range(5000)]])
    which, _ = track.around(np.array([0, 5], np.int64))
    assert np.bincount(which).tolist() == [MOST_AROUND, MOST_AROUND]
