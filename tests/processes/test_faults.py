"""Processes that stand still and cables that are pulled: when all is well again, all have the one map there is."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from agent.playback import read

pytestmark = pytest.mark.processes

CELL = 0.05
R1, THE_CABLE = "127.0.0.1", "127.0.0.2"
LONG = pytest.mark.soak  # all of them together


@pytest.fixture
def tomls(swarm, transport) -> Callable[[str], Path]:
    """Writes the swarm's TOML with the address at which r1 is: two robots, each with three seconds to go."""
    bodies = [
        {"kind": "recording", "path": str(swarm.log(f"r{k}.log", scans=scans, seconds=3.0)), "speed": 1.0}
        for k, scans in ((1, 30), (2, 40))
    ]

    def write(host: str) -> Path:
        robots = {"r1": {"host": host, "start": {}, "body": bodies[0]}, "r2": {"start": {}, "body": bodies[1]}}
        return swarm.toml(robots, name=f"{host}.toml", cell=CELL, transport=transport)

    return write


@pytest.fixture
def cable(swarm) -> Iterator[Callable[[str], None]]:
    """The only way to r1: gives what tells it ``cut``, ``stall`` or ``heal``."""
    program = Path(__file__).with_name("proxy.py")
    words = [sys.executable, str(program), THE_CABLE, R1, str(swarm.base_port)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"

        def tell(word: str) -> None:
            process.stdin.write(word + "\n")
            process.stdin.flush()
            assert process.stdout.readline() == word + "\n"

        yield tell
        process.kill()


def all_end_with_the_one_map(everybody, swarm, truth) -> None:
    """All that lives knows all that was sensed, and reports the map that one would make of it."""
    for each in everybody:
        each.shows("done", True)
    wanted = [each.status["positions"] for each in everybody[:2]]
    newest = {session: max(known.get(session, 0) for known in wanted) for session in set().union(*wanted)}
    for each in everybody:
        each.knows(lambda known: known == newest)
    digest = truth.digest_of([read(swarm.folder / f"r{k}.log")[0] for k in (1, 2)], CELL)
    assert [each.finish()["map_digest"] for each in everybody] == [digest] * len(everybody)


@pytest.mark.parametrize("transport", ["zenoh", pytest.param("zmq", marks=LONG)])
def test_a_process_that_stood_still_catches_up(orion, swarm, tomls, truth) -> None:
    toml = tomls(R1)
    observer = orion("observe", "-c", toml, "--supervised")
    r1, r2 = (orion("agent", "-c", toml, "--robot", name, "--supervised") for name in ("r1", "r2"))
    for each in (observer, r1, r2):
        each.shows("around", 2)
    for robot in (r1, r2):
        robot.order("go")
    r2.knows(lambda known: sum(known.values()) >= 6)
    r2.signal(signal.SIGSTOP)
    for each in (observer, r1):
        each.shows("around", 1)  # it was missed
    r1.shows("done", True)  # and much went by
    r2.signal(signal.SIGCONT)
    for each in (observer, r1):
        each.shows("around", 2)
    all_end_with_the_one_map([r1, r2, observer], swarm, truth)


@pytest.mark.parametrize(
    ("fault", "transport"),
    [
        ("cut", "zenoh"),
        ("stall", "zmq"),
        *(pytest.param(*each, marks=LONG) for each in (("stall", "zenoh"), ("cut", "zmq"))),
    ],
)
def test_a_robot_behind_a_pulled_cable_is_joined_again(orion, swarm, tomls, cable, truth, fault: str) -> None:
    """No third peer is there meanwhile: Zenoh's gossip would find another way than the cable."""
    there, here = tomls(R1), tomls(THE_CABLE)
    r1 = orion("agent", "-c", there, "--robot", "r1", "--supervised")
    r2 = orion("agent", "-c", here, "--robot", "r2", "--supervised")
    for robot in (r1, r2):
        robot.shows("around", 1)
        robot.order("go")
    r2.knows(lambda known: len(known) == 2 and min(known.values()) >= 3)
    cable(fault)
    for robot in (r1, r2):
        robot.shows("around", 0)
    for robot in (r1, r2):
        robot.shows("done", True)
    assert r1.status["positions"] != r2.status["positions"]
    cable("heal")
    observer = orion("observe", "-c", here, "--supervised")
    observer.shows("around", 2)
    all_end_with_the_one_map([r1, r2, observer], swarm, truth)
