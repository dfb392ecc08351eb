"""``orion config``: what it writes is what the program takes, and means the defaults where it says so."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.cli import app
from agent.config import Config, SerialBody, load
from agent.config_command import template
from agent.errors import UserError
from agent.launch import demo_config


def run(*words: object) -> str:
    result = CliRunner().invoke(app, [*map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_a_written_configuration_is_taken_and_names_its_robots(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    run("config", "init", file, "--robots", 3)
    config = load(file, {}, {})
    assert config.roster == ["r1", "r2", "r3"]
    assert all(robot.start is not None and robot.body is not None for robot in config.robots.values())


def test_a_configuration_for_a_world_has_its_starts_and_runs_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    assert f"orion simulate -c {file}" in run("config", "init", file, "--world", "paper")
    config, demo = load(file, {}, {}), demo_config(Config(), world="paper", robots=None, speed=10.0, seed=1)
    assert [robot.start for robot in config.robots.values()] == [robot.start for robot in demo.robots.values()]
    bodies = [robot.body for robot in config.robots.values()]
    assert bodies == [SerialBody(kind="serial", port=str(tmp_path / f"{name}.tty")) for name in config.roster]
    assert config.simulation == demo.simulation


def test_a_world_in_a_file_is_found_from_anywhere_and_too_many_robots_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = 'my "world".yaml'
    (tmp_path / world).write_text("{walls: [[0, 0, 1, 0]], starts: [{x: 0.5, y: 1, yaw_deg: 0}]}")
    monkeypatch.chdir(tmp_path)
    run("config", "init", "lab.toml", "--world", f"./{world}")
    assert load(tmp_path / "lab.toml", {}, {}).simulation.world == str(tmp_path / world)
    with pytest.raises(UserError, match="has 2 starts"):
        run("config", "init", "other.toml", "--world", "paper", "--robots", 3)
    assert not (tmp_path / "other.toml").exists()


def test_what_the_comments_call_defaults_are_the_defaults() -> None:
    settings = re.sub(r"(?m)^# (?=[a-z_]+ = |\[)", "", template(1))
    told = tomllib.loads(settings)
    defaults = Config().model_dump()
    for key in set(told) - {"swarm", "robots", "observers"}:
        value = told[key]
        mine = {name: defaults[key][name] for name in value} if isinstance(value, dict) else defaults[key]
        assert value == mine, key
    assert {"sensor"} == set(defaults) - set(told), "every key is told, but the sensor: a robot tells that itself"


def test_a_file_that_is_there_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("mine")
    with pytest.raises(UserError, match="is there already"):
        run("config", "init", file)
    assert file.read_text() == "mine"


def test_check_tells_what_is_meant(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    run("config", "init", file)
    said = run("config", "check", file)
    assert "cells of 0.02 m" in said
    assert "127.0.0.1:7451" in said
    assert json.loads(run("config", "check", file, "--json"))["base_port"] == 7450


def test_check_names_what_is_wrong(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("cel = 0.02")
    with pytest.raises(UserError, match="did you mean cell"):
        run("config", "check", file)
