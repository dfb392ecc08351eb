"""However a process is told to end, it ends soon, quietly, and whole: no child left, no traceback, no half a file."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.processes

SOON = 12.0
"""Seconds; most take one or two."""

ENDINGS = [signal.SIGINT, signal.SIGTERM]


@pytest.fixture
def roster(swarm):
    """The TOML of two robots whose logs take a minute, so that every end is an early one."""
    body = {"kind": "recording", "path": str(swarm.log(scans=600, seconds=60.0)), "speed": 1.0}
    return swarm.toml({"r1": {"start": {}, "body": body}, "r2": {"start": {}, "body": body}}, cell=0.05)


def assert_whole(out: Path, truth: Any) -> None:
    """The folder holds complete maps, a simulation's truth, and nothing else; no port is left."""
    assert {path.suffix for path in out.iterdir()} <= {".npz", ".pgm", ".yaml", ".png", ".toml", ".json"}
    for path in [*out.glob("map*.npz"), *out.glob("*.yaml")]:
        truth.in_file(path)
    if (out / "truth.npz").exists():
        with np.load(out / "truth.npz") as ways:
            assert ways["poses"].shape == (len(ways["stamps_ms"]), len(ways["robots"]), 3)
    assert (out / "map.png").read_bytes().endswith(b"IEND\xaeB`\x82")


def assert_quiet(errors: str) -> None:
    assert "Traceback" not in errors
    assert "Error" not in errors


def assert_only_news(errors: str, name: str) -> None:
    """What a process in a terminal tells while all is well; the last news may come too late to be told."""
    ready, *peers = errors.splitlines()
    assert ready == f"orion: {name} is ready; Ctrl-C ends it"
    if name == "the observer":
        assert peers.pop(0).startswith("orion: the map as it grows: http://127.0.0.1:")
    assert peers in ([], ["orion: 1 other peer"])


# A whole swarm


@pytest.mark.parametrize(
    ("command", "number"), [("demo", signal.SIGINT), ("demo", signal.SIGTERM), ("replay", signal.SIGINT)]
)
def test_a_swarm_that_is_told_to_end_writes_the_map_so_far(
    orion, swarm, roster, truth, processes, command: str, number: signal.Signals
) -> None:
    out = swarm.folder / "out"
    recordings = [swarm.folder / "run.log"] * 2 if command == "replay" else []
    launcher = orion(command, *recordings, "-c", roster, "--speed", 1, "--out", out, "--json")
    eyes = processes.eyes_on(launcher, roster)
    eyes.knows(lambda known: len(known) == 2 and min(known.values()) >= 3)
    started = processes.children(launcher.pid)
    assert len(started) >= (3 if command == "replay" else 4)  # the world too
    launcher.signal(number)
    assert launcher.ends(SOON) == 1
    processes.all_end(started, within=0.0)
    assert "orion: interrupted; the map so far is written" in launcher.errors.splitlines()
    assert_quiet(launcher.errors)
    assert_whole(out, truth)
    assert launcher.result["converged"] is False
    assert all(robot["scans"] > 0 for robot in launcher.result["robots"])
    assert launcher.result["observer"]["map_digest"] == truth.in_file(out / "map.npz")
    eyes.finish()


@pytest.mark.parametrize("number", ENDINGS)
def test_a_swarm_that_is_told_to_end_while_it_starts_leaves_nobody(orion, swarm, roster, processes, number) -> None:
    out = swarm.folder / "out"
    launcher = orion("demo", "-c", roster, "--speed", 1, "--out", out)
    started = processes.until(lambda: len(found := processes.children(launcher.pid)) >= 3 and found)
    launcher.signal(number)
    assert launcher.ends(SOON) != 0
    processes.all_end(started, within=0.0)
    assert_quiet(launcher.errors)
    assert not list(out.glob("*.tty"))


def test_the_children_of_a_swarm_that_is_killed_end_by_themselves(orion, swarm, roster, truth, processes) -> None:
    out = swarm.folder / "out"
    launcher = orion("demo", "-c", roster, "--speed", 1, "--out", out)
    eyes = processes.eyes_on(launcher, roster)
    eyes.knows(lambda known: len(known) == 2 and min(known.values()) >= 3)
    started = processes.children(launcher.pid)
    launcher.signal(signal.SIGKILL)
    assert launcher.ends() == -signal.SIGKILL
    processes.all_end(started, within=SOON)
    assert_whole(out, truth)
    eyes.finish()


# One process


@pytest.mark.parametrize("number", ENDINGS)
def test_an_agent_that_is_told_to_end_says_what_it_did(orion, roster, number: signal.Signals) -> None:
    robot = orion("agent", "-c", roster, "--robot", "r1", "--json")
    eyes = orion("observe", "-c", roster, "--supervised")
    eyes.knows(lambda known: sum(known.values()) >= 3)
    robot.signal(number)
    assert robot.ends(SOON) == 0
    assert_only_news(robot.errors, "r1")
    assert robot.result["id"] == "r1"
    assert robot.result["scans"] >= 3
    (session,) = eyes.status["positions"]
    assert robot.result["session"] == session
    eyes.knows(lambda known: known[session] == robot.result["updates"])  # its last words were heard
    assert eyes.finish()["map_digest"] == robot.result["map_digest"]


@pytest.mark.parametrize("number", ENDINGS)
def test_an_observer_that_is_told_to_end_writes_the_map(orion, swarm, roster, truth, number: signal.Signals) -> None:
    out = swarm.folder / "out"
    robot = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
    observer = orion("observe", "-c", roster, "--out", out)
    robot.says(lambda event: event.get("around") == 1)
    robot.order("go")
    robot.knows(lambda known: sum(known.values()) >= 5)
    observer.signal(number)
    assert observer.ends(SOON) == 0
    assert_only_news(observer.errors, "the observer")
    assert any(truth.in_file(out / "map.npz") in line for line in observer.lines)
    assert_whole(out, truth)
    robot.finish()


def test_an_impatient_second_ctrl_c_is_obeyed_too(orion, swarm, roster) -> None:
    robot = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
    observer = orion("observe", "-c", roster, "--out", swarm.folder / "out")
    robot.says(lambda event: event.get("around") == 1)
    for _ in range(3):
        observer.signal(signal.SIGINT)
    observer.ends(SOON)
    assert_quiet(observer.errors)
    robot.finish()


def test_a_supervised_process_ends_when_nobody_is_there_to_tell_it(orion, roster, processes) -> None:
    robot = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
    robot.is_ready()
    robot.hang_up()
    assert robot.report()["id"] == "r1"
    assert_quiet(robot.errors)


# What cannot be written


def test_an_observer_whose_folder_vanishes_says_so_in_one_line(orion, swarm, roster) -> None:
    out = swarm.folder / "out"
    robot = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
    observer = orion("observe", "-c", roster, "--out", out)
    robot.says(lambda event: event.get("around") == 1)
    shutil.rmtree(out)
    observer.signal(signal.SIGINT)
    assert observer.ends(SOON) == 2
    *_, line = observer.errors.splitlines()
    assert line.startswith(f"orion: {out}/map")
    assert "cannot be written: No such file or directory" in line
    assert not out.exists()
    robot.finish()


def test_a_swarm_whose_folder_vanishes_says_so_in_one_line(orion, swarm, processes) -> None:
    out = swarm.folder / "out"
    log = swarm.log(scans=200, seconds=4.0)
    roster = swarm.toml({"r1": {}}, cell=0.05)
    launcher = orion("replay", log, "-c", roster, "--speed", 1, "--out", out)
    eyes = processes.eyes_on(launcher, roster)
    eyes.knows(lambda known: sum(known.values()) >= 3)
    shutil.rmtree(out)
    assert launcher.ends() == 2
    *_, line = launcher.errors.splitlines()
    assert line.startswith(f"orion: {out}/map")
    assert "cannot be written: No such file or directory" in line
    assert not processes.children(launcher.pid)
    eyes.finish()
