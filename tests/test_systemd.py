"""The units that systemd starts robots and observers with: systemd takes them, and we take what they say."""

from __future__ import annotations

import configparser
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

from agent import cli

ROOT = Path(cli.__file__).parents[1]
UNITS = sorted((ROOT / "systemd").glob("*.service"))
ORION = "/opt/orion/bin/orion"


def service(unit: Path) -> configparser.SectionProxy:
    """The unit's section ``[Service]``; of keys that are there several times, the last."""
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(unit)
    return parser["Service"]


def test_there_is_one_for_robots_and_one_for_observers() -> None:
    assert [unit.name for unit in UNITS] == ["orion-observer.service", "orion@.service"]


def test_they_are_installed_with_the_wheel() -> None:
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["shared-data"] == {"systemd": "share/orion-swarm/systemd"}


@pytest.mark.units
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_finds_nothing_wrong_with_them(unit: Path, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze")
    copy = tmp_path / unit.name.replace("@", "@r1")
    copy.write_text(unit.read_text().replace(ORION, sys.executable))  # verify looks whether the command is there
    words = ["systemd-analyze", "verify", "--man=no", str(copy)]
    verified = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (verified.returncode, verified.stderr) == (0, "")


@pytest.mark.units
def test_systemd_finds_what_is_wrong(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze")
    unit = tmp_path / "wrong.service"
    unit.write_text("[Service]\nType=notify\nWatchdog=30\nExecStart=/nowhere/orion\n")
    words = ["systemd-analyze", "verify", "--man=no", str(unit)]
    verified = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert verified.returncode != 0
    assert "Watchdog" in verified.stderr


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_the_commands_in_them_are_ours(unit: Path) -> None:
    program, name, *words = service(unit)["ExecStart"].split()
    assert program == ORION
    command = typer.main.get_command(cli.app).commands[name]
    taken = command.make_context(name, [word.replace("%i", "r1") for word in words]).params
    assert str(taken["config"]) == "/etc/orion/swarm.toml"
    assert str(taken["state"]) == "${STATE_DIRECTORY}"
    assert taken.get("robot", "r1") == "r1"


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_restarts_what_fails_or_hangs(unit: Path) -> None:
    section = service(unit)
    assert (section["Type"], section["Restart"], section["DynamicUser"]) == ("notify", "on-failure", "yes")
    assert int(section["WatchdogSec"]) > 0
