"""ROS 2's wire format, compared with what others made of the same rules (zenoh-ros2-sdk); no real ROS 2 is here."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys

import pytest
import zenoh
import zenoh.ext

from transport.bus import BusError
from transport.ros2_format import Topic, attachment, node_token, publisher_id
from transport.ros2_node import Ros2Node

HASH = "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"
MAP = Topic("/map", "nav_msgs/msg/OccupancyGrid", HASH, 1, latched=True)
POSE = Topic("/r1/pose", "geometry_msgs/msg/PoseStamped", "RIHS01_00")


@pytest.fixture(scope="module")
def sdk():
    """The other implementation."""
    found = pytest.importorskip("zenoh_ros2_sdk", reason="pip install zenoh-ros2-sdk to compare ROS 2's wire format")
    from zenoh_ros2_sdk import attachment as theirs
    from zenoh_ros2_sdk import entity, keyexpr, qos, utils

    assert found
    return {"attachment": theirs, "entity": entity, "keyexpr": keyexpr, "qos": qos, "utils": utils}


def test_the_keys_are_the_documented_ones() -> None:
    assert MAP.key(0) == f"0/map/nav_msgs::msg::dds_::OccupancyGrid_/{HASH}"
    assert node_token(0, "abc", "orion") == "@ros2_lv/0/abc/0/0/NN/%/%/orion"
    token = MAP.token(0, "abc", "orion", 1)
    assert token == f"@ros2_lv/0/abc/0/1/MP/%/%/orion/%map/nav_msgs::msg::dds_::OccupancyGrid_/{HASH}/:1:,1:,:,:,,"


@pytest.mark.parametrize("topic", [MAP, POSE])
@pytest.mark.parametrize("domain", [0, 42])
def test_keys_and_tokens_are_those_of_the_other_implementation(sdk, topic: Topic, domain: int) -> None:
    entity, keyexpr, qos = sdk["entity"], sdk["keyexpr"], sdk["qos"]
    type_name = sdk["utils"].ros2_to_dds_type(topic.msgtype)
    assert topic.key(domain) == keyexpr.topic_keyexpr(domain, topic.name, type_name, topic.type_hash)
    node = entity.NodeEntity(domain, "abc", 0, "orion")
    assert node_token(domain, "abc", "orion") == keyexpr.node_liveliness_keyexpr(node)
    kind = qos.QosDurability.TRANSIENT_LOCAL if topic.latched else qos.QosDurability.VOLATILE
    profile = qos.QosProfile(durability=kind, history_depth=topic.depth).encode()
    publisher = entity.EndpointEntity(
        node, 3, entity.EntityKind.PUBLISHER, topic.name, type_name, topic.type_hash, profile
    )
    assert topic.token(domain, "abc", "orion", 3) == keyexpr.endpoint_liveliness_keyexpr(publisher)


def test_attachments_are_read_by_the_other_implementation(sdk) -> None:
    gid = publisher_id("somebody")
    read = sdk["attachment"].Attachment.from_bytes(attachment(7, 1_700_000_000_123_456_789, gid))
    assert (read.sequence_id, read.timestamp_ns, read.gid) == (7, 1_700_000_000_123_456_789, gid)
    assert read.to_bytes() == attachment(7, 1_700_000_000_123_456_789, gid)
    assert len(gid) == 16


@pytest.fixture
def router(free_endpoint):
    """A Zenoh router as ROS 2 has one: its endpoint, and a session at it."""
    endpoint = free_endpoint()
    config = zenoh.Config()
    for key, value in (("mode", "router"), ("listen/endpoints", [endpoint]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield endpoint, session


def test_a_node_shows_up_and_what_it_publishes_is_heard(router) -> None:
    endpoint, session = router
    heard: queue.SimpleQueue = queue.SimpleQueue()
    alive: queue.SimpleQueue = queue.SimpleQueue()
    subscriber = session.declare_subscriber("0/r1/pose/**", heard.put)
    tokens = session.liveliness().declare_subscriber("@ros2_lv/**", alive.put, history=True)
    with Ros2Node("orion", router=endpoint, unix_ns=lambda: 5) as node:
        assert str(alive.get(timeout=30).key_expr).endswith("/0/0/NN/%/%/orion")
        for _ in range(2):  # its subscription was there before it came
            node.publish(POSE, b"\0\1\0\0pose")
        token = str(alive.get(timeout=30).key_expr)
        assert "/0/1/MP/%/%/orion/%r1%pose/" in token
        samples = [heard.get(timeout=30) for _ in range(2)]
    assert [str(sample.key_expr) for sample in samples] == [POSE.key(0)] * 2
    assert {sample.payload.to_bytes() for sample in samples} == {b"\0\1\0\0pose"}
    expected = [attachment(k, 5, publisher_id(token)) for k in (1, 2)]
    assert [sample.attachment.to_bytes() for sample in samples] == expected
    assert all(alive.get(timeout=30).kind == zenoh.SampleKind.DELETE for _ in range(2))
    subscriber.undeclare()
    tokens.undeclare()


def test_who_comes_late_gets_the_last_map(router) -> None:
    endpoint, session = router
    heard: queue.SimpleQueue = queue.SimpleQueue()
    with Ros2Node("orion", router=endpoint) as node:
        for k in range(3):
            node.publish(MAP, b"map %d" % k)
        late = zenoh.ext.declare_advanced_subscriber(
            session, MAP.key(0), heard.put, history=zenoh.ext.HistoryConfig(detect_late_publishers=True)
        )
        assert heard.get(timeout=30).payload.to_bytes() == b"map 2"
        late.undeclare()
    assert heard.empty()


def test_large_maps_arrive_whole(router) -> None:
    endpoint, session = router
    heard: queue.SimpleQueue = queue.SimpleQueue()
    subscriber = session.declare_subscriber(MAP.key(0), heard.put)
    alive: queue.SimpleQueue = queue.SimpleQueue()
    tokens = session.liveliness().declare_subscriber("@ros2_lv/**", alive.put, history=True)
    with Ros2Node("orion", router=endpoint) as node:
        alive.get(timeout=30)
        node.publish(MAP, bytes(8 << 20))
        assert len(heard.get(timeout=30).payload) == 8 << 20
    subscriber.undeclare()
    tokens.undeclare()


def test_a_router_that_is_away_stops_nobody(free_endpoint) -> None:
    with Ros2Node("orion", router=free_endpoint()) as node:
        node.publish(MAP, b"map")


def test_an_endpoint_that_is_none_is_told() -> None:
    with pytest.raises(BusError):
        Ros2Node("orion", router="nowhere")


SUBSCRIBER = """
import sys, threading
from zenoh_ros2_sdk import ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
port, definition, type_hash = int(sys.argv[1]), sys.argv[2], sys.argv[3]
got = threading.Event()
def hear(message):
    print(message.data, flush=True)
    got.set()
subscriber = ROS2Subscriber("/words", "std_msgs/msg/String", hear, msg_definition=definition, type_hash=type_hash,
    router_port=port, qos=QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1))
print("heard" if got.wait(30) else "nothing", flush=True)
import os
os._exit(0)
"""


def test_a_late_subscriber_of_the_other_implementation_gets_the_last_message(sdk, router, tmp_path) -> None:
    endpoint, _ = router
    topic = Topic("/words", "std_msgs/msg/String", "RIHS01_00", 1, latched=True)
    with Ros2Node("orion", router=endpoint) as node:
        for word in (b"first", b"last!"):
            node.publish(topic, b"\0\1\0\0" + bytes([6, 0, 0, 0]) + word + b"\0")
        words = [sys.executable, "-c", SUBSCRIBER, endpoint.rpartition(":")[2], "string data", topic.type_hash]
        result = subprocess.run(
            words, capture_output=True, text=True, timeout=90, check=False, env=os.environ | {"HOME": str(tmp_path)}
        )
    assert result.stdout.split() == ["last!", "heard"], result.stderr
