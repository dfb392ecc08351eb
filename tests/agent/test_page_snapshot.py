"""Snapshots: values that stay as they are while the peer goes on."""

from __future__ import annotations

import pytest

from agent.page_snapshot import Rate, Snapshots
from mapping.tiles import map_digest
from swarm.messages import REFUSED, Digest


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


@pytest.mark.parametrize(("n", "same"), [(3, False), (0, True), (REFUSED, True)])
def test_a_peer_with_a_session_that_we_do_not_know_has_another_map_if_anything_is_in_it(
    watched, straight, n, same
) -> None:
    observer = watched.observer
    session = watched.robot("r1")
    watched.sense("r1", straight(5))
    watched.talk(seconds=60)
    positions = [(session, observer.replicas[session].state.n), (b"stranger", n)]
    observer.told["r1"] = Digest.of(positions, complete=True, controls=observer.controls.check)
    (peer,) = Snapshots(observer, watched.tracks, watched.heard).take(watched.now).peers
    assert peer.same is same


def test_what_was_heard_of_somebody_who_has_left_stays_in_the_rate(watched, straight) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    for name in ("r1", "r2"):
        watched.robot(name)
    watched.talk()
    watched.heard["r1"] = 1_000_000
    for k in range(30):
        snapshots.take(100.0 + k / 10)
        watched.heard.update({"r1": 1000, "r2": 100})
    assert snapshots.take(103.0).bytes_rate == pytest.approx(11_000)
    del watched.heard["r1"]
    watched.observer.left("r1", watched.now)
    assert snapshots.take(103.1).bytes_rate == pytest.approx(33_000 / 3.1)


def test_rates_are_those_of_the_last_seconds() -> None:
    rate = Rate()
    assert rate(0.0, 100) == 0.0
    assert [rate(k / 10, 100 + 5 * k) for k in range(1, 101)][-1] == pytest.approx(50.0)
    assert [rate(10 + k / 10, 600) for k in range(1, 101)][-1] == 0.0
    assert rate(21.0, 0) == 0.0


def test_bytes_are_counted_for_the_robot_that_sent_them(watched, straight) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    watched.robot("r1")
    watched.robot("r2")
    watched.talk()
    snapshots.take(watched.now)
    before = watched.heard.copy()
    watched.sense("r1", straight(50))
    watched.now += 1
    snapshot = snapshots.take(watched.now)
    said = {name: (watched.heard[name] - before[name]) / 2 for name in ("r1", "r2")}
    assert said["r1"] > said["r2"]
    assert {each.contribution.descriptor.robot: each.bytes_rate for each in snapshot.sessions} == pytest.approx(said)
    assert snapshot.bytes_rate == pytest.approx(sum(said.values()))
