"""What the swarm knows, as ROS 2 messages: the fused map, poses, transforms, scans and what they hit.

Laws kept here: the fixed frame is ``map``, the swarm's common frame; a robot's frame bears its name, and its scans are
in ``<robot>/range``, where all its beams begin; stamps are swarm time. Poses and ranges are the published ones, in
whole millimetres, so they come from updates alone: where a robot publishes tiles there are poses only.
"""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.published import published_scans
from agent.ros_types import GRID, POINTS, POSE, SCAN, TRANSFORMS, encode, make
from mapping.evidence import probability
from mapping.grid import Grid
from mapping.pose import FULL_TURN, Pose, from_turn16
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from swarm.messages import Update
from swarm.session import Descriptor

MAP_FRAME = "map"
MAP_TOPIC = "/map"
TRANSFORMS_TOPIC = "/tf"

_LAST_SECOND = 2**31 - 1
_FLOAT32 = 7  # sensor_msgs/PointField


class RosMessage(NamedTuple):
    """One message.

    Attributes:
        topic: where it goes.
        msgtype: what it is.
        stamp_ms: swarm time of its content, milliseconds.
        data: CDR.
    """

    topic: str
    msgtype: str
    stamp_ms: int
    data: bytes


def ros_name(robot: str) -> str:
    """A robot's id as a ROS name may be: letters, digits and _, no digit first."""
    plain = re.sub(r"\W", "_", robot, flags=re.ASCII)
    return f"robot_{plain}" if plain[:1].isdigit() else plain


def pose_topic(robot: str) -> str:
    """Where a robot's poses are."""
    return f"/{ros_name(robot)}/pose"


def update_messages(descriptor: Descriptor, update: Update) -> list[RosMessage]:
    """An update's poses, transforms, and, if it carries scans, its scans and their hits."""
    scans = published_scans(descriptor, update)
    if scans is None:
        return []
    name, sensor = ros_name(descriptor.robot), descriptor.sensor
    stamps_ms = scans.stamps_ms.tolist()
    poses = [_pose(Pose(x / 1000, y / 1000, from_turn16(yaw))) for x, y, yaw in scans.poses.tolist()]
    found = [
        _message(pose_topic(descriptor.robot), make(POSE, header=_header(stamp_ms, MAP_FRAME), pose=pose), stamp_ms)
        for stamp_ms, pose in zip(stamps_ms, poses, strict=True)
    ]
    transforms = [_transform(stamp_ms, MAP_FRAME, name, pose) for stamp_ms, pose in zip(stamps_ms, poses, strict=True)]
    if scans.beams:
        fan = _Fan.of(sensor)
        if fan is not None:
            transforms.append(_transform(stamps_ms[-1], name, f"{name}/range", _pose(Pose(*fan.origin))))
            found += [
                _message(f"/{name}/scan", fan.scan(f"{name}/range", stamp_ms, ranges), stamp_ms)
                for stamp_ms, ranges in zip(stamps_ms, scans.ranges, strict=True)
            ]
        found.append(_message(f"/{name}/hits", _cloud(hits(scans, sensor), stamps_ms[-1]), stamps_ms[-1]))
    found.append(_message(TRANSFORMS_TOPIC, make(TRANSFORMS, transforms=transforms), stamps_ms[-1]))
    return found


def map_message(grid: Grid, stamp_ms: int) -> RosMessage:
    """The map: unknown is -1, else the probability of being occupied, in percent."""
    rows, columns = grid.evidence.shape
    percent = np.rint(100 * probability(grid.evidence)).astype(np.int8)
    percent[grid.evidence == 0] = -1
    info = make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=_time(stamp_ms),
        resolution=grid.lattice.cell,
        width=columns,
        height=rows,
        origin=_pose(Pose(*grid.origin)),
    )
    return _message(
        MAP_TOPIC, make(GRID, header=_header(stamp_ms, MAP_FRAME), info=info, data=percent.ravel()), stamp_ms
    )


def hits(scans: Scans, sensor: Sensor) -> NDArray[np.float64]:
    """Where the beams met something, in the common frame; metres, shape (K, 2)."""
    rows, beams = np.nonzero((scans.ranges != INVALID) & (scans.ranges != NO_RETURN))
    x, y, bearing, _ = sensor.table[beams].T
    yaw = scans.poses[rows, 2] / FULL_TURN * math.tau
    look = yaw + bearing / FULL_TURN * math.tau
    away = scans.ranges[rows, beams]
    points = scans.poses[rows, :2].astype(np.float64)
    points[:, 0] += np.cos(yaw) * x - np.sin(yaw) * y + np.cos(look) * away
    points[:, 1] += np.sin(yaw) * x + np.cos(yaw) * y + np.sin(look) * away
    return points / 1000


class _Fan(NamedTuple):
    """A sensor as a LaserScan has it: beams from one point, each as far from the next; radians and metres."""

    origin: tuple[float, float]
    first: float
    step: float
    beams: int
    max_range: float

    @classmethod
    def of(cls, sensor: Sensor) -> _Fan | None:
        """The fan, or None if the sensor is none."""
        x, y, bearings, _ = sensor.table.T
        steps = (np.diff(bearings) + FULL_TURN // 2) % FULL_TURN - FULL_TURN // 2
        if np.ptp(x) or np.ptp(y) or (len(steps) and np.ptp(steps) > 1):  # bearings are rounded
            return None
        step = float(steps.mean()) if len(steps) else 0.0
        first, step = from_turn16(int(bearings[0])), step / FULL_TURN * math.tau
        return cls((x[0] / 1000, y[0] / 1000), first, step, len(bearings), sensor.max_range_mm / 1000)

    def scan(self, frame: str, stamp_ms: int, ranges: NDArray[np.uint16]) -> Any:
        """A LaserScan: NaN says nothing, infinity is nothing in range (REP 117)."""
        metres = ranges.astype(np.float32) / 1000
        metres[ranges == INVALID] = np.nan
        metres[ranges == NO_RETURN] = np.inf
        return make(
            SCAN,
            header=_header(stamp_ms, frame),
            angle_min=self.first,
            angle_max=self.first + (self.beams - 1) * self.step,
            angle_increment=self.step,
            time_increment=0.0,
            scan_time=0.0,
            range_min=0.001,
            range_max=self.max_range,
            ranges=metres,
            intensities=np.zeros(0, np.float32),
        )


def _cloud(points: NDArray[np.float64], stamp_ms: int) -> Any:
    data = np.zeros((len(points), 3), "<f4")
    data[:, :2] = points
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=_FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    return make(
        POINTS,
        header=_header(stamp_ms, MAP_FRAME),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=np.frombuffer(data.tobytes(), np.uint8),
        is_dense=True,
    )


def _message(topic: str, message: Any, stamp_ms: int) -> RosMessage:
    return RosMessage(topic, message.__msgtype__, stamp_ms, encode(message))


def _time(stamp_ms: int) -> Any:
    """ROS has 31 bits of seconds, from 0; what does not fit is none of its times."""
    stamp_ms = min(max(stamp_ms, 0), 1000 * _LAST_SECOND)
    return make("builtin_interfaces/msg/Time", sec=stamp_ms // 1000, nanosec=stamp_ms % 1000 * 1_000_000)


def _header(stamp_ms: int, frame: str) -> Any:
    return make("std_msgs/msg/Header", stamp=_time(stamp_ms), frame_id=frame)


def _pose(pose: Pose) -> Any:
    return make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=pose.x, y=pose.y, z=0.0),
        orientation=make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(pose.yaw / 2), w=math.cos(pose.yaw / 2)
        ),
    )


def _transform(stamp_ms: int, parent: str, child: str, pose: Any) -> Any:
    """``T_parent_child``."""
    place = pose.position
    translation = make("geometry_msgs/msg/Vector3", x=place.x, y=place.y, z=place.z)
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=_header(stamp_ms, parent),
        child_frame_id=child,
        transform=make("geometry_msgs/msg/Transform", translation=translation, rotation=pose.orientation),
    )
