"""A recorded run on the page: how fast it is read, what a jump to any time costs, and what is kept for that."""

from __future__ import annotations

import math
import resource
import statistics
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from agent.config import Config
from agent.log_player import LogPlayer
from agent.page_orders import Seek
from agent.recorder import Recorder
from benchmarks.inputs import ORION, orion_walk
from benchmarks.integration import kernels
from benchmarks.table import Row, cpu_seconds
from mapping.pose import QuantisedPose
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor

MINUTES = 10
ROBOTS = 4
_RATE = 10
_JUMPS = 40


def measure() -> list[Row]:
    """Four robots that publish ten times a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        _record(path)
        before = _resident()
        player = LogPlayer(path)
        reading = cpu_seconds(lambda: player.read(math.inf))
        held = _resident() - before
        chance, jumps = np.random.default_rng(1), []
        for share in chance.random(_JUMPS):
            jump = partial(player.obey, Seek(share * player.duration), 0.0)
            jumps.append(1000 * cpu_seconds(jump))
        return [
            Row(f"recorded: {MINUTES} minutes of {ROBOTS} robots", path.stat().st_size / 1e6, "MB"),
            Row("reading it, times real time", player.duration / reading, ""),
            Row("memory held for it", held / 1e6, "MB"),
            Row("a jump", statistics.median(jumps), "ms", min(jumps), max(jumps)),
        ]


def _record(path: Path) -> None:
    config, now, kernel = Config(cell=0.02), 0.0, kernels().get("fast") or kernels()["NumPy"]
    recorder = Recorder(path, config.toml().decode(), lambda: 10**18 + round(now * 1e9))
    hello = Hello(Hello.OBSERVER, b"observer", b"benchmark")
    observer = Peer(hello, config.rules(), seed=b"o", mtu=32_768, now=now, kernel=kernel, listener=recorder)
    turn = recorder.watch(observer)
    robots = []
    for k in range(ROBOTS):
        name = f"r{k}"
        robot = Peer(
            Hello(Hello.ROBOT, name.encode(), b""),
            config.rules(),
            seed=name.encode(),
            mtu=32_768,
            now=now,
            kernel=kernel,
        )
        start = QuantisedPose(0, 0, 0)
        robot.open_session(Descriptor(name, bytes([k + 1] * 8), config.rules(), ORION, start), publish="scans")
        robots.append((robot, orion_walk(60 * MINUTES * _RATE, k, cells_away=300 * k)))
    for step in range(60 * MINUTES * _RATE):
        now = step / _RATE
        for robot, walk in robots:
            assert robot.writer is not None
            robot.writer.sense(walk[step : step + 1])
            robot.flush(now)
            for out in robot.poll(now):
                observer.receive("r", out.payload, now)
        observer.poll(now)
        turn(now)
    recorder.close()


def _resident() -> int:
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
