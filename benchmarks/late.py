"""A late joiner: another process holds twenty robots' maps; how long until a new peer has them all, over Zenoh."""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time

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
from swarm.state import State, tile_hash
from transport.bus import Joined, Message
from transport.zenoh_bus import ZenohBus

ROBOTS, TILES = 20, 300
_PORT = 22380
_REPEATS = 5
_PATIENCE = 120.0


def hold(port: int) -> None:
    """Be the peer that has everything, until told to end."""
    log = logs()[0]
    tiles = list(integrated({}, log.scans, log.sensor, EvidenceModel(), Lattice(50)).items())[:TILES]
    with ZenohBus("late", "holder", listen=[f"tcp/127.0.0.1:{port}"], connect=[]) as bus:
        node = Node(bus, RULES, Hello(Hello.OBSERVER, b"holder", b"benchmark"), now=time.monotonic())
        for robot in range(ROBOTS):
            descriptor = Descriptor(f"r{robot}", robot.to_bytes(8, "big"), RULES, ORION, QuantisedPose(0, 0, 0))
            node.peer.receive("r", encode(Session(descriptor.encode())), 0.0)
            cells = {TileKey(key.ty + robot, key.tx): each for key, each in tiles}
            marks = {key: Mark(CHECKPOINT, tile_hash(key, each)) for key, each in cells.items()}
            check = sum(mark.hash for mark in marks.values()) % 2**64
            change = node.peer.replicas[descriptor.session].install(State(CHECKPOINT, cells, marks, check))
            node.peer.fusion.add(change)
        node.run(Supervised())


def measure() -> list[Row]:
    """Seconds from opening the bus until all is in the fused map."""
    command = [sys.executable, "-m", "benchmarks.late", "--hold", str(_PORT)]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        _join()  # waits until the holder is there
        runs = [_join() for _ in range(_REPEATS)]
    finally:
        holder.kill()
        holder.wait()
    seconds = [run[0] for run in runs]
    rows = [Row(f"{ROBOTS} robots x {TILES} tiles", statistics.median(seconds), "s", min(seconds), max(seconds))]
    return [*rows, Row("bytes fetched", runs[0][1] / 1e6, "MB")]


def _join() -> tuple[float, int]:
    began = time.monotonic()
    received = 0
    with ZenohBus("late", "newcomer", listen=[], connect=[f"tcp/127.0.0.1:{_PORT}"]) as bus:
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
    parser = argparse.ArgumentParser()
    parser.add_argument("--hold", type=int)
    hold(parser.parse_args().hold)
