"""``orion simulate``: one world, and for each of its robots a serial port behind which its microcontroller answers.

The port is a pseudo-terminal with a link ``r1.tty`` to it, so that ``orion agent`` drives a simulated robot through the
same code as a real one. Laws kept here: one process, one loop, one clock for all robots; time stands still while nobody
listens, and a robot that nobody drives stands still.
"""

from __future__ import annotations

import io
import math
import select
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agent.config import Config
from agent.control import Control
from agent.errors import UserError
from agent.files import prepare_folder, write_whole
from agent.geometry import Floats
from agent.kinematics import ORION_CHASSIS
from agent.mcu_ports import McuPorts
from agent.microcontroller import Microcontroller
from agent.pace import PERIOD_MS, LockStep, Pace, RealTime
from agent.simulator import STEP_MS, Simulator
from agent.world import load_world
from transport.mcu_port import McuPort

_HEARTBEAT = 1.0
_STATUS_PERIOD = 0.5
_NAP = 0.02
"""Seconds after which the loop looks up at the latest, to see whether somebody has opened a port."""


class Emulator:
    """The world and its robots' microcontrollers, each at its port.

    Args:
        simulator: the world.
        robots: a microcontroller for each of its robots.
        ports: where each of them speaks.
        pace: how simulated time follows real time.
    """

    def __init__(
        self, simulator: Simulator, robots: Sequence[Microcontroller], ports: Sequence[McuPort], pace: Pace
    ) -> None:
        self._simulator = simulator
        self._robots = list(zip(robots, ports, strict=True))
        self._pace = pace
        self._beat_at = -math.inf
        self._sampled = False
        for robot, port in self._robots:
            port.send(robot.hello)

    @property
    def listened_to(self) -> list[tuple[Microcontroller, McuPort]]:
        """The robots whose port somebody has open."""
        return [(robot, port) for robot, port in self._robots if port.is_heard]

    def work(self, now: float, *, go: bool) -> None:
        """Do what is due.

        Args:
            now: real time, seconds.
            go: whether time may pass; ports are answered in any case.
        """
        if go:
            self._advance(now)  # to the present, so that a command counts from when it came
        self._listen()
        if go:
            self._advance(now)  # on to the next sample, if that was the last answer to come
        if now - self._beat_at >= _HEARTBEAT:
            self._beat_at = now
            for robot, port in self._robots:
                port.send(robot.beat(port.counters))

    def wait(self, now: float) -> None:
        """Sleep until something comes in or is due, or for a moment."""
        # A port that nobody has open would always look readable.
        ports = [port for _, port in self.listened_to]
        select.select(ports, [], [], min(max(0.0, self._pace.idle(now)), _NAP))

    def _listen(self) -> None:
        for robot, port in self._robots:
            for frame in port.receive():
                for answer in robot.hear(frame, self._simulator.now_ms):
                    port.send(answer)

    def _advance(self, now: float) -> None:
        listened_to = self.listened_to
        if not listened_to:
            return
        if not self._sampled:
            self._sample()
        for _ in range(self._pace.steps(now, answered=all(robot.has_answered for robot, _ in listened_to))):
            now_ms = self._simulator.now_ms
            self._simulator.targets[:] = [robot.wheels(now_ms) for robot, _ in self._robots]
            self._simulator.advance(now_ms + STEP_MS)
            if self._simulator.now_ms % PERIOD_MS == 0:
                self._sample()

    def _sample(self) -> None:
        self._sampled = True
        readings = self._simulator.sense()
        for robot, port in self._robots:
            port.send(robot.sample(readings))


def run_simulation(config: Config, folder: Path, control: Control, truth: Path | None = None) -> dict[str, Any]:
    """Be the world and the bodies of all robots of the roster until told to stop; gives the summary.

    Args:
        config: the swarm; the k-th robot of its roster starts at the world's k-th start, whatever it believes.
        folder: where the links to the ports are made.
        control: who says when. Time begins to pass when it says go.
        truth: an npz for the robots' true ways, or None: ``robots`` (N,), ``stamps_ms`` (S,), ``poses`` (S, N, 3) of x,
            y, yaw in metres and radians, and the world's ``walls`` (M, 4).

    Raises:
        UserError: there is no robot, the world is bad or has too few starts, a port's link or the truth cannot be made.
    """
    if not config.robots:
        raise UserError("robots", "there is none to simulate", "add a table robots.r1")
    if truth is not None:
        prepare_folder(truth.absolute().parent)
    settings = config.simulation
    world, sensor = load_world(settings.world), config.sensor.build()
    simulator = Simulator(
        world, settings.seed, len(config.roster), sensor, noise=settings.build_noise(), period=PERIOD_MS / 1000
    )
    robots = [Microcontroller(k, sensor, ORION_CHASSIS, PERIOD_MS) for k in range(len(config.roster))]
    pace: Pace = LockStep() if settings.speed == "max" else RealTime(settings.speed)
    with McuPorts(folder, config.roster) as ports:
        emulator = Emulator(simulator, robots, ports.ports, pace)
        control.tell("ready", name="the world", ports={robot: str(link) for robot, link in ports.links.items()})
        told_at = -math.inf
        while not control.stop:
            now = time.monotonic()
            emulator.work(now, go=control.go)
            if now - told_at >= _STATUS_PERIOD:
                told_at = now
                control.tell("status", seconds=simulator.now_ms / 1000, listened_to=len(emulator.listened_to))
            emulator.wait(now)
    if truth is not None:
        _save_truth(truth, config.roster, simulator, world.walls)
    return {
        "world": settings.world,
        "simulated_seconds": simulator.now_ms / 1000,
        "robots": [
            {"id": robot, "collisions": int(collisions), "driven_m": round(float(driven), 3)}
            for robot, collisions, driven in zip(config.roster, simulator.collisions, simulator.driven, strict=True)
        ],
    }


def _save_truth(path: Path, robots: Sequence[str], simulator: Simulator, walls: Floats) -> None:
    """See ``run_simulation``."""
    poses = np.array(simulator.truth).reshape(-1, len(robots), 3)
    content = io.BytesIO()
    np.savez(content, robots=np.array(robots), stamps_ms=np.array(simulator.stamps_ms), poses=poses, walls=walls)
    write_whole(path, content.getvalue())
