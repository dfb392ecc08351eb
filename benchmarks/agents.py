"""Real processes over Zenoh on this machine: 2, 5 and 10 agents that scan at 10 Hz.

Each process is the loop that ships (``agent.node.Node``) with a body that makes a five-beam scan each 100 ms. A scan is
stamped with the clock of the machine: every other process can tell how old it is when it is in its fused map.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import threading
import time
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
_SECONDS = 20.0
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


class Ages:
    """How old each scan of others is when it is in the fused map, in seconds."""

    def __init__(self, robot: str) -> None:
        self.seconds: list[float] = []
        self._robot = robot

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """An update was applied."""
        now = time.monotonic()
        if descriptor.robot != self._robot:
            stamps = decode_scans(update.payload, len(ORION.beams), ORION.max_range_mm).stamps_ms
            self.seconds += (now - stamps / 1e3).tolist()


def work(number: int, port: int) -> None:
    """Be one agent until told to end; then print what was measured."""
    robot = f"r{number}"
    ages = Ages(robot)
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
            listener=ages,
        )
        node.open_session(robot, QuantisedPose(0, 0, 0), "auto", NoMates())
        begin, computed = time.monotonic(), time.process_time()
        node.run(Supervised())
        share = (time.process_time() - computed) / (time.monotonic() - begin)
    result = {"ages": ages.seconds, "share": share, "rss": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}
    sys.stdout.write(json.dumps({"event": "result", **result}) + "\n")


def measure() -> list[Row]:
    """Latency beyond the update period, computing and memory an agent."""
    rows = []
    for group, size in enumerate(SIZES):
        results = _run(size, BASE_PORT + 20 * group)
        ages = np.array([age for result in results for age in result["ages"]]) * 1e3
        beyond = ages - LAN.update_period * 1e3
        shares = [result["share"] * 100 for result in results]
        name = f"{size} agents"
        rows += [
            Row(
                f"{name}: scan to a peer's fused map, p50",
                float(np.percentile(ages, 50)),
                "ms",
                note=f"{len(ages)} scans",
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


def _run(size: int, port: int) -> list[dict[str, Any]]:
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
        time.sleep(_SECONDS)
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
    return results


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int)
    parser.add_argument("--port", type=int)
    arguments = parser.parse_args()
    work(arguments.number, arguments.port)
