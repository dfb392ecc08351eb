"""``orion observe --ros2``: what the observer knows as ROS 2 topics, for RViz and navigation, with no ROS installed.

The map is on ``/map``, for late ones too; ``/tf``, and of each robot its pose, scan and hits as in a log.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from agent.errors import UserError
from agent.ros_messages import MAP_TOPIC, TRANSFORMS_TOPIC, RosMessage
from agent.ros_types import type_hash
from agent.ros_view import RosView
from swarm.messages import Update
from swarm.peer import Peer
from swarm.session import Descriptor
from transport.bus import BusError
from transport.ros2_format import Topic
from transport.ros2_node import Ros2Node

_PERIOD = 0.1
"""Seconds between looks at the map, which has a rate of its own."""


def topic_of(message: RosMessage) -> Topic:
    """Where a message goes: the map is kept for whoever comes late; transforms are many."""
    name, msgtype = message.topic, message.msgtype
    latched = name == MAP_TOPIC
    depth = 1 if latched else 100 if name == TRANSFORMS_TOPIC else 10
    return Topic(name, msgtype, type_hash(msgtype), depth, latched)


class Ros2:
    """A recorder's twin whose messages go out.

    Args:
        router: the endpoint of ROS 2's router.

    Attributes:
        status: always empty: a router that is away is tried again.

    Raises:
        UserError: it is none.
    """

    def __init__(self, router: str) -> None:
        self.status = ""
        try:
            self._node = Ros2Node("orion", router=router)
        except BusError as error:
            raise UserError(error.where, error.what, "give --ros2-router tcp/HOST:PORT") from None
        self._view: RosView | None = None

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Publish an update that the peer has applied."""
        if self._view is not None:
            self._publish(self._view.update(descriptor, update))

    def watch(self, peer: Peer) -> Callable[[float], None]:
        """What that peer's loop is to do in every turn."""
        view = self._view = RosView(peer)
        due = -math.inf

        def turn(now: float) -> None:
            nonlocal due
            if now >= due:
                due = now + _PERIOD
                self._publish(view.map(now))

        return turn

    def close(self) -> dict[str, Any]:
        """Publish the last map and leave."""
        if self._view is not None:
            self._publish(self._view.map(math.inf))
        self._node.close()
        return {}

    def _publish(self, messages: Iterable[RosMessage]) -> None:
        for message in messages:
            self._node.publish(topic_of(message), message.data)
