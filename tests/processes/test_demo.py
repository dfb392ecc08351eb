"""``orion demo``: simulated robots in processes of their own map a world to the end, and the map is right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.kinematics import ORION_CHASSIS
from agent.map_files import load_map
from agent.world import World, load_world
from mapping.score import score
from mapping.sensor import ORION_RANGE

pytestmark = pytest.mark.processes


LONG = 300.0
"""Seconds for a run of one or two minutes."""


@pytest.mark.parametrize(("world", "robots"), [("paper", 2), pytest.param("rooms", 4, marks=pytest.mark.soak)])
def test_the_robots_of_a_demo_draw_their_world(orion, swarm, truth, world: str, robots: int) -> None:
    """Seen with the default noise: recall 1.000 (paper) and 0.996 (rooms), precision 1.000 for both."""
    out = swarm.folder / "map"
    base_port = swarm.base_port
    words = ["--world", world, "--speed", "max", "--base-port", base_port, "--out", out, "--json"]
    result = orion("demo", *words).report(LONG)
    assert result["converged"] is True
    assert all(robot["collisions"] == 0 and robot["driven_m"] > 1 for robot in result["simulation"]["robots"])
    assert not list(out.glob("*.tty"))
    assert [robot["id"] for robot in result["robots"]] == [f"r{k + 1}" for k in range(robots)]
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")
    assert truth.in_file(out / "map.npz") == result["observer"]["map_digest"]
    assert load_map(out / "map.npz").lattice.cell_mm == 20
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


@pytest.mark.parametrize("transport", ["zenoh", "zmq"])
def test_the_map_is_where_json_says_however_the_folder_was_named(orion, swarm, monkeypatch, transport: str) -> None:
    monkeypatch.chdir(swarm.folder)
    options = ["--robots", 1, "--speed", "max", "--transport", transport]
    words = [*options, "--base-port", swarm.base_port, "--out", "here", "--json"]
    result = orion("demo", *words).report()
    paths = [path for path in result["files"].values() if isinstance(path, str)]
    assert {Path(path) for path in paths} == {
        swarm.folder / "here" / f"map.{end}" for end in ("npz", "pgm", "yaml", "png")
    }
    assert all(Path(path).is_file() for path in [*paths, *result["files"]["robots"].values()])


def what_can_be_seen(world: World) -> NDArray[np.float64]:
    """The pieces of its walls, some 1 cm each, that a robot can have before it somewhere; shape (K, 4)."""
    pieces = []
    for x0, y0, x1, y1 in world.walls:
        corners = np.linspace([x0, y0], [x1, y1], 1 + math.ceil(math.hypot(x1 - x0, y1 - y0) / 0.01))
        pieces.append(np.hstack([corners[:-1], corners[1:]]))
    walls = np.concatenate(pieces)
    middles = (walls[:, :2] + walls[:, 2:]) / 2
    low, high = middles.min(axis=0), middles.max(axis=0)
    places = np.stack(np.meshgrid(*(np.arange(a, b, 0.1) for a, b in zip(low, high, strict=True))), -1).reshape(-1, 2)
    places = places[world.clearance(places) > ORION_CHASSIS.radius]
    seen = np.zeros(len(walls), np.bool_)
    for place in places:
        ahead = middles - place
        away = np.hypot(*ahead.T)
        near = np.flatnonzero(~seen & (away < ORION_RANGE))
        met = world.cast(np.tile(place, (len(near), 1)), np.arctan2(ahead[near, 1], ahead[near, 0]))
        seen[near[met > away[near] - 0.005]] = True
    return walls[seen]


@pytest.mark.soak
def test_six_robots_find_nearly_all_walls_of_an_office_by_themselves(orion, swarm) -> None:
    """No waypoints: each drives to the nearest frontier of what all know. Seen: recall 0.983, precision 1.000."""
    out = swarm.folder / "map"
    words = ["--world", "office", "--robots", 6, "--speed", "max", "--base-port", swarm.base_port]
    result = orion("demo", *words, "--out", out, "--json").report(3 * LONG)
    assert result["converged"] is True
    world = load_world("office")
    grade = score(load_map(out / "map.npz"), what_can_be_seen(world), tolerance=0.04)
    assert grade.recall is not None
    assert grade.recall >= 0.95
