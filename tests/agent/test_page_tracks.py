"""Trails and hits: as long as the way, as new as the newest, and never written again once they were handed out."""

from __future__ import annotations

import numpy as np
import pytest

from agent.page_tracks import MOST_HITS, MOST_POSES, STRIDE_MM, hits
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Beam, Sensor


def test_a_trail_has_a_pose_for_every_stride_and_the_newest_pose_besides(watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(50, stride_mm=5))
    track = watched.tracks.of(session)
    steps = np.diff(track.trail[:, 0])
    assert (steps == STRIDE_MM).all()
    assert track.trail[0].tolist() == [0, 0, 0]
    assert track.pose.tolist() == [245, 0, 0]


def test_a_robot_that_stands_still_costs_nothing(watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(100, stride_mm=0))
    watched.sense("r1", straight(100, stride_mm=0, first_ms=10_000))
    assert len(watched.tracks.of(session).trail) == 1
    assert len(watched.tracks.of(session).hits) == 1000


def test_it_does_not_matter_in_how_many_updates_a_way_came(watched, straight) -> None:
    one, other = watched.robot("r1"), watched.robot("r2")
    scans = straight(40, stride_mm=7)
    watched.sense("r1", scans)
    for k in range(40):
        watched.sense("r2", scans[k : k + 1])
    assert (watched.tracks.of(one).trail == watched.tracks.of(other).trail).all()


def test_what_was_handed_out_stays_as_it_was(watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(30))
    before = watched.tracks.of(session)
    kept = before.trail.copy(), before.hits.copy()
    watched.sense("r1", straight(500, y_mm=40))
    assert (before.trail == kept[0]).all()
    assert (before.hits == kept[1]).all()
    with pytest.raises(ValueError, match="read-only"):
        before.trail[0] = 0


def test_a_very_long_way_has_fewer_poses_to_the_metre(watched, straight) -> None:
    session = watched.robot("r1")
    for k in range(11):
        scans = straight(1000, stride_mm=STRIDE_MM, first_ms=100_000 * k)
        scans.poses[:, 0] += 1000 * STRIDE_MM * k
        watched.sense("r1", scans)
    track = watched.tracks.of(session)
    assert MOST_POSES / 2 < len(track.trail) <= MOST_POSES
    assert track.stride_mm == 2 * STRIDE_MM
    assert (np.diff(track.trail[:, 0]) == track.stride_mm).all()
    assert track.trail[0].tolist() == [0, 0, 0]


def test_a_copy_stays_and_goes_on_as_the_first_did(watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(60))
    copy = watched.tracks.copy()
    kept = copy.of(session).trail.copy()
    watched.listeners.append(copy)
    for k in range(2):  # once more in the same place
        watched.sense("r1", straight(1, y_mm=5, first_ms=8000 + 100 * k))
    more = straight(60, y_mm=30, first_ms=10_000)
    watched.sense("r1", more)
    assert len(kept) < len(copy.of(session).trail)
    assert (copy.of(session).trail == watched.tracks.of(session).trail).all()
    other = copy.copy()
    watched.sense("r1", straight(60, y_mm=90, first_ms=20_000))
    assert len(other.of(session).trail) < len(watched.tracks.of(session).trail)


def test_only_the_newest_hits_are_kept(watched, straight) -> None:
    session = watched.robot("r1")
    for k in range(6):
        watched.sense("r1", straight(100, y_mm=k, first_ms=10_000 * k))
    track = watched.tracks.of(session)
    assert (len(track.hits), track.hits_in_all) == (MOST_HITS, 3000)


def test_sessions_that_are_gone_are_forgotten(watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(30))
    watched.tracks.keep_only(set())
    assert len(watched.tracks.of(session).trail) == 0


def test_hits_are_where_beams_ended_that_met_something() -> None:
    sensor = Sensor((Beam(10, 0, 0), Beam(0, 20, 16384), Beam(0, 0, 0)), 1000)
    ranges = np.array([[100, 200, NO_RETURN], [100, INVALID, 300]], np.uint16)
    poses = np.array([[1000, 2000, 0], [0, 0, 32768]], np.int32)
    found = hits(Scans(np.arange(2, dtype=np.int64), poses, ranges), sensor)
    assert found.tolist() == [[1110, 2000], [1000, 2220], [-110, 0], [-300, 0]]
