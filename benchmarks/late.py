"""A late joiner: how long until a new peer has twenty robots' maps, over Zenoh.

From one process that holds them all, whose writers are gone; and from twenty, each with a map of its own.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Sequence

from agent.control import Supervised
from agent.node import Node
from benchmarks.fusion import RULES
from benchmarks.inputs import ORION, logs
from benchmarks.table import Row
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice, TileKey
from mapping.pose import QuantisedPose
from swarm.messages import Hello, Mark, Session, encode
from swarm.replica import CHECKPOINT
from swarm.session import Descriptor
from swarm.state import State, state_check, tile_hash
from transport.bus import Joined, Message
from transport.zenoh_bus import ZenohBus

ROBOTS, TILES = 20, 300
_PORT = 22380
_REPEATS = 5
_PATIENCE = 120.0


def hold(port: int, first: int, last: int) -> None:
    """Be a peer that has the maps of some of the robots, until told to end."""
    log = logs()[0]
    tiles = list(integrated({}, log.scans, log.sensor, EvidenceModel(), Lattice(50)).items())[:TILES]
    with ZenohBus("late", f"holder{first}", listen=[f"tcp/127.0.0.1:{port}"], connect=[]) as bus:
        node = Node(bus, RULES, Hello(Hello.OBSERVER, b"holder", b"benchmark"), now=time.monotonic())
        for robot in range(first, last):
            descriptor = Descriptor(f"r{robot}", robot.to_bytes(8, "big"), RULES, ORION, QuantisedPose(0, 0, 0))
            node.peer.receive("r", encode(Session(descriptor.encode())), 0.0)
            cells = {TileKey(key.ty + robot, key.tx): each for key, each in tiles}
            marks = {key: Mark(CHECKPOINT, tile_hash(key, each)) for key, each in cells.items()}
            state = State(CHECKPOINT, cells, marks, state_check(CHECKPOINT, marks))
            node.peer.fusion.add(node.peer.replicas[descriptor.session].install(state))
        node.run(Supervised())


def measure() -> list[Row]:
    """Seconds from opening the bus until all is in the fused map."""
    return [
        *_measure(f"{ROBOTS} robots x {TILES} tiles, from one peer, no writer alive", 1),
        *_measure(f"{ROBOTS} robots x {TILES} tiles, from {ROBOTS} peers", ROBOTS),
    ]


def _measure(name: str, holders: int) -> list[Row]:
    share = ROBOTS // holders
    ports = [_PORT + k for k in range(holders)]
    commands = [
        [sys.executable, "-m", "benchmarks.late", *map(str, (port, k * share, (k + 1) * share))]
        for k, port in enumerate(ports)
    ]
    processes = [subprocess.Popen(each, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) for each in commands]
    try:
        _join(ports)  # waits until the holders are there
        runs = [_join(ports) for _ in range(_REPEATS)]
    finally:
        for process in processes:
            process.kill()
            process.wait()
    seconds = [run[0] for run in runs]
    return [
        Row(name, statistics.median(seconds), "s", min(seconds), max(seconds)),
        Row("bytes fetched", runs[0][1] / 1e6, "MB"),
    ]


def _join(ports: Sequence[int]) -> tuple[float, int]:
    began = time.monotonic()
    received = 0
    with ZenohBus("late", "newcomer", listen=[], connect=[f"tcp/127.0.0.1:{port}" for port in ports]) as bus:
        node = Node(bus, RULES, Hello(Hello.OBSERVER, b"newcomer", b"benchmark"), now=time.monotonic())
        peer = node.peer
        while sum(replica.state.n == CHECKPOINT for replica in peer.replicas.values()) < ROBOTS:
            if time.monotonic() > began + _PATIENCE:
                raise TimeoutError(f"only {len(peer.replicas)} sessions after {_PATIENCE} s: {dict(peer.dropped)}")
            now = time.monotonic()
            for event in bus.receive(min(0.01, max(0.0, peer.wake_at - now))):
                if isinstance(event, Message):
                    received += len(event.payload)
                    peer.receive(event.sender, event.payload, time.monotonic())
                elif isinstance(event, Joined):
                    peer.joined(event.peer, time.monotonic())
            for to, topic, payload in peer.poll(time.monotonic()):
                if to is None:
                    bus.publish(topic, payload)
                else:
                    bus.send(to, payload)
        return time.monotonic() - began, received


if __name__ == "__main__":
    hold(*map(int, sys.argv[1:]))
