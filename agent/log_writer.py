"""A log: one MCAP file of ROS 2 messages, written so that a process that is killed loses a second at most.

Laws kept here: log times grow from message to message, so that the order in the file is the order in time whoever reads
it; a chunk ends after a second, or when it is full, and goes to the system at once. The configuration of the swarm is
in the file, as metadata.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from mcap.writer import CompressionType, Writer

from agent.errors import UserError
from agent.ros_types import definition

METADATA = "orion"
"""The metadata record's name; its ``configuration`` is the resolved TOML."""

CHUNK_BYTES = 256 << 10


class LogWriter:
    """Writes a new file; use ``close``, or the file has no index and ``orion log recover`` makes one.

    Args:
        path: the file.
        configuration: the swarm's, as TOML.

    Raises:
        UserError: there is such a file already, or it cannot be made.
    """

    def __init__(self, path: Path, configuration: str) -> None:
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise UserError(path, "is there already", "give a name for a new file") from None
        except (OSError, ValueError) as error:
            what = (isinstance(error, OSError) and error.strerror) or str(error)
            raise UserError(path, f"cannot be written: {what}", "choose another place") from None
        self.messages = 0
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="orion-swarm")
        self._writer.add_metadata(METADATA, {"configuration": configuration})
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._newest_ns = 0
        self.flush()

    def write(self, topic: str, msgtype: str, data: bytes, log_ns: int, publish_ns: int) -> None:
        """Append a message.

        Args:
            topic: its topic, always of one type.
            msgtype: such as ``nav_msgs/msg/OccupancyGrid``.
            data: CDR.
            log_ns: when it was recorded, Unix time; where the clock steps back it goes on from the last one.
            publish_ns: when its content was sensed.

        Raises:
            OSError: the file cannot be written.
        """
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schema(msgtype))
        self._newest_ns = max(log_ns, self._newest_ns + 1)
        self._writer.add_message(self._channels[topic], self._newest_ns, data, publish_ns, self.messages)
        self.messages += 1

    def flush(self) -> None:
        """End the chunk and give all to the system.

        Raises:
            OSError: the file cannot be written.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._file.flush()

    def close(self) -> None:
        """Write the index and let go of the file.

        Raises:
            OSError: the file cannot be written.
        """
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Let go of the file as it is."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _schema(self, msgtype: str) -> int:
        if msgtype not in self._schemas:
            self._schemas[msgtype] = self._writer.register_schema(msgtype, "ros2msg", definition(msgtype).encode())
        return self._schemas[msgtype]
