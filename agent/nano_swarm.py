"""nano_swarm folders: a swarm of small drones with four 8-column time-of-flight sensors each, with the truth.

A folder holds ``scans.csv`` (``robot/node,hex``) and the nodes' poses: ``vicon_poses.csv`` (motion capture),
``poses.csv`` (two rows a node: first odometry, last SLAM). A node is 15 frames, each with its offset from the node.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.errors import UserError
from agent.recording import Recording, check_pose, range_limit
from mapping.sensor import Sensor, sensor

MAX_RANGE = 0.8
"""Metres mapped by default. The sensors reach 4 m, but a column is 5.6 degrees wide: on the recordings with known
walls, 5 cm cells and true poses, precision falls from 0.87 ... 0.97 at 0.8 m to 0.77 ... 0.86 at 4 m, while recall is
0.99 or more at both."""

FRAMES = 15
"""Frames a node."""

FRAME_PERIOD = 1 / 15
"""Seconds from frame to frame. No times are recorded: the frames are spaced evenly at the sensors' 15 Hz."""

_FRAME = np.dtype([("mm", "<i2", (32,)), ("offset", "<f4", (3,))])
_NODE_BYTES = 4 + FRAMES * _FRAME.itemsize  # node id, padding, frames: 1144
_COLUMNS = np.radians((3.5 - np.arange(8)) * 5.625)  # bearings left of a sensor's axis
_AXES = ((0.0, 0.020), (math.pi, 0.020), (math.pi / 2, 0.025), (-math.pi / 2, 0.025))  # bearing, metres from centre
_MEND = "mend or delete the line"


class _Key(NamedTuple):
    """A node of a robot's path."""

    robot: int
    node: int

    def __str__(self) -> str:
        return f"{self.robot}/{self.node}"


class _Row(NamedTuple):
    """One line of a CSV file: where it stands, its node, and the other fields."""

    where: str
    key: _Key
    fields: list[str]


_Pose = tuple[float, float, float]
"""x, y, yaw of a node: metres and radians."""


def drone(max_range: float) -> Sensor:
    """The drone's 32 beams: 8 each to the front, back, left and right."""
    return sensor(
        [
            (distance * math.cos(axis), distance * math.sin(axis), axis + column)
            for axis, distance in _AXES
            for column in _COLUMNS.tolist()
        ],
        max_range,
    )


def read(folder: Path, *, poses: str | None = None, max_range: float | None = None) -> list[Recording]:
    """One recording a robot, in the order of their numbers; all share the frame of the poses chosen.

    Args:
        folder: holds the CSV files.
        poses: "truth" (the default), "odometry" or "slam".
        max_range: metres; a reading beyond it is "nothing in range".

    Raises:
        UserError: a file is missing or damaged, or a scan has no pose.
    """
    beams = drone(range_limit(max_range, MAX_RANGE))
    scans = sorted(_rows(folder / "scans.csv"), key=lambda row: row.key)
    if not scans:
        raise UserError(folder / "scans.csv", "no scans", "give a recording with scans")
    nodes = _truth(folder) if poses in {None, "truth"} else _estimate(folder, last=poses == "slam")
    robots: dict[int, list[tuple[NDArray[np.float64], NDArray[np.float64]]]] = {}
    previous = None
    for scan in scans:
        if scan.key == previous:
            raise UserError(scan.where, f"node {scan.key} comes twice", "delete one of them")
        previous = scan.key
        if scan.key not in nodes:
            raise UserError(scan.where, f"node {scan.key} has no pose", "delete the scan or choose other --poses")
        robots.setdefault(scan.key.robot, []).append(_frames(scan, nodes[scan.key]))
    return [
        Recording(
            name=f"{folder.resolve().name}/{robot}",
            stamps=np.arange(len(parts) * FRAMES, dtype=np.float64) * FRAME_PERIOD,
            poses=np.concatenate([part[0] for part in parts]),
            ranges=np.concatenate([part[1] for part in parts]),
            sensor=beams,
        )
        for robot, parts in robots.items()
    ]


def _frames(scan: _Row, node: _Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A node's poses, shape (15, 3), and ranges, shape (15, 32)."""
    digits = ",".join(scan.fields)
    if len(digits) != 2 * _NODE_BYTES:
        raise UserError(scan.where, f"expected {2 * _NODE_BYTES} hex digits, got {len(digits)}", _MEND)
    try:
        content = bytes.fromhex(digits)
    except ValueError as error:
        raise UserError(scan.where, f"damaged hex digits ({error})", _MEND) from error
    if len(content) != _NODE_BYTES:  # fromhex overlooks blanks
        raise UserError(scan.where, "blanks among the hex digits", _MEND)
    frames = np.frombuffer(content, _FRAME, offset=4)
    with np.errstate(invalid="ignore"):  # a signalling NaN is refused below, like any other
        poses = np.array(node) + frames["offset"].astype(np.float64)
    for pose in poses.tolist():
        check_pose(scan.where, *pose)
    along_axis = frames["mm"] / 1000
    ranges = along_axis / np.tile(np.cos(_COLUMNS), len(_AXES))
    return poses, np.where(along_axis > 0, ranges, np.nan)


def _truth(folder: Path) -> dict[_Key, _Pose]:
    """The nodes' poses by motion capture: ``robot/node,x,y,z,qw,qx,qy,qz``."""
    nodes = {}
    for row in _rows(folder / "vicon_poses.csv"):
        x, y, _z, qw, qx, qy, qz = _numbers(row, 7)
        if not 0.9 < math.hypot(qw, qx, qy, qz) < 1.1:
            raise UserError(row.where, "the quaternion is not of length 1", _MEND)
        yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        check_pose(row.where, x, y, yaw)
        nodes[row.key] = (x, y, yaw)
    return nodes


def _estimate(folder: Path, *, last: bool) -> dict[_Key, _Pose]:
    """The nodes' poses as the robots believed them: the first row of a node (odometry) or its last (SLAM)."""
    nodes: dict[_Key, _Pose] = {}
    for row in _rows(folder / "poses.csv"):
        x, y, yaw = _numbers(row, 3)
        check_pose(row.where, x, y, yaw)
        if last or row.key not in nodes:
            nodes[row.key] = (x, y, yaw)
    return nodes


def _numbers(row: _Row, count: int) -> list[float]:
    try:
        numbers = [float(field) for field in row.fields]
    except ValueError as error:
        raise UserError(row.where, f"not a number ({error})", _MEND) from error
    if len(numbers) != count:
        raise UserError(row.where, f"expected {count} numbers after the node, got {len(numbers)}", _MEND)
    return numbers


def _rows(path: Path) -> Iterator[_Row]:
    """The lines of a CSV file whose first field is ``robot/node``."""
    try:
        lines = path.read_text("ascii").splitlines()
    except FileNotFoundError as error:
        raise UserError(
            path, "there is no such file", "give a folder with scans.csv and, for --poses, vicon_poses.csv or poses.csv"
        ) from error
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check its permissions") from error
    except UnicodeDecodeError as error:
        raise UserError(path, f"this is no text ({error})", "fetch the file again") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        where = f"{path}:{number}"
        name, *fields = line.split(",")
        try:
            robot, node = name.split("/")
            key = _Key(int(robot), int(node))
        except ValueError as error:
            raise UserError(where, f"expected robot/node first, got {name[:40]!r}", _MEND) from error
        yield _Row(where, key, fields)
