"""``--ros2``: what an observer knows is heard by somebody who knows ROS 2's rules from elsewhere."""

from __future__ import annotations

import json
import queue
import socket

import numpy as np
import pytest
import zenoh
import zenoh.ext

from agent.errors import UserError
from agent.ros2 import Ros2
from agent.ros_types import GRID, POINTS, POSE, SCAN, TRANSFORMS, decode, definition, type_hash
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import quantise
from mapping.sensor import orion
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor, Rules

RULES = Rules(Lattice(50), EvidenceModel())


@pytest.fixture
def router():
    """A Zenoh router as ROS 2 has one: its endpoint, and a session at it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    config = zenoh.Config()
    for key, value in (("mode", "router"), ("listen/endpoints", [endpoint]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield endpoint, session


def test_poses_scans_and_the_map_are_heard(router) -> None:
    endpoint, session = router
    heard: queue.SimpleQueue = queue.SimpleQueue()
    subscriber = session.declare_subscriber("0/**", heard.put)
    tokens: queue.SimpleQueue = queue.SimpleQueue()
    alive = session.liveliness().declare_subscriber("@ros2_lv/**", tokens.put, history=True)
    ros2 = Ros2(endpoint)
    tokens.get(timeout=30)  # the node is linked
    peer = Peer(Hello(Hello.ROBOT, b"r1", b"test"), RULES, seed=b"r1", mtu=32_768, now=0.0, listener=ros2)
    watch = ros2.watch(peer)
    writer = peer.open_session(Descriptor("r1", b"\1" * 8, RULES, orion(), QuantisedPose(0, 0, 0)))
    writer.sense(quantise([1.5], [[0.25, 0.5, 0.0]], [[0.5] * 5], orion()))
    peer.flush(0.0)
    watch(0.0)
    found = {}
    for _ in range(5):
        sample = heard.get(timeout=30)
        found[str(sample.key_expr).split("RIHS01")[0]] = sample.payload.to_bytes()
    late: queue.SimpleQueue = queue.SimpleQueue()
    key = f"0/map/nav_msgs::msg::dds_::OccupancyGrid_/{type_hash(GRID)}"
    reader = zenoh.ext.declare_advanced_subscriber(
        session, key, late.put, history=zenoh.ext.HistoryConfig(detect_late_publishers=True)
    )
    chart = decode(late.get(timeout=30).payload.to_bytes(), GRID)
    for each in (reader, subscriber, alive):
        each.undeclare()
    ros2.close()
    assert found.keys() == {
        "0/r1/pose/geometry_msgs::msg::dds_::PoseStamped_/",
        "0/r1/scan/sensor_msgs::msg::dds_::LaserScan_/",
        "0/r1/hits/sensor_msgs::msg::dds_::PointCloud2_/",
        "0/tf/tf2_msgs::msg::dds_::TFMessage_/",
        "0/map/nav_msgs::msg::dds_::OccupancyGrid_/",
    }
    pose = decode(found["0/r1/pose/geometry_msgs::msg::dds_::PoseStamped_/"], POSE)
    assert (pose.pose.position.x, pose.pose.position.y, pose.header.stamp.sec) == (0.25, 0.5, 1)
    assert np.count_nonzero(chart.data > 65) == 5  # one cell a beam


def test_an_endpoint_that_is_none_is_told() -> None:
    with pytest.raises(UserError, match="give --ros2-router"):
        Ros2("nowhere")


@pytest.mark.parametrize("msgtype", [GRID, POSE, SCAN, POINTS, TRANSFORMS])
def test_type_hashes_are_those_that_others_compute(msgtype: str) -> None:
    utils = pytest.importorskip(
        "zenoh_ros2_sdk.utils", reason="pip install zenoh-ros2-sdk to compare ROS 2's type hashes"
    )
    own, *others = definition(msgtype).split("=" * 80 + "\n")
    parts = dict(part.removeprefix("MSG: ").split("\n", 1) for part in others)
    dependencies = {f"{name.partition('/')[0]}/msg/{name.rpartition('/')[2]}": text for name, text in parts.items()}
    assert utils.get_type_hash(msgtype, own, dependencies) == type_hash(msgtype)
