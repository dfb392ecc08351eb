"""Many peers in one process under fake time: what it takes until all hold the same map, and how that grows.

Each robot makes one second of scans, ten a second; then they talk until all agree.
"""

from __future__ import annotations

import resource
from pathlib import Path

from benchmarks.inputs import orion_walk
from benchmarks.integration import kernels
from benchmarks.swarm_in_process import Swarm
from benchmarks.table import Row, cpu_seconds

SIZES = (10, 50, 200)
_PATIENCE = 60.0


def measure() -> list[Row]:
    """For each number of peers: time to agree, messages, bytes, memory, and the computing of this process."""
    rows = []
    for size in SIZES:
        rows += of_size(size)
    return rows


def of_size(robots: int) -> list[Row]:
    """The rows of one swarm."""
    kernel = kernels().get("fast") or kernels()["NumPy"]
    taken: list[float | None] = []

    def work() -> None:
        for robot in range(robots):
            swarm.sense(robot, orion_walk(10, robot))
        taken.append(swarm.settle(_PATIENCE))

    before = _resident()
    swarm = Swarm(robots, kernel)
    computing = cpu_seconds(work)
    held = _resident() - before
    agreed = taken[0] is not None and len({peer.fusion.digest() for peer in swarm.peers.values()}) == 1
    name = f"{robots} peers"
    return [
        Row(f"{name}: until all agree", taken[0] or _PATIENCE, "s", note="" if agreed else "they do not agree"),
        Row(f"{name}: messages said a peer", swarm.said / robots, ""),
        Row(f"{name}: bytes said a peer", swarm.sent.total() / robots, "B"),
        Row(f"{name}: memory a peer", held / robots / 1e6, "MB"),
        Row(f"{name}: computing, all in one process", computing, "s"),
    ]


def _resident() -> int:
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
