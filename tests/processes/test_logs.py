"""Logs of real processes: replayed they are the same swarm, and a killed recorder loses a second at most."""

from __future__ import annotations

import signal
import time

import pytest

from agent.log_reader import LogReader
from agent.log_tools import told_again

pytestmark = pytest.mark.processes


def test_a_log_replayed_gives_every_process_the_recorded_digest(orion, swarm) -> None:
    log, first = swarm.folder / "run.mcap", swarm.folder / "first"
    words = ["--robots", 1, "--speed", "max", "--cell", 0.05, "--base-port", swarm.base_port]
    recorded = orion("demo", *words, "--out", first, "--record", log, "--json").report(120.0)
    assert recorded["converged"] is True
    assert recorded["observer"]["log"]["status"] == ""
    again = orion("replay", log, "--base-port", swarm.base_port, "--out", swarm.folder / "again", "--json").report()
    assert again["converged"] is True
    assert again["observer"]["map_digest"] == recorded["observer"]["map_digest"]
    for key in ("id", "session", "updates", "tiles", "scans", "map_digest"):
        assert [robot[key] for robot in again["robots"]] == [robot[key] for robot in recorded["robots"]]
    refused = orion("replay", log, "--cell", 0.1, "--out", swarm.folder / "again")
    assert refused.ends() == 2
    assert "--cell: cannot be given with a log" in refused.errors


def test_a_killed_recorder_loses_at_most_the_last_second(orion, swarm) -> None:
    log = swarm.folder / "run.mcap"
    body = {"kind": "recording", "path": str(swarm.log(seconds=60.0, scans=600)), "speed": 1.0}
    toml = swarm.toml({"r1": {"body": body}}, cell=0.05)
    robot = orion("agent", "-c", toml, "--robot", "r1", "--supervised")
    observer = orion("observe", "-c", toml, "--record", log, "--supervised")
    robot.is_ready()
    observer.is_ready()
    observer.shows("around", 1)
    robot.order("go")
    known = observer.knows(lambda positions: max(positions.values(), default=0) >= 30)
    known_at = time.time_ns()
    observer.idle(1.5)  # what was known then is older than a second now
    observer.signal(signal.SIGKILL)
    observer.ends()
    torn = LogReader(log)
    peer, _ = told_again(torn)
    assert torn.torn
    assert all(peer.replicas[bytes.fromhex(session)].state.n >= n for session, n in known.items())
    assert max(logged.log_ns for logged in torn) >= known_at - 10**9
    whole = swarm.folder / "whole.mcap"
    result = orion("log", "recover", log, whole, "--json").report()
    assert result["torn"].startswith("torn off")
    again, _ = told_again(LogReader(whole))
    assert again.fusion.digest() == peer.fusion.digest()
    robot.finish()
