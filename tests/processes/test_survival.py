"""Robots die in the middle of their work: what they had published lives on with everybody, and all the others agree."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from agent.playback import read

pytestmark = pytest.mark.processes

CELL = 0.05


BUSES = pytest.mark.parametrize("transport", ["zenoh", "zmq"])


@pytest.fixture
def transport() -> str:
    """The bus of the tests that do not ask for each."""
    return "zenoh"


@pytest.fixture
def roster(swarm, transport):
    """The TOML of r1, which has half a minute to go and is to die on the way, and two robots that need four seconds."""
    robots = {}
    for name, scans, seconds in (("r1", 300, 30.0), ("r2", 55, 4.0), ("r3", 60, 4.0)):
        log = swarm.log(f"{name}.log", scans=scans, seconds=seconds)
        robots[name] = {"start": {}, "body": {"kind": "recording", "path": str(log), "speed": 1.0}}
    return swarm.toml(robots, cell=CELL, transport=transport)


def the_robots_of(roster: Path) -> list[Path]:
    return [roster.parent / f"r{k}.log" for k in (1, 2, 3)]


@BUSES
def test_a_robot_that_is_killed_leaves_all_that_it_had_published(orion, swarm, roster, truth) -> None:
    out, late_out = swarm.folder / "out", swarm.folder / "late"
    observer = orion("observe", "-c", roster, "--out", out, "--supervised")
    victim = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
    observer.is_ready()
    victim.is_ready()
    others = [orion("agent", "-c", roster, "--robot", name, "--json") for name in ("r2", "r3")]
    victim.order("go")

    # in the middle: the others are on their way, and the observer has what the victim says it wrote
    victim.knows(lambda known: len(known) == 3 and sum(known.values()) >= 30)
    observer.knows(lambda known: len(known) == 3)
    session = next(iter(victim.status["positions"]))  # a peer opens its own session before it hears of another
    written = victim.status["positions"][session]
    observer.knows(lambda known: known.get(session, 0) >= written)
    victim.signal(signal.SIGKILL)
    assert victim.ends() == -signal.SIGKILL

    late = orion("observe", "-c", roster, "--out", late_out, "--supervised")
    late.is_ready()
    finally_known = observer.hears_no_more(quiet=3.0)
    late.knows(lambda known: known == finally_known)
    for other in others:
        other.signal(signal.SIGINT)
    reports = [other.report() for other in others]
    views = [observer.finish(), late.finish()]

    # all that live agree, and the others have lost nothing
    assert [report["scans"] for report in reports] == [55, 60]
    assert len({each["map_digest"] for each in [*reports, *views]}) == 1
    recordings = [read(log)[0] for log in the_robots_of(roster)]
    for name, recording in zip(("r2", "r3"), recordings[1:], strict=True):
        assert truth.in_file(out / f"map-{name}.npz") == truth.digest_of([recording], CELL)

    # what the dead robot wrote is there, whole: its first scans, and not one of them twice
    assert finally_known[session] >= written > 0
    first_scans = truth.digests_after_each_scan(recordings[0], CELL)
    kept = first_scans.index(truth.in_file(out / "map-r1.npz"))
    assert 0 < kept < len(recordings[0])
    assert truth.in_file(late_out / "map-r1.npz") == first_scans[kept]
    assert session not in {report["session"] for report in reports}


def test_a_robot_that_is_killed_in_a_replay_is_listed_lost(orion, swarm, roster, truth, processes) -> None:
    out = swarm.folder / "out"
    replay = orion("replay", *the_robots_of(roster), "-c", roster, "--speed", 1, "--out", out, "--json")
    eyes = processes.eyes_on(replay, roster)
    eyes.knows(lambda known: len(known) == 3 and min(known.values()) >= 5)
    victim = processes.members(replay.pid)["r1"]
    processes.kill(victim)
    assert replay.ends() == 1
    eyes.finish()
    result = replay.result
    assert result["converged"] is False
    assert [robot["id"] for robot in result["robots"] if robot.get("lost")] == ["r1"]
    survivors = [robot for robot in result["robots"] if not robot.get("lost")]
    assert [robot["scans"] for robot in survivors] == [55, 60]
    assert {robot["map_digest"] for robot in survivors} == {result["observer"]["map_digest"]}
    assert "LOST" in replay.errors
    first_scans = truth.digests_after_each_scan(read(swarm.folder / "r1.log")[0], CELL)
    assert 0 < first_scans.index(truth.in_file(out / "map-r1.npz")) < 300
    assert not processes.children(replay.pid)


@BUSES
def test_a_robot_that_restarts_opens_a_new_session_beside_its_old_one(orion, swarm, roster, truth) -> None:
    """Killed in the middle and started again, it maps the same rooms again: both sessions count."""
    out = swarm.folder / "out"
    observer = orion("observe", "-c", roster, "--out", out, "--supervised")
    observer.is_ready()
    for _ in range(2):
        robot = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
        robot.is_ready()
        before = set(observer.status.get("positions", {}))
        robot.order("go")
        observer.knows(lambda known, old=before: any(n >= 5 for session, n in known.items() if session not in old))
        robot.signal(signal.SIGKILL)
        robot.ends()
    positions = observer.hears_no_more(quiet=0.5)
    files = observer.finish()["files"]["robots"]
    assert len(positions) == len(files) == 2
    first_scans = truth.digests_after_each_scan(read(swarm.folder / "r1.log")[0], CELL)
    assert all(truth.in_file(path) in first_scans[1:-1] for path in files.values())


@BUSES
def test_when_all_robots_are_gone_newcomers_get_the_map_from_an_observer_that_has_a_table(
    orion, swarm, roster, truth
) -> None:
    """With its state, after a restart of its own; from one without a table nobody who comes later could get it."""
    with roster.open("a") as file:
        file.write("\n[observers.base]\n")
    base = ("observe", "-c", roster, "--name", "base", "--state", swarm.folder / "state", "--supervised")
    observer = orion(*base)
    observer.is_ready()
    robots = [orion("agent", "-c", roster, "--robot", name, "--supervised") for name in ("r2", "r3")]
    for robot in robots:
        robot.is_ready()
        robot.order("go")
    for robot in robots:
        robot.shows("done", value=True)
    observer.knows(lambda known: len(known) == 2)
    known = observer.hears_no_more()
    for robot in robots:
        robot.signal(signal.SIGKILL)
        robot.ends()
    observer.signal(signal.SIGKILL)
    observer.ends()
    observer = orion(*base)
    observer.is_ready()

    late = orion("observe", "-c", roster, "--out", swarm.folder / "late", "--supervised")
    late.is_ready()
    late.knows(lambda positions: positions == known)
    views = [late.finish(), observer.finish()]
    assert views[0]["map_digest"] == views[1]["map_digest"]
    for name in ("r2", "r3"):
        recording = read(swarm.folder / f"{name}.log")[0]
        assert truth.in_file(swarm.folder / "late" / f"map-{name}.npz") == truth.digest_of([recording], CELL)
