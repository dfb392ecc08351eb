"""Snapshots: values that stay as they are while the peer goes on."""

from __future__ import annotations

import pytest

from agent.page_snapshot import Rate, Snapshots
from mapping.tiles import map_digest


def test_a_snapshot_stays_as_it_was(watched, straight) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    watched.robot("r1")
    watched.sense("r1", straight(5))
    before = snapshots.take(watched.now)
    digests = map_digest(before.fused), map_digest(before.sessions[0].tiles)
    watched.sense("r1", straight(20, y_mm=200, first_ms=1000))
    after = snapshots.take(watched.now)
    assert (map_digest(before.fused), map_digest(before.sessions[0].tiles)) == digests
    assert map_digest(after.fused) == watched.observer.fusion.digest() != digests[0]


def test_what_has_not_changed_is_not_copied_again(watched, straight) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    watched.robot("r1")
    watched.robot("r2")
    watched.sense("r1", straight(5))
    watched.sense("r2", straight(5))
    before = snapshots.take(watched.now)
    watched.sense("r1", straight(5, first_ms=1000))
    after = snapshots.take(watched.now)
    same = [one.tiles is other.tiles for one, other in zip(before.sessions, after.sessions, strict=True)]
    assert same == [False, True]


def test_peers_that_said_that_they_hold_the_same_are_known(watched, straight) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    watched.robot("r1")
    watched.sense("r1", straight(5))
    watched.talk(seconds=60)
    assert [peer[:3] for peer in snapshots.take(watched.now).peers] == [("r1", True, True)]
    watched.observer.evict(b"r1r1r1r1", watched.now)
    assert snapshots.take(watched.now).peers[0].same is False
    watched.observer.left("r1", watched.now)
    assert snapshots.take(watched.now).peers == ()


def test_rates_are_those_of_the_last_seconds() -> None:
    rate = Rate()
    assert rate(0.0, 100) == 0.0
    assert [rate(k / 10, 100 + 5 * k) for k in range(1, 101)][-1] == pytest.approx(50.0)
    assert [rate(10 + k / 10, 600) for k in range(1, 101)][-1] == 0.0
    assert rate(21.0, 0) == 0.0


def test_bytes_are_counted_for_the_robot_that_sent_them(watched, straight) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    watched.robot("r1")
    snapshots.take(watched.now)
    before = sum(watched.heard.values())
    watched.sense("r1", straight(50))
    watched.now += 1
    (view,) = snapshots.take(watched.now).sessions
    assert view.bytes_rate is None or view.bytes_rate >= 0
    snapshot = snapshots.take(watched.now)
    assert snapshot.bytes_rate == pytest.approx((sum(watched.heard.values()) - before) / 2, rel=0.01)
