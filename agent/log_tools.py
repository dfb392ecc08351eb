"""What can be made of a log: a description, a whole file of a torn one, a rosbag2 folder, trajectories."""

from __future__ import annotations

import io
import math
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.config import resolve
from agent.errors import UserError
from agent.files import prepare_folder, read_bytes, write_whole
from agent.log_reader import LogReader
from agent.log_writer import LogWriter
from agent.microcontroller import CLOCK_MS
from agent.published import published_scans
from mapping.pose import FULL_TURN
from swarm.messages import Hello, Update
from swarm.peer import Peer
from swarm.session import Descriptor, SessionId


class Poses:
    """The poses of each session as they were published (``swarm.peer.Listener``)."""

    def __init__(self) -> None:
        self._parts: dict[SessionId, list[NDArray[np.float64]]] = {}

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        scans = published_scans(descriptor, update)
        if scans is not None:
            yaw = scans.poses[:, 2] / FULL_TURN * math.tau
            table = np.column_stack([scans.stamps_ms / 1000, scans.poses[:, :2] / 1000, yaw])
            self._parts.setdefault(descriptor.session, []).append(table)

    def of(self, session: SessionId) -> NDArray[np.float64]:
        """Seconds, x, y (metres) and yaw (radians) in the common frame; shape (N, 4)."""
        return np.concatenate([np.zeros((0, 4)), *self._parts.get(session, [])])


def told_again(log: LogReader) -> tuple[Peer, Poses]:
    """A peer that holds all that the recorded one held at the end, and the poses that were published.

    Raises:
        UserError: the log is bad.
    """
    rules, poses = resolve(log.swarm()).rules(), Poses()
    peer = Peer(Hello(Hello.OBSERVER, b"log", b""), rules, seed=b"log", mtu=32_768, now=0.0, listener=poses)
    for _, told in log.told():
        peer.repeat(told, 0.0)
        peer.poll(0.0)
    return peer, poses


def describe(path: Path) -> dict[str, Any]:
    """What ``orion log info`` tells.

    Raises:
        UserError: the log is bad.
    """
    log = LogReader(path)
    table = log.swarm()
    counts: Counter[tuple[str, str]] = Counter()
    first = last = 0
    for logged in log:
        counts[logged.topic, logged.msgtype] += 1
        first, last = first or logged.log_ns, logged.log_ns
    peer, _ = told_again(log)
    return {
        "log": str(path),
        "swarm": table.get("swarm"),
        "torn": log.torn,
        "seconds": (last - first) / 1e9,
        "messages": sum(counts.values()),
        "topics": [
            {"topic": topic, "type": msgtype, "messages": count} for (topic, msgtype), count in sorted(counts.items())
        ],
        "sessions": [
            {"robot": replica.descriptor.robot, "session": session.hex(), "updates": replica.state.n}
            for session, replica in peer.replicas.items()
        ],
        "map_digest": peer.fusion.digest().hex(),
    }


def recover(torn: Path, out: Path) -> tuple[int, str]:
    """Write all that is whole into a new file; gives how many messages that are, and what was wrong with the old one.

    Raises:
        UserError: a file cannot be read or written.
    """
    log = LogReader(torn)
    writer = LogWriter(out, log.configuration)
    try:
        for logged in log:
            writer.write(logged.topic, logged.msgtype, logged.data, logged.log_ns, logged.publish_ns)
        writer.close()
    except OSError as error:
        writer.abandon()
        raise UserError(out, f"cannot be written: {error.strerror}", "choose another place") from None
    return writer.messages, log.torn


def export_rosbag2(path: Path, folder: Path) -> None:
    """Write a rosbag2 folder (SQLite, version 9) with every message of the log.

    Raises:
        UserError: the log is bad, or the folder is there already or cannot be made.
    """
    from rosbags.rosbag2 import Writer, WriterError

    from agent.ros_types import type_hash

    log = LogReader(path)
    try:
        with Writer(folder, version=9) as bag:
            connections: dict[str, Any] = {}
            for logged in log:
                if logged.topic not in connections:
                    connections[logged.topic] = bag.add_connection(
                        logged.topic, logged.msgtype, msgdef=logged.definition, rihs01=type_hash(logged.msgtype)
                    )
                bag.write(connections[logged.topic], logged.log_ns, logged.data)
    except (WriterError, OSError) as error:
        raise UserError(folder, f"cannot be written: {error}", "give a new folder") from None


def export_tum(path: Path, folder: Path) -> list[Path]:
    """Write each robot's trajectory: lines of stamp, x, y, z and the quaternion x, y, z, w, in order of time.

    Of a robot with several sessions, each has its own file; those that another one replaces have none.

    Raises:
        UserError: the log is bad, or a file cannot be written.
    """
    peer, poses = told_again(LogReader(path))
    folder = prepare_folder(folder)
    robots = Counter(replica.descriptor.robot for replica in peer.replicas.values())
    written = []
    for session, replica in peer.replicas.items():
        robot = replica.descriptor.robot
        name = robot if robots[robot] == 1 else f"{robot}-{session.hex()}"
        written.append(_write_tum(folder / f"{name}.tum", poses.of(session)))
    return written


def export_truth(path: Path, folder: Path) -> list[Path]:
    """Write the true trajectories of simulated robots beside their own, on the same clock.

    Raises:
        UserError: the file is none that ``orion simulate`` wrote, or one cannot be written.
    """
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as file:
            robots, stamps_ms, poses = file["robots"].tolist(), file["stamps_ms"], file["poses"]
            tables = [np.column_stack([(stamps_ms + CLOCK_MS) / 1000, poses[:, k]]) for k in range(len(robots))]
    except (ValueError, TypeError, KeyError, EOFError, IndexError, zipfile.BadZipFile) as error:
        raise UserError(path, f"holds no true ways: {error}", "give the truth.npz of a demo") from None
    return [_write_tum(folder / f"{robot}-truth.tum", table) for robot, table in zip(robots, tables, strict=True)]


def _write_tum(path: Path, table: NDArray[np.float64]) -> Path:
    write_whole(path, "".join(_lines(table)).encode())
    return path


def _lines(table: NDArray[np.float64]) -> Iterator[str]:
    for stamp, x, y, yaw in table[np.argsort(table[:, 0], kind="stable")].tolist():
        yield f"{stamp:.3f} {x:.6f} {y:.6f} 0 0 0 {math.sin(yaw / 2):.9f} {math.cos(yaw / 2):.9f}\n"
