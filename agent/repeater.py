"""A robot of a log: its recorded sessions, said again under their own ids by a process that writes none of its own.

A recorded session is what its robot published (masks, corrections, tiles), and not only what it sensed: to sense it
again would make another one. So each update is taken and said as it was, when it was. Peers apply it as they did then,
and whoever missed some is served like by anybody else who holds a session; every session and the map come out bit for
bit. Nobody writes these sessions any more: nothing is ever added to them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent.body import BATCH
from agent.config import Config, LogBody, resolve
from agent.control import Control as Orders
from agent.errors import UserError
from agent.keeper import open_keeper
from agent.links import open_bus
from agent.log_reader import LogReader
from agent.node import SOFTWARE, NoBody, Node
from agent.probes import NoProbes, Probes
from agent.published import published_scans
from agent.readings import Readings
from swarm.messages import Hello, Session, Update
from swarm.radio import PROFILES
from swarm.session import Descriptor, SessionId
from swarm.told import Jump, Told


class Repeater(NoBody):
    """Says a robot's part of a log (implements ``Body``, but senses nothing).

    Args:
        path: the log.
        robot: whose sessions are said; the operators' decisions are said by all.
        say: takes what is due.

    Attributes:
        scans: how many there are in it.

    Raises:
        UserError: the file cannot be read, or holds no session of that robot.
    """

    def __init__(self, path: Path, robot: str, say: Callable[[Told], None]) -> None:
        super().__init__()
        self._say = say
        self._told: list[tuple[float, Told]] = []
        self._next = 0
        self.scans = 0
        sessions: dict[SessionId, Descriptor] = {}
        began: int | None = None
        for log_ns, told in LogReader(path).told():
            began = log_ns if began is None else began
            match told:
                case Session(content):
                    descriptor = Descriptor.decode(content)
                    if descriptor.robot != robot:
                        continue
                    sessions[descriptor.session] = descriptor
                case Update(session=session) | Jump(session=session) if session not in sessions:
                    continue
                case Update(form=Update.SCANS) as update if scans := published_scans(sessions[update.session], update):
                    self.scans += len(scans)
            self._told.append(((log_ns - began) / 1e9, told))
        if not sessions:
            raise UserError(path, f"holds no session of robot {robot}", "give the log that the robot is in")

    def read(self, until: float) -> Readings:
        """Say the next messages, at most ``BATCH``, that are due before ``until`` (seconds since the log began)."""
        for due, told in self._told[self._next : self._next + BATCH]:
            if due >= until:
                break
            self._next += 1
            self._say(told)
        return super().read(until)

    @property
    def progress(self) -> tuple[int, int]:  # type: ignore[override]
        """Messages said so far, and how many there are."""
        return self._next, len(self._told)

    @property
    def done(self) -> bool:  # type: ignore[override]
        """Whether all has been said."""
        return self._next == len(self._told)


def log_config(base: Config, path: Path, speed: float | str) -> Config:
    """The recorded swarm with each of its robots a repeater, on the network of ``base``.

    Raises:
        UserError: the file is none, or holds no session.
    """
    log = LogReader(path)
    table = log.swarm()
    robots = dict.fromkeys(
        Descriptor.decode(told.descriptor).robot for _, told in log.told() if isinstance(told, Session)
    )
    if not robots:
        raise UserError(path, "holds no session", "record a run with robots in it")
    order = [robot for robot in table.get("robots", {}) if robot in robots]
    body = {"kind": "log", "path": str(path.absolute()), "speed": speed}
    roster = {robot: {"body": body} for robot in dict.fromkeys([*order, *robots])}
    network = {"transport": base.transport, "base_port": base.base_port, "radio": base.radio}
    return resolve(table | network | {"robots": roster})


def run_repeater(
    config: Config, robot: str, settings: LogBody, control: Orders, state: Path | None, probes: Probes | NoProbes
) -> dict[str, Any]:
    """Be a robot of a log until told to stop; gives its summary.

    Raises:
        UserError: the log is bad, the network port is occupied, or the state is another process's.
    """

    def say(told: Told) -> None:
        node.repeat(told)

    body = Repeater(Path(settings.path), robot, say)
    with (
        open_keeper(config, robot, state) as keeper,
        open_bus(config, robot) as bus,
    ):
        node = Node(
            bus,
            config.rules(),
            Hello(Hello.ROBOT, robot.encode(), SOFTWARE),
            now=time.monotonic(),
            body=body,
            speed=float("inf") if settings.speed == "max" else settings.speed,
            profile=PROFILES[config.radio],
            keeper=keeper,
        )
        control.tell("ready", name=robot)
        node.run(control, probes.watch(node.peer, node.heard_bytes, node.lost))
        held = [replica for replica in node.peer.replicas.values() if replica.descriptor.robot == robot]
        return {
            "id": robot,
            "session": held[-1].descriptor.session.hex() if held else None,
            "updates": sum(replica.state.n for replica in held),
            "tiles": sum(len(replica.state.cells) for replica in held),
            "scans": body.scans,
            **node.summary(),
        }
