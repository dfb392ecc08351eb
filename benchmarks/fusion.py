"""Summing robots' maps against reading them once; what one update costs a peer as the swarm and the map grow."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.inputs import ORION, orion_walk
from benchmarks.integration import kernels
from benchmarks.table import Row, compared, cpu_seconds, interleaved
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Cells, Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.raster import Raster
from mapping.tiles import frozen, summed
from swarm.messages import Hello, Mark, Session, encode
from swarm.peer import Peer
from swarm.replica import CHECKPOINT, Replica
from swarm.session import Descriptor, Rules
from swarm.state import State, state_check, tile_hash
from swarm.writer import Writer

RULES = Rules(Lattice(20), EvidenceModel())
_ROBOTS, _TILES = 50, 100


def measure() -> list[Row]:
    """Milliseconds a sum; microseconds an update of one five-beam scan, message to fused map."""
    return [*_sum(), *_updates()]


def _sum() -> list[Row]:
    chance = np.random.default_rng(1)
    maps = [
        {TileKey(0, k): frozen(chance.integers(-99, 99, (TILE, TILE), np.int32)) for k in range(_TILES)}
        for _ in range(_ROBOTS)
    ]
    arrays = [np.stack(list(tiles.values())) for tiles in maps]
    figures = interleaved(
        {
            f"reading {_ROBOTS} x {_TILES} tiles once": lambda: cpu_seconds(lambda: [each.max() for each in arrays]),
            "their sum": lambda: cpu_seconds(lambda: summed(list(maps))),
        },
        15,
    )
    return compared(figures, "ms", f"reading {_ROBOTS} x {_TILES} tiles once", scale=1e3)


def _updates() -> list[Row]:
    kernel = kernels().get("fast") or kernels()["NumPy"]
    cases = [(5, 100), (50, 100), (200, 100), (5, 1_000), (5, 10_000)]
    peers = {
        f"an update, {robots} robots, maps of {tiles} tiles": _Follower(robots, tiles, kernel)
        for robots, tiles in cases
    }
    figures = interleaved({name: peer.seconds_an_update for name, peer in peers.items()}, 12)
    return compared(figures, "us", next(iter(peers)), scale=1e6)


class _Follower:
    """A peer that holds sessions of many tiles and hears one of them go on."""

    def __init__(self, robots: int, tiles: int, kernel: Raster) -> None:
        hello = Hello(Hello.OBSERVER, b"o1", b"benchmark")
        self._peer = Peer(hello, RULES, seed=b"o1", mtu=32768, now=0.0, kernel=kernel)
        held = _state(tiles)
        for robot in range(robots):
            descriptor = Descriptor(f"r{robot}", robot.to_bytes(8, "big"), RULES, ORION, QuantisedPose(0, 0, 0))
            self._peer.receive("r", encode(Session(descriptor.encode())), 0.0)
            replica = self._peer.replicas[descriptor.session]
            self._peer.fusion.add(replica.install(held.copy()))
            if robot == 0:
                own = Replica(descriptor, kernel)
                own.install(held.copy())
                self._writer = Writer(own, kernel, mtu=32768)
        self._walk = orion_walk(10_000, 1)
        self._next = 0

    def seconds_an_update(self) -> float:
        """Of two checkpoints' worth of updates, so that each run has as many checkpoints."""
        messages = []
        for row in range(self._next, self._next + 2 * CHECKPOINT):
            self._writer.sense(self._walk[row : row + 1])
            messages += [encode(update) for update, _ in self._writer.updates()]
        self._next += 2 * CHECKPOINT
        taken = cpu_seconds(partial(self._hear, messages))
        assert not self._peer.dropped
        assert self._peer.replicas[bytes(8)].state.n == self._writer.replica.state.n
        return taken / len(messages)

    def _hear(self, messages: list[bytes]) -> None:
        for message in messages:
            self._peer.receive("r0", message, 1.0)


def _state(tiles: int) -> State:
    """A checkpoint of a map that lies elsewhere."""
    cells: dict[TileKey, Cells] = {
        TileKey(1000 + k // 100, k % 100): frozen(np.full((TILE, TILE), 7, np.int32)) for k in range(tiles)
    }
    marks = {key: Mark(CHECKPOINT, tile_hash(key, each)) for key, each in cells.items()}
    return State(CHECKPOINT, cells, marks, state_check(CHECKPOINT, marks))
