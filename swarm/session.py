"""A session: one run of one robot, and all that decides what its scans are worth.

Laws kept here: a session's descriptor never changes; only its robot writes it; after any restart the robot opens a new
one, and the old one stays as valid evidence, unless the new one says that it replaces it.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Self

import msgpack

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.rays import fan
from mapping.sensor import Beam, Sensor
from swarm.drops import Drop
from swarm.limits import MAX_COORDINATE_MM, MAX_SCANS, MAX_VISITS

SessionId = bytes
"""8 random bytes. Printed as 16 hex digits; sessions sort by it."""

ROBOT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""What robots may be called: it becomes part of file names and key expressions."""

_RULE_EVERY_RAY = 0
"""How scans become evidence: every ray adds to each of its cells. There is no other rule yet."""

_BEAM = struct.Struct("<hhHH")
_START = struct.Struct("<iiH")


@dataclass(frozen=True, slots=True)
class Rules:
    """What all robots of a swarm must share to have one map."""

    lattice: Lattice
    model: EvidenceModel


@dataclass(frozen=True, slots=True)
class Descriptor:
    """What a robot says once about its session.

    Attributes:
        robot: the robot's id.
        session: the session's id, 8 bytes.
        rules: the lattice and the evidence model that its cells are made with.
        sensor: its beams and range.
        start: its start pose in the common frame, or None if nobody knows it; then it is not summed.
        replaces: an earlier session of the same robot, in whose place this one is summed, or None.
    """

    robot: str
    session: SessionId
    rules: Rules
    sensor: Sensor
    start: QuantisedPose | None
    replaces: SessionId | None = None

    def __post_init__(self) -> None:
        if not ROBOT_ID.fullmatch(self.robot):
            raise ValueError(f"robot id {self.robot!r}: expected 1 to 32 letters, digits, - or _")
        if len(self.session) != 8:
            raise ValueError(f"session id: expected 8 bytes, got {len(self.session)}")
        if self.replaces is not None and len(self.replaces) != 8:
            raise ValueError(f"session id to replace: expected 8 bytes, got {len(self.replaces)}")
        if self.replaces == self.session:
            raise ValueError(f"session {self.session.hex()}: it cannot replace itself")
        self.rules.lattice.check_range(self.sensor.max_range_mm)

    @property
    def most_scans(self) -> int:
        """How many scans one update may carry: few, if they have many long rays."""
        longest = self.sensor.max_range_mm // self.rules.lattice.cell_mm + 2
        rays = len(fan(self.sensor, self.rules.lattice).beam)
        return max(1, min(MAX_SCANS, MAX_VISITS // (rays * longest)))

    def encode(self) -> bytes:
        """The descriptor's bytes, by which it is compared and forwarded unchanged."""
        model = self.rules.model
        fields = [
            self.robot.encode(),
            self.session,
            self.rules.lattice.cell_mm,
            model.occupied,
            model.free,
            model.limit,
            _RULE_EVERY_RAY,
            self.sensor.max_range_mm,
            b"".join(_BEAM.pack(*beam) for beam in self.sensor.beams),
            b"" if self.start is None else _START.pack(*self.start),
            self.replaces or b"",
        ]
        return bytes(msgpack.packb(fields))

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """The descriptor of some bytes.

        Raises:
            Drop: ``bad_descriptor``.
        """
        try:
            fields = msgpack.unpackb(data, max_array_len=16, max_map_len=0, max_ext_len=0, raw=True)
            robot, session, cell_mm, occupied, free, limit, rule, max_range_mm, beams, start, replaces = fields
            if rule != _RULE_EVERY_RAY or not all(type(field) is int for field in fields[2:8]):
                raise ValueError("descriptor: unknown rule")
            descriptor = cls(
                robot.decode("ascii"),
                bytes(session),
                Rules(Lattice(cell_mm), EvidenceModel(occupied, free, limit)),
                Sensor(tuple(Beam(*beam) for beam in _BEAM.iter_unpack(beams)), max_range_mm),
                QuantisedPose(*_START.unpack(start)) if start else None,
                bytes(replaces) if replaces else None,
            )
        except Exception:  # msgpack raises many kinds on hostile bytes
            raise Drop("bad_descriptor") from None
        if descriptor.start and max(map(abs, descriptor.start[:2])) > MAX_COORDINATE_MM:
            raise Drop("bad_descriptor")
        if descriptor.encode() != data:
            raise Drop("bad_descriptor")
        return descriptor


def refusal(ours: Rules, descriptor: Descriptor) -> str | None:
    """Why a session cannot be summed with ours, in words for a person, or None if it can."""
    return difference(ours, descriptor.rules)


def difference(ours: Rules, theirs: Rules) -> str | None:
    """What other rules have that ours have not, in words for a person, or None if they are the same."""
    if theirs.lattice != ours.lattice:
        return f"cell size {theirs.lattice.cell} m, ours is {ours.lattice.cell} m"
    for name in ("occupied", "free", "limit"):
        mine, other = getattr(ours.model, name), getattr(theirs.model, name)
        if mine != other:
            return f"evidence {name} {other / 100} nat, ours is {mine / 100} nat"
    return None
