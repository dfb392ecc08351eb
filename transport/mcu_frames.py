"""What a robot's microcontroller and its computer say to each other: one table, from which both sides' code is derived.

A frame's content is its kind and the protocol's version (a byte each) followed by the fields below, little-endian and
unpadded. Where a group follows, a byte ``count`` stands behind the fields, and then the group's fields repeat that
often. ``transport.framing`` puts a checksum behind the content and wraps it for the line; ``transport.firmware`` turns
the table into the microcontroller's C.

Laws kept here: what is decoded is within the table's limits, all of it or nothing; x forward, y left, angles
counter-clockwise in 1/65536 turn; lengths in millimetres; stamps in milliseconds since the microcontroller started.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import index
from typing import NamedTuple, cast

VERSION = 1
MAX_BEAMS = 32
"""Range sensors on one robot; a sample of all their readings still fits into one COBS block of 254 bytes."""

# Range status: what a reading is worth.
RANGE_VALID = 0
RANGE_NOTHING = 1  # nothing within the sensor's range
RANGE_INVALID = 2  # the sensor does not trust it; it says nothing


class FrameError(ValueError):
    """A frame that passed its checksum and yet is none of ours.

    Attributes:
        reason: one of `REASONS`.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class Beam(NamedTuple):
    """One range sensor: where it sits and looks on the robot."""

    x_mm: int
    y_mm: int
    bearing_turn16: int
    half_width_turn16: int


class Range(NamedTuple):
    """One reading: millimetres along the beam, and its status."""

    range_mm: int
    status: int


class Field(NamedTuple):
    """A field of a frame: its name (ending in its unit), its type in C, what it means, and its limits if it has any.

    Limits are inclusive; where there is none, all that the type can hold is welcome.
    """

    name: str
    c_type: str
    meaning: str
    least: int | None = None
    largest: int | None = None


class Group(NamedTuple):
    """Fields that repeat at the end of a frame."""

    name: str
    item: type[Beam] | type[Range]
    fields: tuple[Field, ...]


class Layout(NamedTuple):
    """One kind of frame: its name, its first byte, its fields, and what repeats after them."""

    name: str
    kind: int
    fields: tuple[Field, ...]
    group: Group | None


@dataclass(frozen=True, slots=True)
class Hello:
    """From the microcontroller when it starts, and whenever a heartbeat asks for it: what it is made of."""

    firmware: int
    ticks_per_metre: int
    wheel_base_um: int
    sample_period_ms: int
    max_range_mm: int
    heading_calibration: int
    clock_ms: int
    beams: tuple[Beam, ...]


@dataclass(frozen=True, slots=True)
class Sample:
    """From the microcontroller, at a steady rate: everything it senses at one instant."""

    sequence: int
    stamp_ms: int
    left_ticks: int
    right_ticks: int
    heading_turn16: int
    heading_valid: int
    ranges: tuple[Range, ...]


@dataclass(frozen=True, slots=True)
class Drive:
    """To the microcontroller: wheel speeds, for a while."""

    answers: int
    left_mm_s: int
    right_mm_s: int
    valid_ms: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """From either side, once a second: that it lives, and what the line did to the frames it received."""

    sequence: int
    ask_hello: int
    good: int
    damaged: int


Frame = Hello | Sample | Drive | Heartbeat

LAYOUTS: dict[type[Frame], Layout] = {
    Hello: Layout(
        "hello",
        1,
        (
            Field("firmware", "uint32_t", "the firmware's version, as it counts them"),
            Field("ticks_per_metre", "uint32_t", "encoder ticks of one wheel per metre it rolls", 1),
            Field("wheel_base_um", "uint32_t", "distance between the wheels' contact points", 1),
            Field("sample_period_ms", "uint16_t", "time from one sample to the next", 1),
            Field("max_range_mm", "uint16_t", "how far the range sensors see", 1),
            Field("heading_calibration", "uint8_t", "0 (none) to 3 (full), as the BNO055 says", 0, 3),
            Field("clock_ms", "uint64_t", "swarm time in ms at this microcontroller's stamp 0, 0 if it does not know"),
        ),
        Group(
            "beams",
            Beam,
            (
                Field("x_mm", "int16_t", "forward of the robot's centre"),
                Field("y_mm", "int16_t", "left of the robot's centre"),
                Field("bearing_turn16", "uint16_t", "counter-clockwise from forward"),
                Field("half_width_turn16", "uint16_t", "half of its field of view"),
            ),
        ),
    ),
    Sample: Layout(
        "sample",
        2,
        (
            Field("sequence", "uint16_t", "counts samples from 0 and wraps"),
            Field("stamp_ms", "uint32_t", "when it was sensed, since the microcontroller started; wraps"),
            Field("left_ticks", "int32_t", "left wheel's encoder, wraps"),
            Field("right_ticks", "int32_t", "right wheel's encoder, wraps"),
            Field("heading_turn16", "uint16_t", "absolute heading, counter-clockwise"),
            Field("heading_valid", "uint8_t", "1 if the heading can be trusted", 0, 1),
        ),
        Group(
            "ranges",
            Range,
            (
                Field("range_mm", "uint16_t", "along the beam"),
                Field("status", "uint8_t", "0 valid, 1 nothing in range, 2 invalid", 0, 2),
            ),
        ),
    ),
    Drive: Layout(
        "drive",
        3,
        (
            Field("answers", "uint16_t", "the sequence of the newest sample that it takes into account"),
            Field("left_mm_s", "int16_t", "left wheel's speed"),
            Field("right_mm_s", "int16_t", "right wheel's speed"),
            Field("valid_ms", "uint16_t", "the wheels stop after this time unless another drive comes"),
        ),
        None,
    ),
    Heartbeat: Layout(
        "heartbeat",
        4,
        (
            Field("sequence", "uint16_t", "counts heartbeats and wraps"),
            Field("ask_hello", "uint8_t", "1 asks the microcontroller for its hello", 0, 1),
            Field("good", "uint32_t", "frames received whole"),
            Field("damaged", "uint32_t", "frames received damaged"),
        ),
        None,
    ),
}

FROM_MCU = (Hello, Sample, Heartbeat)
TO_MCU = (Drive, Heartbeat)

REASONS = ("length", "version", "kind", "count", "value")
"""Why a frame is none of ours: not its kind's length; a protocol or a kind that we do not know; too many beams; a value
outside its field's limits."""


def bits(c_type: str) -> int:
    """How wide ``int8_t`` .. ``uint64_t`` are."""
    return int(c_type.removeprefix("u").removeprefix("int").removesuffix("_t"))


def c_range(c_type: str) -> tuple[int, int]:
    """The least and the largest value of ``int8_t`` .. ``uint64_t``."""
    span = 2 ** bits(c_type)
    return (0, span - 1) if c_type.startswith("u") else (-span // 2, span // 2 - 1)


def limits(field: Field) -> tuple[int, int]:
    """The least and the largest value that the field may have."""
    least, largest = c_range(field.c_type)
    return (least if field.least is None else field.least), (largest if field.largest is None else field.largest)


def encode(frame: Frame) -> bytes:
    """The frame's content.

    Raises:
        ValueError: a value is outside its field's limits, or there are more than `MAX_BEAMS`.
    """
    return _CODECS[LAYOUTS[type(frame)].kind].encode(frame)


def decode(content: bytes) -> Frame:
    """The frame that `encode` made this content of.

    Raises:
        FrameError: nobody's `encode` makes this content.
    """
    if len(content) < _PREFIX.size:
        raise FrameError("length")
    kind, version = _PREFIX.unpack_from(content)
    if version != VERSION:
        raise FrameError("version")
    if kind not in _CODECS:
        raise FrameError("kind")
    return _CODECS[kind].decode(content)


_PREFIX = struct.Struct("<BB")  # kind, version
_SIGNED_CODES = {8: "b", 16: "h", 32: "i", 64: "q"}  # the struct module's, by bits; unsigned ones are upper case


def _struct_code(c_type: str) -> str:
    code = _SIGNED_CODES[bits(c_type)]
    return code.upper() if c_type.startswith("u") else code


class _Row:
    """Fields in a row, as bytes."""

    def __init__(self, name: str, fields: tuple[Field, ...]) -> None:
        self._names = [f"{name}.{field.name}" for field in fields]
        self._limits = [limits(field) for field in fields]
        self._narrow = [
            (at, *limits(field)) for at, field in enumerate(fields) if limits(field) != c_range(field.c_type)
        ]
        self._struct = struct.Struct("<" + "".join(_struct_code(field.c_type) for field in fields))
        self.size = self._struct.size

    def pack(self, values: Iterable[int]) -> bytes:
        whole = [index(value) for value in values]
        for name, value, (least, largest) in zip(self._names, whole, self._limits, strict=True):
            if not least <= value <= largest:
                raise ValueError(f"{name}: expected {least} to {largest}, got {value}")
        return self._struct.pack(*whole)

    def unpack(self, content: bytes, offset: int) -> tuple[int, ...]:
        values: tuple[int, ...] = self._struct.unpack_from(content, offset)
        for at, least, largest in self._narrow:  # the others cannot but be in range
            if not least <= values[at] <= largest:
                raise FrameError("value")
        return values


class _Codec:
    """One kind of frame, to bytes and back."""

    def __init__(self, frame_type: type[Frame], layout: Layout) -> None:
        self._build = cast("Callable[..., Frame]", frame_type)
        self._prefix = _PREFIX.pack(layout.kind, VERSION)
        self._field_names = [field.name for field in layout.fields]
        self._row = _Row(layout.name, layout.fields)
        self._group = layout.group
        self._item = _Row(layout.group.name, layout.group.fields) if layout.group else None
        self._fixed = len(self._prefix) + self._row.size + (1 if layout.group else 0)
        self.max_content = self._fixed + (MAX_BEAMS * self._item.size if self._item else 0)

    def encode(self, frame: Frame) -> bytes:
        content = self._prefix + self._row.pack(getattr(frame, name) for name in self._field_names)
        if self._group is None or self._item is None:
            return content
        items = getattr(frame, self._group.name)
        if len(items) > MAX_BEAMS:
            raise ValueError(f"{self._group.name}: expected at most {MAX_BEAMS}, got {len(items)}")
        return content + bytes([len(items)]) + b"".join(map(self._item.pack, items))

    def decode(self, content: bytes) -> Frame:
        if len(content) < self._fixed:
            raise FrameError("length")
        count = content[self._fixed - 1] if self._item else 0
        if count > MAX_BEAMS:
            raise FrameError("count")
        item_size = self._item.size if self._item else 0
        if len(content) != self._fixed + count * item_size:
            raise FrameError("length")
        values = self._row.unpack(content, len(self._prefix))
        if self._group is None or self._item is None:
            return self._build(*values)
        offsets = range(self._fixed, len(content), item_size)
        build_item = cast("Callable[..., Beam | Range]", self._group.item)
        return self._build(*values, tuple(build_item(*self._item.unpack(content, offset)) for offset in offsets))


_CODECS = {layout.kind: _Codec(frame_type, layout) for frame_type, layout in LAYOUTS.items()}

MAX_CONTENT = max(codec.max_content for codec in _CODECS.values())
"""The longest content of a frame, in bytes."""
