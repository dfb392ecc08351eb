"""The ROS 2 message types that we speak, as rosbags knows them: their fields, their bytes (CDR), their definitions.

No ROS is installed for it. The definitions are those of ROS 2 Jazzy; of these types they have been the same since Foxy.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_typestore

GRID = "nav_msgs/msg/OccupancyGrid"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
SCAN = "sensor_msgs/msg/LaserScan"
POINTS = "sensor_msgs/msg/PointCloud2"
BYTES = "std_msgs/msg/UInt8MultiArray"

_STORE = get_typestore(Stores.ROS2_JAZZY)


def make(msgtype: str, **fields: Any) -> Any:
    """A message of that type."""
    return _STORE.types[msgtype](**fields)


def encode(message: Any) -> bytes:
    """A message as CDR, little-endian, with its header of four bytes."""
    return bytes(_STORE.serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, msgtype: str) -> Any:
    """The message of some CDR.

    Raises:
        ValueError: it is none of that type.
    """
    try:
        return _STORE.deserialize_cdr(data, msgtype)
    except Exception as error:  # the library raises many kinds on damaged bytes
        raise ValueError(f"no {msgtype}: {error}") from None


@cache
def definition(msgtype: str) -> str:
    """The type's definition with all that it contains, in ROS's own words."""
    return _STORE.generate_msgdef(msgtype, ros_version=2)[0]


@cache
def type_hash(msgtype: str) -> str:
    """The type's hash as REP 2016 defines it: ``RIHS01_...``."""
    return _STORE.hash_rihs01(msgtype)
