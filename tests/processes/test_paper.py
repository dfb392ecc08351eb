"""``orion paper``: the paper's experiments by real processes, to the last figure."""

from __future__ import annotations

import json
import socket

import pytest
from PIL import Image

from agent.config import resolve
from agent.paper_experiments import MULTI, Experiment, conduct
from agent.paper_measures import cloud_by_us, worth

pytestmark = pytest.mark.processes


def test_the_papers_experiments_are_done_again_from_one_command(orion, swarm, truth) -> None:
    """Seen with the default noise: recall and precision 1.000; the obstacle's cells go from 0.64 to 0.02."""
    out = swarm.folder / "report"
    command = orion("paper", "--quick", "--out", out, "--base-port", swarm.base_port, "--json")
    assert command.ends(within=240) == 0, command.errors
    result = command.result
    assert command.errors == ""
    for name in result["files"]:
        if name.endswith(".png"):
            with Image.open(out / name) as picture:
                picture.load()
    assert [name for name in result["files"] if name.startswith("figure")] == [
        f"figure-{number}.png" for number in (3, 5, 6, 8, 9)
    ]
    table = json.loads((out / "table.json").read_bytes())
    assert [(row["experiment"], row["robots"]) for row in table["runs"]] == [("A", 1), ("B", 2)]
    for row in table["runs"]:
        for pipeline in ("paper", "ours"):
            assert row[pipeline]["recall"] >= 0.95
            assert row[pipeline]["precision"] >= 0.95
            assert row[pipeline]["wall_error_mean"] < 0.01
    assert truth.in_file(out / "runs" / "B-paper-default" / "map.npz") == table["runs"][1]["map_digest"]
    assert table["fading"]["ours"]["p_peak_max"] > 0.65 > table["fading"]["ours"]["p_end_max"]
    assert table["fading"]["ours"]["cells_still_occupied"] == 0
    assert not list(out.rglob("*.tmp"))


def test_with_true_poses_two_robots_draw_both_spaces(swarm) -> None:
    """Seen: recall and precision 1.000, and hit points 0.4 mm from the walls."""
    run = conduct(
        Experiment(MULTI, "paper", "ideal"), resolve({"base_port": swarm.base_port}), swarm.folder / "run", seed=1
    )
    found = worth(run, cloud_by_us, run.grid)
    assert found.recall >= 0.97
    assert found.precision >= 0.95
    assert found.wall_error_p95 < 0.002


def test_an_occupied_port_is_told_in_one_line(orion, swarm) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", swarm.base_port))
        other.listen()
        command = orion("paper", "--out", swarm.folder / "report", "--base-port", swarm.base_port)
        assert command.ends() == 2
    assert command.errors.count("\n") == 1
    assert "give another base_port" in command.errors
    assert not list((swarm.folder / "report").glob("*.*"))
