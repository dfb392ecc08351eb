"""How ROS 2 speaks over Zenoh: the keys, tokens and attachments of rmw_zenoh_cpp 0.2 (ROS 2 Jazzy).

Followed from its design document (github.com/ros2/rmw_zenoh, docs/design.md); the tests compare with zenoh-ros2-sdk,
which was written by others. Nobody has tried it with a real ROS 2 here. A payload is CDR, which this file knows not.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from zenoh.ext import Int64, z_serialize

_GRAPH = "@ros2_lv"
_NOTHING = "%"  # an empty enclave or namespace, and a slash in a name


class Topic(NamedTuple):
    """A topic of one type.

    Attributes:
        name: such as ``/map``.
        msgtype: such as ``nav_msgs/msg/OccupancyGrid``.
        type_hash: as in REP 2016, ``RIHS01_...``.
        depth: how many messages a reader shall keep.
        latched: whether who comes late shall get the last messages too (QoS durability transient local).
    """

    name: str
    msgtype: str
    type_hash: str
    depth: int = 10
    latched: bool = False

    @property
    def _type(self) -> str:
        package, kind, name = self.msgtype.split("/")
        return f"{package}::{kind}::dds_::{name}_/{self.type_hash}"

    @property
    def _qos(self) -> str:
        """Reliability, durability, history, deadline, lifespan, liveliness; what is left out is the default."""
        return f":{'1' if self.latched else ''}:,{self.depth}:,:,:,,"

    def key(self, domain: int) -> str:
        """Where its messages are."""
        return f"{domain}/{self.name.lstrip('/')}/{self._type}"

    def token(self, domain: int, session: str, node: str, entity: int) -> str:
        """What a publisher's presence is told by.

        Args:
            domain: the ROS domain.
            session: the Zenoh session's id.
            node: the node's name; its number in the session is 0.
            entity: the publisher's number in the session.
        """
        name = self.name.replace("/", _NOTHING)
        whose = f"{_GRAPH}/{domain}/{session}/0/{entity}/MP/{_NOTHING}/{_NOTHING}/{node}"
        return f"{whose}/{name}/{self._type}/{self._qos}"


def node_token(domain: int, session: str, node: str) -> str:
    """What a node's presence is told by; the node has the number 0 in the session."""
    return f"{_GRAPH}/{domain}/{session}/0/0/NN/{_NOTHING}/{_NOTHING}/{node}"


def publisher_id(token: str) -> bytes:
    """A publisher's 16 bytes, which nobody else has."""
    return hashlib.blake2b(token.encode(), digest_size=16).digest()


def attachment(sequence: int, stamp_ns: int, publisher: bytes) -> bytes:
    """What goes with a message: its number from 1, when it was sent, and the publisher's id."""
    head = bytes(z_serialize(Int64(sequence))) + bytes(z_serialize(Int64(stamp_ns)))
    return head + bytes(z_serialize(publisher))
