"""How a swarm stands: one value for the page, the terminal and the meters."""

from __future__ import annotations

import json

import pytest

from agent.overview import Overview, budget
from agent.page_snapshot import Snapshots
from mapping.grid import Grid
from mapping.map_picture import robot_colour
from mapping.tiles import map_digest


@pytest.fixture
def overview() -> Overview:
    return Overview("lab", ["r1", "r2"], 1362.5)


@pytest.fixture
def snapshots(watched) -> Snapshots:
    return Snapshots(watched.observer, watched.tracks, watched.heard, lambda: {"dropped_inbox_full": 3})


def test_area_and_digest_are_those_of_the_map_that_is_there_now(watched, straight, overview, snapshots) -> None:
    watched.robot("r1")
    for k in range(4):
        watched.sense("r1", straight(20, y_mm=300 * k, first_ms=2000 * k))
        watched.talk()
        snapshot = snapshots.take(watched.now)
        told = overview.of(snapshot)
        assert told["known_m2"] == pytest.approx(Grid.of(snapshot.fused, watched.RULES.lattice).known_m2)
        assert told["digest"] == watched.observer.fusion.digest().hex()
        assert told["tiles"] == len(snapshot.fused) > 0
    watched.observer.evict(b"r1r1r1r1", watched.now)
    told = overview.of(snapshots.take(watched.now), exact=True)
    assert (told["known_m2"], told["tiles"], told["digest"]) == (0.0, 0, map_digest({}).hex())


def test_digests_are_made_once_a_second_at_most_if_not_asked_for(watched, straight, overview, snapshots) -> None:
    watched.robot("r1")
    watched.sense("r1", straight(5))
    before = overview.of(snapshots.take(watched.now))["digest"]
    watched.sense("r1", straight(5, y_mm=300, first_ms=1000))
    snapshot = snapshots.take(watched.now - 0.5)
    assert overview.of(snapshot)["digest"] == before
    assert overview.of(snapshot, exact=True)["digest"] == watched.observer.fusion.digest().hex() != before


def test_all_agree_once_everybody_has_said_so(watched, straight, overview, snapshots) -> None:
    assert not overview.of(snapshots.take(watched.now))["agree"]  # nobody else is there
    watched.robot("r1")
    watched.sense("r1", straight(5))
    watched.talk(seconds=60)
    assert overview.of(snapshots.take(watched.now))["agree"]
    watched.observer.evict(b"r1r1r1r1", watched.now)
    assert not overview.of(snapshots.take(watched.now))["agree"]


def test_what_we_sent_and_dropped_is_told_with_what_the_bus_lost(watched, straight, overview, snapshots) -> None:
    watched.robot("r1")
    watched.sense("r1", straight(5))
    watched.observer.receive("r1", b"no message", watched.now)
    told = overview.of(snapshots.take(watched.now))
    assert told["dropped"] == {**watched.observer.dropped, "dropped_inbox_full": 3}
    assert told["dropped"]["not_msgpack"] == 1
    assert sum(told["sent"].values()) == sum(told["spent"].values()) > 0


def test_it_is_ready_for_json(watched, straight, overview, snapshots) -> None:
    watched.robot("r1")
    watched.sense("r1", straight(5))
    told = overview.of(snapshots.take(watched.now))
    assert json.loads(json.dumps(told)) == told
    assert (told["budget"], told["sessions"][0]["robot"]) == (1362.5, "r1")


def test_colours_are_those_of_the_roster(overview) -> None:
    assert [overview.rgb(robot) for robot in ("r1", "r2", "stranger")] == [robot_colour(k) for k in range(3)]
    assert overview.colour("r1") == "#0072b2"


def test_only_a_shared_channel_has_a_budget() -> None:
    assert (budget("lan"), budget("digimesh-3hop")) == (None, 1362.5)
