"""``orion agent``: one robot, its body, its session."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from agent.body import Body
from agent.config import Config, RecordedBody, SerialBody
from agent.control import Control, Stopped
from agent.errors import UserError
from agent.links import open_bus
from agent.node import SOFTWARE, Node
from agent.team_mates import NoMates, TeamMates
from mapping.pose import QuantisedPose
from mapping.tiles import Tiles
from swarm.messages import Hello
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


def run_robot(config: Config, robot: str, control: Control) -> dict[str, Any]:
    """Be that robot until told to stop; gives its summary.

    Raises:
        UserError: the robot is not in the roster, its recording is bad, nobody answers at its serial port, or its
            network port is occupied.
    """
    if robot not in config.robots:
        known = ", ".join(config.roster) or "none"
        raise UserError("--robot", f"{robot!r} is not in the roster", f"robots there are: {known}")
    settings = config.robots[robot]
    start = settings.start.quantised() if settings.start is not None else None
    try:
        senses = _senses(config, robot, start or QuantisedPose(0, 0, 0), lambda: node.peer.fusion.tiles, control)
    except Stopped:
        nothing = dict.fromkeys(("updates", "tiles", "scans", "bytes_sent"), 0)
        return {"id": robot, "session": None, **nothing, "map_digest": None, "dropped": {}}
    try:
        try:
            config.rules().lattice.check_range(senses.body.sensor.max_range_mm)
        except ValueError as error:
            raise UserError(f"robots.{robot}.body", str(error), "give a shorter max_range") from None
        with open_bus(config, robot, config.roster.index(robot)) as bus:
            node = Node(
                bus,
                config.rules(),
                Hello(Hello.ROBOT, robot.encode(), SOFTWARE),
                body=senses.body,
                speed=senses.speed,
                listener=senses.mates,
                corrections=senses.mates.corrections,
            )
            descriptor = node.open_session(robot, start, settings.publish or config.publish)
            control.tell("ready", name=robot)
            try:
                node.run(control)
            except MapFullError as error:
                raise UserError(f"robots.{robot}", str(error), "use larger cells") from None
            own = node.peer.replicas[descriptor.session].state
            return {
                "id": robot,
                "session": descriptor.session.hex(),
                "updates": own.n,
                "tiles": len(own.cells),
                "scans": node.scans,
                **node.summary(),
            }
    finally:
        senses.body.close()


def _senses(
    config: Config, robot: str, start: QuantisedPose, fused_map: Callable[[], Tiles], control: Control
) -> Senses:
    """What the configuration says that this robot senses with.

    Raises:
        UserError: there is nothing, its recording is bad, or nobody answers at its serial port.
        Stopped: we are to end before anybody has answered.
    """
    match config.robots[robot].body:
        case RecordedBody() as settings:
            speed = math.inf if settings.speed == "max" else settings.speed
            return Senses(_recorded(robot, settings, start), NoMates(), speed)
        case SerialBody() as settings:
            return _serial(config, robot, settings, start, fused_map, control)
        case None:
            remedy = 'give it one, such as body = {kind = "serial", port = "/dev/ttyACM0"}'
            raise UserError(f"robots.{robot}", "has no body", remedy)


def _recorded(robot: str, settings: RecordedBody, start: QuantisedPose) -> Body:
    from agent.playback import RecordedBody as Playback
    from agent.playback import read, split

    recordings = read(Path(settings.path), poses=settings.poses, max_range=settings.max_range)
    if settings.robot >= len(recordings):
        raise UserError(settings.path, f"has {len(recordings)} robots", f"give robots.{robot}.body.robot below that")
    if settings.part > settings.parts:
        raise UserError(f"robots.{robot}.body", f"part {settings.part} of {settings.parts}", "count parts from 1")
    return Playback(split(recordings[settings.robot], settings.parts)[settings.part - 1], start)


def _serial(
    config: Config,
    robot: str,
    settings: SerialBody,
    start: QuantisedPose,
    fused_map: Callable[[], Tiles],
    control: Control,
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
        mates = TeamMates(robot, sensor, rules.model, rules.lattice)
        driver: Driver = NoDriver()
        if settings.drive and settings.waypoints:
            driver = WaypointDriver(settings.waypoints)
        elif settings.drive:
            driver = Explorer(fused_map, rules.lattice, mates.positions, look=blind_angle(sensor))
        body = Wired(link, hello, start, driver=driver, mask=mates, max_range=settings.max_range)
    except ValueError as error:
        link.close()
        raise UserError(settings.port, f"its hello makes no sense: {error}", "check the robot's firmware") from None
    except BaseException:
        link.close()
        raise
    return Senses(body, mates, 1.0)
