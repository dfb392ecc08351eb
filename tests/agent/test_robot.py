"""One robot's process: what its configuration makes of it, and what is said where it makes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

import agent.serial_body
import transport.mcu_link
from agent.config import Config, resolve
from agent.control import Control
from agent.driver import NoDriver, WaypointDriver
from agent.errors import UserError
from agent.explorer import Explorer
from agent.kinematics import ORION_CHASSIS
from agent.microcontroller import Microcontroller
from agent.robot import Senses, _senses, run_robot
from agent.team_mates import NoMates, TeamMates
from mapping.pose import QuantisedPose
from mapping.sensor import Beam, Sensor, orion

START = QuantisedPose(1000, 2000, 16_384)


def undriven():
    """Nothing is driven here: nobody asks for the session's map."""
    raise AssertionError


def swarm(**body: Any) -> Config:
    return resolve({"robots": {"r1": {"body": {"kind": "serial", "port": "r1.tty"} | body}}})


@pytest.fixture
def wired(link, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Senses]:
    """The senses of a robot at whose port one with these sensors answers."""

    def make(sensor: Sensor | None = None, **body: Any) -> Senses:
        hello = Microcontroller(0, sensor or orion(1.2), ORION_CHASSIS, 100).hello
        monkeypatch.setattr(transport.mcu_link, "McuLink", lambda port, *, baudrate: link)
        monkeypatch.setattr(agent.serial_body, "greet", lambda link, timeout, *, where, stopped: hello)
        return _senses(swarm(**body), "r1", undriven, Control())

    return make


def test_a_robot_behind_a_port_has_the_sensor_that_it_says_within_the_trusted_range(wired) -> None:
    senses = wired(max_range=0.6)
    assert senses.body.sensor == orion(0.6)
    senses.body.place(START)
    assert senses.body.pose == START.pose()
    assert senses.speed == 1.0
    assert isinstance(senses.mates, TeamMates)


@pytest.mark.parametrize(
    ("body", "driver"),
    [
        ({}, Explorer),
        ({"waypoints": [[1.0, 2.0]]}, WaypointDriver),
        ({"drive": False}, NoDriver),
        ({"drive": False, "waypoints": [[1.0, 2.0]]}, NoDriver),
    ],
)
def test_a_robot_explores_visits_its_waypoints_or_is_driven_by_somebody_else(wired, body, driver) -> None:
    assert type(wired(**body).body._driver) is driver


def test_a_hello_that_makes_no_sense_is_told_and_the_port_let_go(wired, link) -> None:
    too_wide = Sensor((Beam(0, 0, 0, 16_384),), 800)
    object.__setattr__(too_wide, "beams", (Beam(0, 0, 0, 16_385),))
    with pytest.raises(UserError, match=r"r1\.tty: its hello makes no sense: .*half_width.*; check the robot's firm"):
        wired(too_wide)
    assert link.closed


def test_a_robot_that_is_told_to_end_while_nobody_answers_ends_at_once(link, monkeypatch) -> None:
    """Ctrl-C while a swarm started once had to wait for ten seconds, and then complained of the robot."""
    monkeypatch.setattr(transport.mcu_link, "McuLink", lambda port, *, baudrate: link)
    control = Control()
    control.stop = True
    report = run_robot(swarm(), "r1", control)
    assert (report["id"], report["session"], report["map_digest"], report["scans"]) == ("r1", None, None, 0)
    assert link.closed


def test_the_wheels_are_let_go_of_when_the_process_cannot_go_on(wired, link, monkeypatch) -> None:
    wired()

    def no_bus(*_: object) -> None:
        raise UserError("here", "is no bus", "take a bicycle")

    monkeypatch.setattr("agent.robot.open_bus", no_bus)
    with pytest.raises(UserError, match="is no bus"):
        run_robot(swarm(), "r1", Control())
    assert link.closed


def test_a_range_that_is_too_long_for_the_cells_is_told_with_the_robots_key(wired) -> None:
    wired(orion(20.0))
    config = resolve({"cell": 0.001, "robots": {"r1": {"body": {"kind": "serial", "port": "a", "max_range": 20.0}}}})
    with pytest.raises(UserError, match=r"robots\.r1\.body: .*4095 cells.*; give a shorter max_range"):
        run_robot(config, "r1", Control())


def test_a_robot_without_a_body_is_told_how_to_give_it_one() -> None:
    with pytest.raises(UserError, match=r"robots\.r1: has no body; give it one, such as body = "):
        run_robot(resolve({"robots": {"r1": {}}}), "r1", Control())


def test_a_recorded_robot_as_fast_as_it_can_has_no_team_mates_to_mask(tmp_path) -> None:
    (tmp_path / "run.log").write_text("FLASER 2 1.0 2.0 0 0 0 0 0 0 7.5 host 7.5\n")
    body = {"kind": "recording", "path": str(tmp_path / "run.log"), "speed": "max"}
    senses = _senses(resolve({"robots": {"r1": {"body": body}}}), "r1", undriven, Control())
    assert senses.speed == math.inf
    assert isinstance(senses.mates, NoMates)
    assert senses.body.progress == (0, 1)
