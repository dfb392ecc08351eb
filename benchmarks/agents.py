"""Real processes over Zenoh on this machine: 2, 5 and 10 agents that scan at 10 Hz.

Each process is the loop that ships (``agent.node.Node``) with a body that makes a five-beam scan each 100 ms. A scan is
stamped with the clock of the machine: every other process can tell how old it is when it is in its fused map. All begin
at one word, so that all scans of a tenth of a second are made at once, the worst case. What is counted is a window of
steady work, every scan of every robot at every other; how many of them there should be, their makers say.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from agent.control import Supervised
from agent.kernel import compiled
from agent.node import Node
from agent.readings import Readings
from agent.team_mates import NoMates
from benchmarks.inputs import ORION, orion_walk
from benchmarks.table import Row
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import NO_RETURN
from swarm.messages import Hello, Update
from swarm.scan_block import decode_scans
from swarm.session import Descriptor, Rules
from swarm.timers import LAN
from transport.zenoh_bus import ZenohBus

SIZES = (2, 5, 10)
BASE_PORT = 22300
_SETTLING = 5.0
_SECONDS = 20.0
_GRACE = 2.0
"""Seconds of work before the window that counts, of the window, and after it for what is still on its way."""

_PATIENCE = 60.0
_HZ = 10
_NONE = Readings.empty(len(ORION.beams))


class Body:
    """A body that senses ten times a second; a scan's stamp is the machine's clock, which all processes share."""

    sensor = ORION
    patience = 0.02
    status = ""
    done = False
    progress = (0, 0)

    def __init__(self, seed: int) -> None:
        walk = orion_walk(100_000, seed)
        self._poses = (walk.poses * (1e-3, 1e-3, math.tau / 65536)).astype(np.float64)
        self._ranges = np.where(walk.ranges == NO_RETURN, np.inf, walk.ranges / 1000)
        self._next = 0

    def place(self, start: QuantisedPose) -> None:
        """It walks in the common frame."""

    def read(self, until: float) -> Readings:
        """The scans that are due."""
        first, self._next = self._next, max(self._next, int(until * _HZ))
        if first == self._next:
            return _NONE
        late = until - (np.arange(first, self._next) + 1) / _HZ  # it was sensed when it was due, not when it is read
        stamps = (time.monotonic() - late) * 1e3
        rows = slice(first, self._next)
        return Readings(stamps.astype(np.int64), self._poses[rows], self._ranges[rows])

    def close(self) -> None:
        """Nothing moves."""


class Heard:
    """When which scan came into the fused map: what is needed to say how old it was, looked at when all is over."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._updates: list[tuple[bool, float, bytes]] = []

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """An update was applied."""
        self._updates.append((descriptor.robot == self._robot, time.monotonic(), update.payload))

    def scans(self, *, own: bool) -> list[tuple[float, float]]:
        """Of each scan, when it was made and how old it was, in seconds."""
        return [
            (stamp / 1e3, at - stamp / 1e3)
            for is_own, at, payload in self._updates
            if is_own is own
            for stamp in decode_scans(payload, len(ORION.beams), ORION.max_range_mm).stamps_ms.tolist()
        ]


class Computing:
    """The share of a core that this process uses once it has settled, its start not included."""

    def __init__(self, control: Supervised) -> None:
        self._control = control
        self._settled_at = math.inf
        self._begin: tuple[float, float] | None = None

    def __call__(self, now: float) -> None:
        """A turn of the loop."""
        if self._control.go and self._settled_at == math.inf:
            self._settled_at = now + _SETTLING
        if now >= self._settled_at and self._begin is None:
            self._begin = now, time.process_time()

    def share(self) -> float:
        """Of a core, until now."""
        if self._begin is None:
            raise RuntimeError("told to end before the work had settled")
        at, computed = self._begin
        return (time.process_time() - computed) / (time.monotonic() - at)


def work(number: int, port: int) -> None:
    """Be one agent until told to end; then print what was measured."""
    robot = f"r{number}"
    heard = Heard(robot)
    rules = Rules(Lattice(20), EvidenceModel())
    compiled()
    listen = [f"tcp/127.0.0.1:{port + number}"]
    connect = [f"tcp/127.0.0.1:{port + other}" for other in range(number)]
    with ZenohBus("benchmark", robot, listen=listen, connect=connect) as bus:
        node = Node(
            bus,
            rules,
            Hello(Hello.ROBOT, robot.encode(), b"benchmark"),
            now=time.monotonic(),
            body=Body(number),
            listener=heard,
        )
        node.open_session(robot, QuantisedPose(0, 0, 0), "auto", NoMates())
        control = Supervised()
        computing = Computing(control)
        node.run(control, watch=computing)
        share = computing.share()
    result = {
        "made": [stamp for stamp, _ in heard.scans(own=True)],
        "heard": heard.scans(own=False),
        "share": share,
        "rss": peak_memory(),
    }
    sys.stdout.write(json.dumps({"event": "result", **result}) + "\n")


def peak_memory() -> int:
    """The most memory that this process has had resident, in kB; ``getrusage`` would count its parent's too."""
    (peak,) = re.findall(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(peak)


def measure() -> list[Row]:
    """Latency beyond the update period, computing and memory an agent."""
    rows = []
    for group, size in enumerate(SIZES):
        window, results = _run(size, BASE_PORT + 20 * group)
        heard = [scan for result in results for scan in result["heard"]]
        ages = np.array([age for made, age in heard if window(made)]) * 1e3
        due = (size - 1) * sum(window(made) for result in results for made in result["made"])
        beyond = ages - LAN.update_period * 1e3
        shares = [result["share"] * 100 for result in results]
        name = f"{size} agents"
        rows += [
            Row(
                f"{name}: scan to a peer's fused map, p50",
                float(np.percentile(ages, 50)),
                "ms",
                note=f"{len(ages)} of {due} scans",
            ),
            Row(f"{name}: the same, p99", float(np.percentile(ages, 99)), "ms"),
            Row(f"{name}: p99 beyond the update period", float(np.percentile(beyond, 99)), "ms"),
            Row(f"{name}: computing an agent", float(np.median(shares)), "% of a core", min(shares), max(shares)),
            Row(f"{name}: memory an agent", max(result["rss"] for result in results) / 1e3, "MB"),
        ]
    return rows


class _Agent:
    """One process; a thread reads what it says, so that it never waits for us."""

    def __init__(self, number: int, port: int) -> None:
        command = [sys.executable, "-m", "benchmarks.agents", "--port", str(port), "--number", str(number)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.around = 0
        self.result: dict[str, Any] | None = None
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            event = json.loads(line)
            if event["event"] == "result":
                self.result = event
            self.around = event.get("around", self.around)

    def order(self, word: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()


def _run(size: int, port: int) -> tuple[Callable[[float], bool], list[dict[str, Any]]]:
    """What the agents measured, and whether a time lies in the window that counts."""
    agents = [_Agent(number, port) for number in range(size)]
    try:
        deadline = time.monotonic() + _PATIENCE
        while any(agent.around < size - 1 for agent in agents):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{size} agents do not all see each other after {_PATIENCE} s")
            time.sleep(0.1)
        for word in ("kernel", "go"):
            for agent in agents:
                agent.order(word)
        begin = time.monotonic() + _SETTLING
        time.sleep(_SETTLING + _SECONDS + _GRACE)
        for agent in agents:
            agent.order("finish")
        for agent in agents:
            agent.process.wait(_PATIENCE)
            agent.reader.join(_PATIENCE)
    finally:
        for agent in agents:
            agent.process.kill()
    results = [agent.result for agent in agents if agent.result is not None]
    if len(results) < size:
        raise RuntimeError(f"{size - len(results)} of {size} agents said no result")
    return lambda made: begin <= made < begin + _SECONDS, results


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int)
    parser.add_argument("--port", type=int)
    arguments = parser.parse_args()
    work(arguments.number, arguments.port)
