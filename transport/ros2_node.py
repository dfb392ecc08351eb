"""A ROS 2 node without ROS: publishes over a Zenoh session of its own, through the router that ROS 2 runs.

Laws kept here: a reader that is slow stops us for a quarter of a second at most, and a router that is away not at all
(what cannot be sent is dropped); the session is closed however the process ends. It is a peer as ROS 2's own are:
found through the router, linked directly.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable
from typing import Any, Self

import zenoh
import zenoh.ext

from transport.bus import BusError
from transport.ros2_format import Topic, attachment, node_token, publisher_id

ROUTER = "tcp/127.0.0.1:7447"
"""Where ``ros2 run rmw_zenoh_cpp rmw_zenohd`` listens."""

_SETTINGS: dict[str, object] = {
    "mode": "peer",
    "listen/endpoints": ["tcp/127.0.0.1:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "scouting/gossip/autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
    "connect/timeout_ms": -1,  # opening does not wait for the router
    "connect/exit_on_failure": False,
    "open/return_conditions": {"connect_scouted": False, "declares": False},
    "transport/link/tx/queue/size/data": 16,  # batches of 64 KiB: a map goes in many
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 250_000,  # microseconds
    "timestamping/enabled": True,  # a cache wants it
    "transport/shared_memory/enabled": False,
}


class _Publisher:
    """One topic's publisher, and the token that tells of it."""

    def __init__(self, session: zenoh.Session, topic: Topic, domain: int, token: str) -> None:
        self._id = publisher_id(token)
        self._sequence = 0
        self._publisher: Any
        if topic.latched:
            self._publisher = zenoh.ext.declare_advanced_publisher(
                session,
                topic.key(domain),
                congestion_control=zenoh.CongestionControl.DROP,
                cache=zenoh.ext.CacheConfig(max_samples=topic.depth),
                publisher_detection=True,
            )
        else:
            self._publisher = session.declare_publisher(
                topic.key(domain), congestion_control=zenoh.CongestionControl.DROP
            )
        self._token = session.liveliness().declare_token(token)

    def put(self, data: bytes, now_ns: int) -> None:
        self._sequence += 1
        self._publisher.put(data, attachment=attachment(self._sequence, now_ns, self._id))


class Ros2Node:
    """One node with its publishers.

    Args:
        name: the node's.
        router: the endpoint of ROS 2's router; one that is away is tried again and again.
        domain: the ROS domain.
        unix_ns: the clock for the times of sending.

    Raises:
        BusError: the endpoint is none.
    """

    def __init__(
        self, name: str, *, router: str = ROUTER, domain: int = 0, unix_ns: Callable[[], int] = time.time_ns
    ) -> None:
        config = zenoh.Config()
        try:
            for key, value in (_SETTINGS | {"connect/endpoints": [router]}).items():
                config.insert_json5(key, json.dumps(value))
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise BusError(str(error).split(" at /")[0], router) from error
        self._name, self._domain, self._unix_ns = name, domain, unix_ns
        self._id = str(self._session.info.zid())
        self._publishers: dict[str, _Publisher] = {}
        self._token = self._session.liveliness().declare_token(node_token(domain, self._id, name))

    def publish(self, topic: Topic, data: bytes) -> None:
        """Give a message, CDR with its header, to whoever reads that topic."""
        if topic.name not in self._publishers:
            token = topic.token(self._domain, self._id, self._name, len(self._publishers) + 1)
            self._publishers[topic.name] = _Publisher(self._session, topic, self._domain, token)
        self._publishers[topic.name].put(data, self._unix_ns())

    def close(self) -> None:
        """Leave."""
        with contextlib.suppress(zenoh.ZError):
            self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
