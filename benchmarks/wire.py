"""Bytes that robots send for the same run: updates, against full grids at 1 Hz and against a laser scan a metre."""

from __future__ import annotations

import numpy as np

from benchmarks.inputs import ORION, logs, orion_walk
from benchmarks.integration import kernels
from benchmarks.swarm_in_process import Swarm
from benchmarks.table import Row
from mapping.evidence import EvidenceModel
from mapping.grid import Grid
from mapping.integrate import integrated
from mapping.lattice import Lattice, TileKey
from mapping.scan import Scans
from mapping.sensor import Sensor
from swarm.radio import PROFILES

_RADIO = "digimesh-3hop"
_MINUTES = 2


def measure() -> list[Row]:
    """An Orion's minutes among three, updates each second; and a laser's whole log."""
    kernel = kernels().get("fast") or kernels()["NumPy"]
    seconds = _MINUTES * 60
    swarm = Swarm(3, kernel, profile=PROFILES[_RADIO])
    walks = [orion_walk(10 * seconds, robot) for robot in range(3)]
    for second in range(seconds):
        for robot, walk in enumerate(walks):
            swarm.sense(robot, walk[10 * second : 10 * second + 10])
        swarm.run(1.0, tick=0.1)
    settled = swarm.settle(120.0)
    digests = {peer.fusion.digest() for peer in swarm.peers.values()}
    ours = swarm.sent.total() / 3
    grids = _full_grids(walks[0], ORION, Lattice(20), every=10)
    agreed = "all agree" if settled is not None and len(digests) == 1 else "they do not agree"
    rows = [
        Row(
            f"an Orion, {_MINUTES} minutes: updates and digests",
            ours / 1e6,
            "MB",
            note=f"{agreed}; payload bytes, {_RADIO}",
        ),
        Row(
            f"an Orion, {_MINUTES} minutes: full grids at 1 Hz",
            grids / 1e6,
            "MB",
            ratio=grids / ours,
            note="int8, as OccupancyGrid",
        ),
    ]
    log = logs()[0]
    swarm = Swarm(2, kernel, sensor=log.sensor, cell_mm=50)
    for first in range(0, len(log.scans), 4):
        swarm.sense(0, log.scans[first : first + 4])
        swarm.run(0.1)
    ours = swarm.sent["r0"]
    path = np.abs(np.diff(log.poses[:, :2], axis=0))
    metres = float(np.hypot(path[:, 0], path[:, 1]).sum())
    scan_a_metre = metres * log.scans.beams * 8  # LaserScan: ranges and intensities, float32
    grids = _full_grids(log.scans, log.sensor, Lattice(50), every=1)
    return [
        *rows,
        Row(f"{log.name}: every scan, as updates", ours / 1e6, "MB"),
        Row(f"{log.name}: one LaserScan a metre", scan_a_metre / 1e6, "MB", ratio=scan_a_metre / ours),
        Row(f"{log.name}: a full grid with every scan", grids / 1e6, "MB", ratio=grids / ours),
    ]


def _full_grids(scans: Scans, sensor: Sensor, lattice: Lattice, every: int) -> float:
    """Bytes of the map as a dense grid of one byte a cell, sent after every so many scans while it grows."""
    kernel = kernels().get("fast") or kernels()["NumPy"]
    tiles: dict[TileKey, np.ndarray] = {}
    total = 0.0
    step = max(every, len(scans) // 200)  # its size is looked at 200 times
    for first in range(0, len(scans), step):
        tiles |= integrated(tiles, scans[first : first + step], sensor, EvidenceModel(), lattice, kernel)
        total += Grid.of(tiles, lattice).evidence.size * (step / every)
    return total
