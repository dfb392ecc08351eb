"""What peers say, to the byte: each message a flat msgpack array [version, kind, field, ...] of integers and bytes.

One table of fields with their limits, from which encoding, decoding and checking are all derived. Decoding either gives
a message whose every field is within its limits or drops it for a named reason; it raises nothing else.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, NamedTuple, get_args

import msgpack

from mapping.lattice import TileKey
from swarm import limits
from swarm.drops import Drop
from swarm.session import SessionId

VERSION = 1

REFUSED = 2**32 - 1
"""In a digest, instead of n: the sender knows the session and will never take it."""


class _Int(NamedTuple):
    low: int
    high: int

    def accepts(self, value: object) -> bool:
        return type(value) is int and self.low <= value <= self.high


class _Bytes(NamedTuple):
    low: int
    high: int
    multiple: int = 1

    def accepts(self, value: object) -> bool:
        return type(value) is bytes and self.low <= len(value) <= self.high and len(value) % self.multiple == 0


def _int(low: int, high: int) -> Any:
    return field(metadata={"limit": _Int(low, high)})


def _bytes(low: int, high: int, multiple: int = 1) -> Any:
    return field(metadata={"limit": _Bytes(low, high, multiple)})


_U64 = 2**64 - 1
_POSITION = struct.Struct("<8sI")
_MANIFEST_ENTRY = struct.Struct("<iiIQ")
_NEED_ENTRY = struct.Struct("<iiQ")


class Mark(NamedTuple):
    """What a state knows of a tile besides its cells.

    Attributes:
        version: the last update that changed it.
        hash: of its key and cells (``swarm.state.tile_hash``).
    """

    version: int
    hash: int


@dataclass(frozen=True, slots=True)
class Session:
    """A session's descriptor, from anyone who has it."""

    KIND: ClassVar[int] = 1
    TOPIC: ClassVar[str] = "session"
    descriptor: bytes = _bytes(1, 64 << 10)


@dataclass(frozen=True, slots=True)
class Update:
    """What changed in a session since update n - 1.

    Attributes:
        session: whose.
        n: counts from 1.
        form: ``SCANS``, ``CELLS`` or ``TILES``: how to read the payload.
        payload: a scan block, or entries of changed cells or whole tiles.
        trail: a scan block without ranges: the poses since the last update, where the payload has none. May be empty.
        check: of the state after this update (``swarm.state.state_check``).
    """

    KIND: ClassVar[int] = 2
    TOPIC: ClassVar[str] = "update"
    SCANS: ClassVar[int] = 1
    CELLS: ClassVar[int] = 2
    TILES: ClassVar[int] = 3
    session: SessionId = _bytes(8, 8)
    n: int = _int(1, limits.MAX_N)
    form: int = _int(1, 3)
    payload: bytes = _bytes(0, limits.MAX_MESSAGE)
    trail: bytes = _bytes(0, limits.MAX_MESSAGE)
    check: int = _int(0, _U64)


@dataclass(frozen=True, slots=True)
class Digest:
    """How far the sender is in the sessions it knows.

    Attributes:
        complete: 1 if it follows or refuses no others, 0 if this is an extract.
        controls: the check of its control records (``swarm.controls.Controls.check``).
        entries: session (8 bytes) and n (uint32), or ``REFUSED``, each.
    """

    KIND: ClassVar[int] = 3
    TOPIC: ClassVar[str] = "digest"
    complete: int = _int(0, 1)
    controls: int = _int(0, _U64)
    entries: bytes = _bytes(0, limits.MAX_SESSIONS * _POSITION.size, _POSITION.size)

    @classmethod
    def of(cls, positions: Iterable[tuple[SessionId, int]], *, complete: bool, controls: int = 0) -> Digest:
        """A digest of some sessions' n."""
        return cls(int(complete), controls, b"".join(_POSITION.pack(session, n) for session, n in positions))

    def positions(self) -> dict[SessionId, int]:
        """The n of each session."""
        return dict(_POSITION.iter_unpack(self.entries))

    @staticmethod
    def fitting(mtu: int) -> int:
        """How many entries fit into one payload."""
        return max(1, (mtu - 17) // _POSITION.size)


@dataclass(frozen=True, slots=True)
class Want:
    """A request for what the sender lacks of a session.

    Attributes:
        n: the state it has, -1 if it does not even have the descriptor.
        through: the last update it lacks, 0 for all there are.
    """

    KIND: ClassVar[int] = 4
    TOPIC: ClassVar[str] = "want"
    session: SessionId = _bytes(8, 8)
    n: int = _int(-1, limits.MAX_N)
    through: int = _int(0, limits.MAX_N)


@dataclass(frozen=True, slots=True)
class Manifest:
    """The state of a session at a checkpoint, as the tiles that changed after the asker's n.

    Attributes:
        n: the checkpoint.
        since: the asker's n; tiles not listed are as they were then.
        root: BLAKE2b-128 of the whole state (``swarm.state.State.root``).
        entries: ty, tx (int32), version (uint32), hash (uint64) each.
    """

    KIND: ClassVar[int] = 5
    TOPIC: ClassVar[str] = "manifest"
    session: SessionId = _bytes(8, 8)
    n: int = _int(1, limits.MAX_N)
    since: int = _int(0, limits.MAX_N)
    root: bytes = _bytes(16, 16)
    entries: bytes = _bytes(0, limits.MAX_TILES * _MANIFEST_ENTRY.size, _MANIFEST_ENTRY.size)

    @staticmethod
    def pack(marks: Mapping[TileKey, Mark]) -> bytes:
        """The entries of some tiles."""
        return b"".join(_MANIFEST_ENTRY.pack(*key, *marks[key]) for key in sorted(marks))

    def marks(self) -> dict[TileKey, Mark]:
        """The tiles listed."""
        return {
            TileKey(ty, tx): Mark(version, check)
            for ty, tx, version, check in _MANIFEST_ENTRY.iter_unpack(self.entries)
        }


@dataclass(frozen=True, slots=True)
class Need:
    """A request for tiles by their content.

    Attributes:
        n: the checkpoint whose manifest named them.
        since: as in that manifest, so that a provider that has moved on can answer with its own.
        entries: ty, tx (int32), hash (uint64) each.
    """

    KIND: ClassVar[int] = 6
    TOPIC: ClassVar[str] = "need"
    session: SessionId = _bytes(8, 8)
    n: int = _int(1, limits.MAX_N)
    since: int = _int(0, limits.MAX_N)
    entries: bytes = _bytes(_NEED_ENTRY.size, limits.MAX_NEED * _NEED_ENTRY.size, _NEED_ENTRY.size)

    @staticmethod
    def pack(wanted: Iterable[tuple[TileKey, int]]) -> bytes:
        """The entries of some tiles: key and hash."""
        return b"".join(_NEED_ENTRY.pack(*key, check) for key, check in wanted)

    def wanted(self) -> Iterator[tuple[TileKey, int]]:
        """Key and hash of each tile."""
        for ty, tx, check in _NEED_ENTRY.iter_unpack(self.entries):
            yield TileKey(ty, tx), check

    @staticmethod
    def fitting(mtu: int) -> int:
        """How many entries fit into one payload."""
        return min(limits.MAX_NEED, max(1, (mtu - 32) // _NEED_ENTRY.size))


@dataclass(frozen=True, slots=True)
class TilesMessage:
    """Tiles that were asked for: entries of whole tiles (``swarm.tile_block``)."""

    KIND: ClassVar[int] = 7
    TOPIC: ClassVar[str] = "tiles"
    session: SessionId = _bytes(8, 8)
    payload: bytes = _bytes(1, limits.MAX_MESSAGE)


@dataclass(frozen=True, slots=True)
class Hello:
    """Who is there. Presence, never part of any replica.

    Attributes:
        role: ``ROBOT`` or ``OBSERVER``.
        name: the robot's id, or what the observer calls itself.
        software: the sender's program and version.
        session: the one that it writes; empty if none.
    """

    KIND: ClassVar[int] = 8
    TOPIC: ClassVar[str] = "hello"
    ROBOT: ClassVar[int] = 1
    OBSERVER: ClassVar[int] = 2
    role: int = _int(1, 2)
    name: bytes = _bytes(1, 64)
    software: bytes = _bytes(0, 64)
    session: bytes = field(default=b"", metadata={"limit": _Bytes(0, 8, 8)})


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a message that is longer than the bus's MTU; it counts only when all are here.

    Attributes:
        digest: BLAKE2b-64 of the whole message, which names it: the same message from two peers has the same parts.
        part: counts from 0.
        parts: how many there are.
        data: this piece.
    """

    KIND: ClassVar[int] = 9
    TOPIC: ClassVar[str] = "part"
    digest: bytes = _bytes(8, 8)
    part: int = _int(0, limits.MAX_PARTS - 1)
    parts: int = _int(2, limits.MAX_PARTS)
    data: bytes = _bytes(1, limits.MAX_MESSAGE)


@dataclass(frozen=True, slots=True)
class Control:
    """An operator's decision. Of all about one subject the greatest (revision, issuer, value) is in force.

    Attributes:
        setting: ``EVICT`` or ``START_POSE``: how to read the others (``swarm.controls``).
        subject: what it is about: a session's id, or a robot's.
        revision: one more than the greatest that its issuer knew.
        issuer: who decided.
        value: what was decided.
    """

    KIND: ClassVar[int] = 10
    TOPIC: ClassVar[str] = "control"
    EVICT: ClassVar[int] = 1
    START_POSE: ClassVar[int] = 2
    setting: int = _int(1, 2)
    subject: bytes = _bytes(1, 32)
    revision: int = _int(1, limits.MAX_REVISION)
    issuer: bytes = _bytes(8, 8)
    value: bytes = _bytes(1, 18)


@dataclass(frozen=True, slots=True)
class AskControls:
    """A request for all control records.

    Attributes:
        check: of the asker's; whoever has the same has nothing to say.
    """

    KIND: ClassVar[int] = 11
    TOPIC: ClassVar[str] = "ask"
    check: int = _int(0, _U64)


Message = Session | Update | Digest | Want | Manifest | Need | TilesMessage | Hello | Part | Control | AskControls

_KINDS: dict[int, type[Message]] = {kind.KIND: kind for kind in get_args(Message)}
_LIMITS = {kind: [each.metadata["limit"] for each in fields(kind)] for kind in _KINDS.values()}
_MOST_ELEMENTS = 15
_NAMES = {kind: [each.name for each in fields(kind)] for kind in _KINDS.values()}


def encode(message: Message) -> bytes:
    """The message's bytes."""
    kind = type(message)
    values = [getattr(message, name) for name in _NAMES[kind]]
    assert all(limit.accepts(value) for limit, value in zip(_LIMITS[kind], values, strict=True)), message
    return bytes(msgpack.packb([VERSION, kind.KIND, *values]))


def _flat_array(data: bytes) -> list[Any]:
    """The elements of one msgpack array; inner arrays are refused before they cost anything.

    Raises:
        Exception: of any kind, if there is anything else than a short flat array.
    """
    unpacker = msgpack.Unpacker(
        raw=True, max_buffer_size=len(data), max_array_len=0, max_map_len=0, max_ext_len=0, max_str_len=0
    )
    unpacker.feed(data)
    count = unpacker.read_array_header()
    if count > _MOST_ELEMENTS:
        raise ValueError("message: too many fields")
    array = [unpacker.unpack() for _ in range(count)]
    if unpacker.tell() != len(data):
        raise ValueError("message: something follows it")
    return array


def decode(data: bytes) -> Message:
    """The message of some bytes.

    Raises:
        Drop: ``too_long``, ``not_msgpack``, ``other_version``, ``unknown_kind``, ``bad_shape`` or ``out_of_range``.
    """
    if len(data) > limits.MAX_MESSAGE:
        raise Drop("too_long")
    try:
        array = _flat_array(data)
    except Exception:  # msgpack raises many kinds on hostile bytes
        raise Drop("not_msgpack") from None
    if len(array) < 2:
        raise Drop("bad_shape")
    version, number, *values = array
    if version != VERSION:
        raise Drop("other_version")
    kind = _KINDS.get(number) if type(number) is int else None
    if kind is None:
        raise Drop("unknown_kind")
    checks = _LIMITS[kind]
    if len(values) != len(checks):
        raise Drop("bad_shape")
    for check, value in zip(checks, values, strict=True):
        if not check.accepts(value):
            raise Drop("out_of_range" if type(value) in {int, bytes} else "bad_shape")
    return kind(*values)
