"""``orion doctor``: whether this machine, a configuration and the robots on its serial ports are as they should be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from agent import doctor_link, doctor_machine
from agent.config import Config, SerialBody
from agent.finding import Finding


def examine(port: str | None, config: Config | None, folder: Path, baudrate: int | None = None) -> Iterator[Finding]:
    """Look at everything that was asked for; findings come as they are made.

    Args:
        port: the one serial port to be tested; None is those of the configuration, and the machine itself.
        config: the swarm.
        folder: where the swarm's files go.
        baudrate: bits a second on ``port``; None is what the configuration says of it, else 115200.
    """
    if port is None:
        yield from doctor_machine.machine(folder)
    local: set[str] = set()
    if config is not None:
        for robot, host, number in zip(config.roster, config.hosts, range(config.base_port, 65536), strict=False):
            lives_here, finding = doctor_machine.network_port(robot, host, number)
            local |= {robot} if lives_here else set()
            yield finding
    wired = _wired(config)
    if port is not None:
        known = {body.port: body.baudrate for body in wired.values()}
        rate = baudrate or known.get(port) or SerialBody(kind="serial", port=port).baudrate
        yield from doctor_link.link(port, rate)
        return
    for robot, body in wired.items():
        if robot in local:
            yield from doctor_link.link(body.port, body.baudrate)


def _wired(config: Config | None) -> dict[str, SerialBody]:
    """The robots behind serial ports."""
    robots = {} if config is None else config.robots
    return {name: robot.body for name, robot in robots.items() if isinstance(robot.body, SerialBody)}
