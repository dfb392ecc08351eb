"""``orion agent``: one robot, its body, its session."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.body import Body
from agent.config import Config, LogBody, RecordedBody, SerialBody
from agent.control import Control, Stopped
from agent.errors import UserError
from agent.journal import JournalFullError
from agent.keeper import open_keeper
from agent.links import open_bus
from agent.node import SOFTWARE, Node
from agent.own_session import OwnSession
from agent.probes import NO_PROBES, NoProbes, Probes
from agent.team_mates import NoMates, TeamMates
from swarm.messages import Hello
from swarm.radio import PROFILES
from swarm.writer import MapFullError

_GREETING = 10.0
"""Seconds within which a robot must say what it is made of."""


class Senses(NamedTuple):
    """What a robot senses with.

    Attributes:
        body: where its scans come from.
        mates: what it knows of the others' whereabouts.
        speed: how much faster than the clock the body's time runs.
    """

    body: Body
    mates: TeamMates | NoMates
    speed: float


def run_robot(
    config: Config, robot: str, control: Control, state: Path | None = None, probes: Probes | NoProbes = NO_PROBES
) -> dict[str, Any]:
    """Be that robot until told to stop; gives its summary.

    Args:
        config: the swarm.
        robot: its id.
        control: who says when.
        state: the folder where it remembers things (``agent.keeper``), or None.
        probes: who asks how it is.

    Raises:
        UserError: the robot is not in the roster, its recording is bad, nobody answers at its serial port, or its
            network port is occupied, or its state is another process's.
    """
    if robot not in config.robots:
        known = ", ".join(config.roster) or "none"
        raise UserError("--robot", f"{robot!r} is not in the roster", f"robots there are: {known}")
    settings = config.robots[robot]
    if isinstance(settings.body, LogBody):
        from agent.repeater import run_repeater

        return run_repeater(config, robot, settings.body, control, state, probes)
    start = settings.start.quantised() if settings.start is not None else None
    try:
        senses = _senses(config, robot, lambda: own, control)
    except Stopped:
        nothing = dict.fromkeys(("updates", "tiles", "scans", "bytes_sent"), 0)
        return {"id": robot, "session": None, **nothing, "map_digest": None, "dropped": {}}
    try:
        try:
            config.rules().lattice.check_range(senses.body.sensor.max_range_mm)
        except ValueError as error:
            raise UserError(f"robots.{robot}.body", str(error), "give a shorter max_range") from None
        with open_keeper(config, robot, state) as keeper, open_bus(config, robot) as bus:
            node = Node(
                bus,
                config.rules(),
                Hello(Hello.ROBOT, robot.encode(), SOFTWARE),
                now=time.monotonic(),
                body=senses.body,
                speed=senses.speed,
                profile=PROFILES[config.radio],
                listener=senses.mates,
                keeper=keeper,
            )
            own = node.open_session(robot, start, settings.publish or config.publish, senses.mates)
            control.tell("ready", name=robot)
            try:
                node.run(control, probes.watch(node.peer, node.heard_bytes, node.lost))
            except MapFullError as error:
                raise UserError(f"robots.{robot}", str(error), "use larger cells") from None
            except JournalFullError as error:
                raise UserError(f"robots.{robot}", str(error), "start its agent again") from None
            contributed = own.writer.replica.state
            return {
                "id": robot,
                "session": own.descriptor.session.hex(),
                "updates": contributed.n,
                "tiles": len(contributed.cells),
                "scans": node.scans,
                **node.summary(),
            }
    finally:
        senses.body.close()


def _senses(config: Config, robot: str, own: Callable[[], OwnSession], control: Control) -> Senses:
    """What the configuration says that this robot senses with.

    Raises:
        UserError: there is nothing, its recording is bad, or nobody answers at its serial port.
        Stopped: we are to end before anybody has answered.
    """
    match config.robots[robot].body:
        case RecordedBody() as settings:
            speed = math.inf if settings.speed == "max" else settings.speed
            return Senses(_recorded(robot, settings), NoMates(), speed)
        case SerialBody() as settings:
            return _serial(config, robot, settings, own, control)
        case LogBody():
            raise AssertionError("a log's robot senses nothing")
        case None:
            remedy = 'give it one, such as body = {kind = "serial", port = "/dev/ttyACM0"}'
            raise UserError(f"robots.{robot}", "has no body", remedy)


def _recorded(robot: str, settings: RecordedBody) -> Body:
    from agent.playback import RecordedBody as Playback
    from agent.playback import read, split

    recordings = read(Path(settings.path), poses=settings.poses, max_range=settings.max_range)
    if settings.robot >= len(recordings):
        raise UserError(settings.path, f"has {len(recordings)} robots", f"give robots.{robot}.body.robot below that")
    if settings.part > settings.parts:
        raise UserError(f"robots.{robot}.body", f"part {settings.part} of {settings.parts}", "count parts from 1")
    return Playback(split(recordings[settings.robot], settings.parts)[settings.part - 1])


def _serial(
    config: Config, robot: str, settings: SerialBody, own: Callable[[], OwnSession], control: Control
) -> Senses:
    from agent.driver import Driver, NoDriver, WaypointDriver
    from agent.explorer import Explorer, blind_angle
    from agent.scanner import sensor_of
    from agent.serial_body import SerialBody as Wired
    from agent.serial_body import greet
    from transport.mcu_link import McuLink

    rules = config.rules()
    try:
        link = McuLink(settings.port, baudrate=settings.baudrate)
    except ValueError as error:
        raise UserError(
            f"robots.{robot}.body.port", str(error), "give a device or a URL as pyserial takes it"
        ) from None
    try:
        hello = greet(link, _GREETING, where=settings.port, stopped=lambda: control.stop)
        sensor = sensor_of(hello, settings.max_range)
        mates = TeamMates(robot, sensor)
        driver: Driver = NoDriver()
        if settings.drive and settings.waypoints:
            driver = WaypointDriver(settings.waypoints)
        elif settings.drive:
            driver = Explorer(
                lambda: own().map,
                rules.lattice,
                lambda: mates.positions() if own().placed else np.zeros((0, 2)),
                look=blind_angle(sensor),
            )
        body = Wired(link, hello, driver=driver, max_range=settings.max_range)
    except ValueError as error:
        link.close()
        raise UserError(settings.port, f"its hello makes no sense: {error}", "check the robot's firmware") from None
    except BaseException:
        link.close()
        raise
    return Senses(body, mates, 1.0)
