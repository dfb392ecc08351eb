"""``--record run.mcap``: all that a peer comes to hold, in the swarm's own messages and as ROS 2 messages.

Laws kept here: from the swarm's own messages (topic ``/orion``, see ``swarm.told``) every session can be made again,
bit for bit; what was recorded is on its way to the disk within a second; trouble with the file never stops the swarm.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from agent.log_writer import LogWriter
from agent.ros_messages import RosMessage
from agent.ros_types import BYTES, encode, make
from agent.ros_view import RosView
from swarm.messages import Message, Update
from swarm.messages import encode as encode_message
from swarm.peer import Peer
from swarm.session import Descriptor
from swarm.told import Teller

SWARM_TOPIC = "/orion"
"""The swarm's own messages, each the data of a ``UInt8MultiArray``."""

_PERIOD = 1.0
"""Seconds after which what was recorded is given to the system."""

_LARGEST_NS = 2**63 - 1


class Recorder:
    """Writes one log.

    Args:
        path: a new file.
        configuration: the swarm's, as TOML.
        unix_ns: the clock for log times.

    Attributes:
        status: why nothing more is recorded, in words; empty if all is well.

    Raises:
        UserError: the file is there already or cannot be made.
    """

    def __init__(self, path: Path, configuration: str, unix_ns: Callable[[], int] = time.time_ns) -> None:
        self.status = ""
        self._path = path
        self._log = LogWriter(path, configuration)
        self._unix_ns = unix_ns
        self._teller: Teller | None = None
        self._view: RosView | None = None

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an update that the peer has applied; those before ``watch`` are told by it."""
        if self._teller is None or self._view is None or self.status:
            return
        messages = self._view.update(descriptor, update)
        stamp_ms = max((message.stamp_ms for message in messages), default=None)
        self._write([*self._told(self._teller.applied(update), stamp_ms), *messages])

    def watch(self, peer: Peer) -> Callable[[float], None]:
        """What that peer's loop is to do in every turn."""
        self._teller, self._view = Teller(peer), RosView(peer)
        due = -math.inf

        def turn(now: float) -> None:
            nonlocal due
            if now >= due:
                due = now + _PERIOD
                self._catch_up(now)

        return turn

    def close(self) -> dict[str, Any]:
        """Write the rest, the last map included, and let go of the file; gives what came of it."""
        self._catch_up(math.inf)
        if not self.status:
            try:
                self._log.close()
            except OSError as error:
                self._fail(error)
        return {"log": {"path": str(self._path), "messages": self._log.messages, "status": self.status}}

    def abandon(self) -> None:
        """Let go of the file as a crash would."""
        self._log.abandon()

    def _catch_up(self, now: float) -> None:
        if self._teller is not None and self._view is not None and not self.status:
            self._write([*self._told(self._teller.news(), None), *self._view.map(now)])
        if not self.status:
            try:
                self._log.flush()
            except OSError as error:
                self._fail(error)

    def _told(self, messages: Iterable[Message], stamp_ms: int | None) -> Iterator[RosMessage]:
        """The swarm's own messages; those without a stamp count as published when they are recorded."""
        for message in messages:
            layout = make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
            data = np.frombuffer(encode_message(message), np.uint8)
            content = encode(make(BYTES, layout=layout, data=data))
            published_ms = self._unix_ns() // 1_000_000 if stamp_ms is None else stamp_ms
            yield RosMessage(SWARM_TOPIC, BYTES, published_ms, content)

    def _write(self, messages: Iterable[RosMessage]) -> None:
        log_ns = self._unix_ns()
        try:
            for topic, msgtype, stamp_ms, data in messages:
                publish_ns = min(max(0, 1_000_000 * stamp_ms), _LARGEST_NS)
                self._log.write(topic, msgtype, data, log_ns, publish_ns)
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.status = f"{self._path}: cannot be written: {error.strerror}; nothing more is recorded"
        self._log.abandon()
