"""``orion demo``: simulated robots in processes of their own map a world to the end, and the map is right."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.map_files import load_map
from agent.world import load_world
from mapping.score import score

pytestmark = pytest.mark.processes


@pytest.mark.parametrize(("world", "robots"), [("paper", 2), ("rooms", 4)])
def test_the_robots_of_a_demo_draw_their_world(orion, swarm, truth, world: str, robots: int) -> None:
    """Seen with the default noise: recall 1.000 (paper) and 0.997 (rooms), precision 1.000 for both."""
    out = swarm.folder / "map"
    base_port = swarm.base_port
    words = ["--world", world, "--speed", "max", "--base-port", base_port, "--out", out, "--json"]
    result = orion("demo", *words).report()
    assert result["converged"] is True
    assert result["seconds"] < 60
    assert [robot["id"] for robot in result["robots"]] == [f"r{k + 1}" for k in range(robots)]
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")
    assert truth.in_file(out / "map.npz") == result["observer"]["map_digest"]
    grade = score(load_map(out / "map.npz"), load_world(world).walls, tolerance=0.04)
    assert grade.recall is not None
    assert grade.recall >= 0.95
    assert grade.precision is not None
    assert grade.precision >= 0.95


def test_the_resolved_configuration_beside_the_map_makes_the_same_map_again(orion, swarm, truth) -> None:
    first, second = swarm.folder / "first", swarm.folder / "second"
    words = ["demo", "--robots", 1, "--speed", "max", "--seed", 7, "--cell", 0.05, "--base-port", swarm.base_port]
    orion(*words, "--out", first, "--json").report()
    again = orion("demo", "-c", first / "orion.toml", "--speed", "max", "--seed", 7, "--out", second, "--json").report()
    assert again["converged"] is True
    assert truth.in_file(second / "map.npz") == truth.in_file(first / "map.npz")
    assert (second / "orion.toml").read_bytes() == (first / "orion.toml").read_bytes()


def test_the_map_is_where_json_says_however_the_folder_was_named(orion, swarm, monkeypatch) -> None:
    monkeypatch.chdir(swarm.folder)
    words = ["--robots", 1, "--speed", "max", "--base-port", swarm.base_port, "--out", "here", "--json"]
    result = orion("demo", *words).report()
    paths = [path for path in result["files"].values() if isinstance(path, str)]
    assert {Path(path) for path in paths} == {
        swarm.folder / "here" / f"map.{end}" for end in ("npz", "pgm", "yaml", "png")
    }
    assert all(Path(path).is_file() for path in [*paths, *result["files"]["robots"].values()])
