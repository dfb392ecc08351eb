"""``orion agent``: one robot, its body, its session."""

from __future__ import annotations

import math
from typing import Any

from agent.body import Body
from agent.config import Config, RecordedBody, SimulatedBody
from agent.control import Control
from agent.errors import UserError
from agent.links import open_bus
from agent.node import SOFTWARE, Node
from mapping.pose import QuantisedPose
from swarm.messages import Hello
from swarm.writer import MapFullError


def run_robot(config: Config, robot: str, control: Control) -> dict[str, Any]:
    """Be that robot until told to stop; gives its summary.

    Raises:
        UserError: the robot is not in the roster, its recording or world is bad, or its port is occupied.
    """
    if robot not in config.robots:
        known = ", ".join(config.roster) or "none"
        raise UserError("--robot", f"{robot!r} is not in the roster", f"robots there are: {known}")
    settings = config.robots[robot]
    start = settings.start.quantised() if settings.start is not None else None
    body = build_body(config, robot, start or QuantisedPose(0, 0, 0))
    try:
        config.rules().lattice.check_range(body.sensor.max_range_mm)
    except ValueError as error:
        raise UserError(f"robots.{robot}.body", str(error), "give a shorter max_range") from None
    speed = math.inf if settings.body.speed == "max" else settings.body.speed
    hello = Hello(Hello.ROBOT, robot.encode(), SOFTWARE)
    with open_bus(config, robot, config.roster.index(robot)) as bus:
        node = Node(bus, config.rules(), hello, body=body, speed=speed)
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


def build_body(config: Config, robot: str, start: QuantisedPose) -> Body:
    """The body that the configuration names.

    Raises:
        UserError: its recording or world is bad.
    """
    match config.robots[robot].body:
        case RecordedBody() as settings:
            return _recorded(robot, settings, start)
        case SimulatedBody() as settings:
            from agent.simulation import SimulatedBody as Simulation
            from agent.world import load_world

            index = config.roster.index(robot) if settings.index is None else settings.index
            sensor = config.sensor.build()
            return Simulation(load_world(settings.world), index, sensor, start=start, seed=settings.seed)


def _recorded(robot: str, settings: RecordedBody, start: QuantisedPose) -> Body:
    from pathlib import Path

    from agent.playback import RecordedBody as Playback
    from agent.playback import read, split

    recordings = read(Path(settings.path), poses=settings.poses, max_range=settings.max_range)
    if settings.robot >= len(recordings):
        raise UserError(settings.path, f"has {len(recordings)} robots", f"give robots.{robot}.body.robot below that")
    if settings.part > settings.parts:
        raise UserError(f"robots.{robot}.body", f"part {settings.part} of {settings.parts}", "count parts from 1")
    return Playback(split(recordings[settings.robot], settings.parts)[settings.part - 1], start)
