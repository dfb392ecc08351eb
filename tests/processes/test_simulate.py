"""``orion simulate`` by hand: to an agent its ports are a robot's, and their end is that of a cable pulled out."""

from __future__ import annotations

import math
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.world import load_world

pytestmark = pytest.mark.processes

WAYPOINTS = [[0.0, 0.4], [0.3, 0.5]]


def wired(port: object) -> dict[str, Any]:
    """A roster of one robot at the paper's first start, which is to visit two places nearby."""
    start = load_world("paper").starts[0]
    pose = {"x": start.x, "y": start.y, "yaw_deg": math.degrees(start.yaw)}
    return {"r1": {"start": pose, "body": {"kind": "serial", "port": str(port), "waypoints": WAYPOINTS}}}


@pytest.fixture
def world(swarm) -> Path:
    """The TOML of the simulated world."""
    return swarm.toml(wired("r1.tty"), simulation={"world": "paper", "speed": "max"})


@pytest.fixture
def port(world, processes):
    """Waits for the robot's port; gives the pseudo-terminal's own name."""

    def wait() -> Path:
        link = world.parent / "r1.tty"
        return processes.until(lambda: link.is_symlink() and link.readlink().exists() and link.readlink())

    return wait


def test_an_agent_drives_what_is_behind_a_port_and_does_not_know_that_it_is_simulated(
    orion, swarm, world, port
) -> None:
    simulation = orion("simulate", "-c", world, "--truth", swarm.folder / "truth.npz", "--json")
    pty = port()
    agents = swarm.toml(wired(pty), name="robot.toml")  # names a device, as with hardware, and no simulation
    agent = orion("agent", "-c", agents, "--robot", "r1", "--supervised")
    agent.is_ready()
    agent.order("go")
    agent.says(lambda event: event.get("done") is True)
    report = agent.finish()
    simulation.signal(signal.SIGINT)
    told = simulation.report()

    assert report["scans"] > 20
    assert report["tiles"] > 0
    assert report["dropped"] == {}
    (robot,) = told["robots"]
    assert (robot["id"], robot["collisions"]) == ("r1", 0)
    assert robot["driven_m"] > 0.3
    with np.load(swarm.folder / "truth.npz") as ways:
        assert ways["robots"].tolist() == ["r1"]
        assert np.hypot(*(ways["poses"][-1, 0, :2] - WAYPOINTS[-1])) < 0.1
    assert not (world.parent / "r1.tty").is_symlink()
    assert "not connected" not in agent.errors
    assert simulation.errors == "orion: the world is ready; Ctrl-C ends it\n"


def test_an_agent_whose_robot_is_gone_says_so_publishes_no_more_and_ends_well(orion, world, port) -> None:
    simulation = orion("simulate", "-c", world)
    port()
    agent = orion("agent", "-c", world, "--robot", "r1", "--supervised")
    agent.is_ready()
    agent.order("go")
    agent.knows(lambda known: sum(known.values()) >= 3)
    simulation.signal(signal.SIGKILL)
    agent.says(lambda event: event["event"] == "status" and "the robot is not connected" in event["body"])
    (updates,) = agent.hears_no_more(quiet=1.0).values()
    report = agent.finish()
    assert report["updates"] == updates
    assert agent.errors == ""


def test_a_person_at_the_terminal_is_told_that_the_robot_is_gone(orion, world, port, processes) -> None:
    simulation = orion("simulate", "-c", world)
    port()
    agent = orion("agent", "-c", world, "--robot", "r1", "--json")
    eyes = orion("observe", "-c", world, "--supervised")
    eyes.knows(lambda known: sum(known.values()) >= 3)
    simulation.signal(signal.SIGKILL)
    processes.until(lambda: "orion: the robot is not connected: " in agent.errors)
    agent.signal(signal.SIGINT)
    assert agent.report()["updates"] >= 3
    assert eyes.finish()["map_digest"] == agent.result["map_digest"]


def test_an_agent_without_a_robot_says_so_in_one_line(orion, world) -> None:
    """It takes the ten seconds that a robot has to answer."""
    agent = orion("agent", "-c", world, "--robot", "r1")
    assert agent.ends() == 2
    (line,) = agent.errors.splitlines()
    assert line.startswith(f"orion: {world.parent}/r1.tty: no robot answered within 10 s: ")
    assert line.endswith("check the port, cable and firmware")


def test_a_demo_whose_world_is_killed_ends_not_converged_with_what_it_has(orion, swarm, truth, processes) -> None:
    out = swarm.folder / "out"
    demo = orion("demo", "--speed", 2, "--base-port", swarm.base_port, "--out", out, "--json")
    eyes = processes.eyes_on(demo, out / "orion.toml")
    eyes.knows(lambda known: len(known) == 2 and min(known.values()) >= 3)
    started = processes.children(demo.pid)
    processes.kill(processes.members(demo.pid)["world"])
    assert demo.ends() == 1
    processes.all_end(started, within=0.0)
    eyes.finish()
    assert demo.result["converged"] is False
    assert demo.result["simulation"] == {"lost": True}
    assert all(robot["scans"] > 0 for robot in demo.result["robots"])
    assert demo.result["observer"]["map_digest"] == truth.in_file(out / "map.npz")
    assert "simulation  LOST" in demo.errors
    assert "Traceback" not in demo.errors
