"""Whoever is no peer can read the map too: the program that docs/protocol.md gives does it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agent.map_files import load_map

pytestmark = pytest.mark.processes

DOCUMENT = Path(__file__).parents[2] / "docs" / "protocol.md"


def test_the_documented_program_reads_every_robots_map(orion, swarm) -> None:
    robots = {}
    for name, scans in (("r1", 40), ("r2", 50)):
        log = swarm.log(f"{name}.log", scans=scans)
        robots[name] = {"start": {}, "body": {"kind": "recording", "path": str(log), "speed": "max"}}
    toml = swarm.toml(robots, cell=0.05, swarm="lab")
    observer = orion("observe", "-c", toml, "--out", swarm.folder / "out", "--supervised")
    agents = [orion("agent", "-c", toml, "--robot", name, "--supervised") for name in robots]
    members = [*agents, observer]
    for each in members:
        each.shows("around", 2)
    for agent in agents:
        agent.order("go")
    for agent in agents:
        agent.shows("done", True)
    known = {session: n for agent in agents for session, n in [next(iter(agent.status["positions"].items()))]}
    for each in members:
        each.knows(lambda positions: positions == known)

    (program,) = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    words = [sys.executable, "-c", program, f"tcp/127.0.0.1:{swarm.base_port}", "lab"]
    told = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout

    reports = [each.finish() for each in members]
    (digest,) = {report["map_digest"] for report in reports}
    grid = load_map(Path(reports[-1]["files"]["npz"]))
    area = np.count_nonzero(grid.evidence > 62) * 0.05**2
    lines = dict(line.split(" ", 1) for line in told.splitlines())
    assert "r1" in {peer.split(".")[0] for peer in lines}
    assert set(lines.values()) == {f"{digest} {area:.2f} m2 occupied"}
