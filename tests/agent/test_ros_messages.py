"""The swarm's knowledge as ROS 2 messages, checked against what the swarm itself makes of the same scans."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.ros_messages import hits, ros_name, update_messages
from agent.ros_types import POINTS, POSE, SCAN, TRANSFORMS, decode, type_hash
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import Pose
from mapping.scan import Scans, quantise
from mapping.sensor import Sensor, laser, orion, sensor
from swarm.messages import Update
from swarm.scan_block import encode_scans
from swarm.session import Descriptor, Rules

RULES = Rules(Lattice(50), EvidenceModel())


def messages_of(scans: Scans, senses: Sensor, robot: str = "r1") -> dict[str, list]:
    descriptor = Descriptor(robot, bytes(8), RULES, senses, None)
    update = Update(bytes(8), 1, Update.SCANS, encode_scans(scans), b"", 0)
    found: dict[str, list] = {}
    for topic, msgtype, _, data in update_messages(descriptor, update):
        found.setdefault(topic, []).append(decode(data, msgtype))
    return found


def drive(senses: Sensor, count: int = 3) -> Scans:
    k = np.arange(count)
    ranges = 0.3 + 0.1 * np.add.outer(k, np.arange(len(senses.beams)) % 5)
    ranges[0, 0], ranges[-1, -1] = np.inf, np.nan
    return quantise(0.1 * k, np.column_stack([0.5 + 0.1 * k, -0.2 * k, 2.5 + 0.4 * k]), ranges, senses)


def in_the_map(found: dict[str, list], name: str) -> np.ndarray:
    """The scans' hits by the way that a ROS program takes: ranges, angles, transforms."""
    transforms = [each for message in found["/tf"] for each in message.transforms]
    mount = next(each for each in transforms if each.child_frame_id == f"{name}/range")
    assert mount.header.frame_id == name

    def pose(transform) -> Pose:
        place, turn = transform.transform.translation, transform.transform.rotation
        return Pose(place.x, place.y, 2 * math.atan2(turn.z, turn.w))

    points = []
    for scan in found[f"/{name}/scan"]:
        (base,) = [
            each for each in transforms if each.child_frame_id == name and each.header.stamp == scan.header.stamp
        ]
        assert (base.header.frame_id, scan.header.frame_id) == ("map", f"{name}/range")
        angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        assert angles[-1] == pytest.approx(scan.angle_max, abs=1e-6)
        met = np.isfinite(scan.ranges)
        there = np.column_stack([scan.ranges * np.cos(angles), scan.ranges * np.sin(angles)])[met]
        points.append((pose(base) @ pose(mount)).apply(there.astype(np.float64)))
    return np.concatenate(points)


@pytest.mark.parametrize("senses", [orion(2.0), laser(90, first=-1.5, step=math.radians(1.1), max_range=2.0)])
def test_scans_through_the_transforms_are_the_hits(senses: Sensor) -> None:
    scans = drive(senses)
    found = messages_of(scans, senses)
    (cloud,) = found["/r1/hits"]
    points = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(-1, 3)
    assert len(points) == cloud.width == 3 * len(senses.beams) - 2
    assert np.allclose(points[:, :2], hits(scans, senses), atol=1e-6)
    assert np.allclose(in_the_map(found, "r1"), points[:, :2], atol=2e-4)  # bearings are whole 1/65536 turns
    assert not points[:, 2].any()


def test_what_says_nothing_is_nan_and_what_meets_nothing_infinite() -> None:
    first, *_, last = messages_of(drive(orion(2.0)), orion(2.0))["/r1/scan"]
    assert first.ranges[0] == math.inf
    assert math.isnan(last.ranges[-1])


def test_beams_from_several_places_are_points_only() -> None:
    senses = sensor([(0.0, 0.1, 0.0), (0.0, -0.1, 0.5)], 2.0)
    found = messages_of(drive(senses), senses)
    assert found.keys() == {"/r1/pose", "/r1/hits", "/tf"}


def test_poses_are_the_published_ones() -> None:
    scans = drive(orion(2.0))
    for pose, (x, y, yaw) in zip(messages_of(scans, orion(2.0))["/r1/pose"], scans.poses.tolist(), strict=True):
        turn = pose.pose.orientation
        assert (round(1000 * pose.pose.position.x), round(1000 * pose.pose.position.y)) == (x, y)
        assert round(2 * math.atan2(turn.z, turn.w) / math.tau * 65536) % 65536 == yaw


def test_an_update_without_scans_has_its_trail_and_one_without_that_nothing() -> None:
    scans = drive(orion(2.0))
    trail = encode_scans(Scans(scans.stamps_ms, scans.poses, np.zeros((3, 0), np.uint16)))
    descriptor = Descriptor("r1", bytes(8), RULES, orion(2.0), None)
    kinds = [m.msgtype for m in update_messages(descriptor, Update(bytes(8), 1, Update.TILES, b"", trail, 0))]
    assert kinds == [POSE, POSE, POSE, TRANSFORMS]
    assert update_messages(descriptor, Update(bytes(8), 1, Update.TILES, b"", b"", 0)) == []


def test_stamps_that_ros_has_not_are_its_nearest() -> None:
    scans = drive(orion(2.0))
    for stamp, sec in ((-5, 0), (2**60, 2**31 - 1)):
        odd = Scans(np.full(3, stamp), scans.poses, scans.ranges)
        assert messages_of(odd, orion(2.0))["/r1/pose"][0].header.stamp.sec == sec


@pytest.mark.parametrize(("robot", "name"), [("r1", "r1"), ("my-robot", "my_robot"), ("7up", "robot_7up")])
def test_a_robots_name_is_one_for_ros(robot: str, name: str) -> None:
    assert ros_name(robot) == name


def test_the_type_hashes_are_those_of_ros() -> None:
    """As ``ros2 topic info -v`` shows them on Jazzy."""
    assert type_hash("nav_msgs/msg/OccupancyGrid") == (
        "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"
    )
    assert {SCAN, POINTS} == {"sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"}
