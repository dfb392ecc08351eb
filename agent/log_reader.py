"""Reading a log in the order in which it was written, also one whose end was torn off.

Laws kept here: everything before a tear is given, and nothing after it; every chunk's checksum is verified; where a
file ends early the reader says so.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from agent.errors import UserError
from agent.log_writer import METADATA
from agent.recorder import SWARM_TOPIC
from agent.ros_types import BYTES, decode
from swarm.drops import Drop
from swarm.messages import decode as decode_message
from swarm.told import Retelling, Told

_LARGEST_RECORD = 1 << 28


class Logged(NamedTuple):
    """One message of a log.

    Attributes:
        topic: where it was.
        msgtype: its type's name.
        definition: its type's definition.
        log_ns: when it was recorded, nanoseconds of Unix time.
        publish_ns: when its content was sensed, nanoseconds of swarm time.
        data: CDR.
    """

    topic: str
    msgtype: str
    definition: str
    log_ns: int
    publish_ns: int
    data: bytes


class LogReader:
    """Gives the messages of one file; may be read several times.

    Args:
        path: the file.

    Attributes:
        configuration: the swarm's, as TOML.
        torn: why the file ends early, in words; empty if it is whole (known once all was read).

    Raises:
        UserError: it cannot be read, is no MCAP file, or one of somebody else.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.torn = ""
        try:
            with path.open("rb") as file:
                magic = file.read(8)
        except (OSError, ValueError) as error:
            what = (isinstance(error, OSError) and error.strerror) or str(error)
            raise UserError(path, f"cannot be read: {what}", "check the path") from None
        if magic != b"\x89MCAP0\r\n":
            raise UserError(path, "is no MCAP file", "give one that --record wrote")
        self.configuration = self._configuration()

    def _configuration(self) -> str:
        """What comes before the first message: the types of somebody else's may be any."""
        for record in self._records():
            match record:
                case Metadata(name=name, metadata=table) if name == METADATA and "configuration" in table:
                    return str(table["configuration"])
                case Message():
                    break
        raise UserError(self._path, "holds no configuration", "give a file that --record wrote")

    def __iter__(self) -> Iterator[Logged]:
        self.torn = ""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for record in self._records():
            match record:
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    channels[record.id] = record
                case Message():
                    channel = channels[record.channel_id]
                    schema = schemas[channel.schema_id]
                    yield Logged(
                        channel.topic,
                        schema.name,
                        schema.data.decode(),
                        record.log_time,
                        record.publish_time,
                        bytes(record.data),
                    )

    def _records(self) -> Iterator[Any]:
        """The records before the index, up to the first that is not whole."""
        indexed = False
        with self._path.open("rb") as file:
            records = StreamReader(file, validate_crcs=True, record_size_limit=_LARGEST_RECORD).records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    break
                except Exception as error:  # the library raises many kinds where a file is torn
                    self.torn = f"torn off ({str(error) or type(error).__name__})"
                    break
                indexed |= isinstance(record, DataEnd)
                if not indexed:
                    yield record

    def told(self) -> Iterator[tuple[int, Told]]:
        """The swarm's own messages and when each was recorded, in nanoseconds.

        Raises:
            UserError: they are not what a recorder wrote.
        """
        retelling = Retelling()
        for logged in self:
            if logged.topic != SWARM_TOPIC:
                continue
            try:
                told = retelling.hear(decode_message(decode(logged.data, BYTES).data.tobytes()))
            except (Drop, ValueError) as error:
                raise UserError(self._path, f"holds no true session: {error}", "record it again") from None
            if told is not None:
                yield logged.log_ns, told

    def swarm(self) -> dict[str, Any]:
        """The recorded swarm's configuration.

        Raises:
            UserError: it is none.
        """
        try:
            return tomllib.loads(self.configuration)
        except ValueError as error:
            raise UserError(self._path, f"holds no configuration: {error}", "give a file that --record wrote") from None
