"""What operators decide: small records, of which the same ones are in force at every peer (last writer wins).

Laws kept here: of two records about one subject the greater (revision, issuer, value) is in force, whichever came
first and whatever any clock says; a record is never taken away, only superseded, so that peers that have heard the
same records have the same table.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from typing import NamedTuple

from mapping.pose import QuantisedPose
from swarm.drops import Drop
from swarm.limits import MAX_CONTROLS, MAX_COORDINATE_MM, MAX_REVISION
from swarm.messages import Control, encode
from swarm.session import ROBOT_ID, SessionId

EVICTED = b"\x01"
READMITTED = b"\x00"

_START_POSE = struct.Struct("<iiH8s")
_NO_SESSION = bytes(8)


class StartPose(NamedTuple):
    """A robot's start pose as an operator gave it.

    Attributes:
        pose: in the common frame.
        session: the robot's newest session that the issuer knew, or None.
    """

    pose: QuantisedPose
    session: SessionId | None

    def pack(self) -> bytes:
        """The value of a record: x_mm, y_mm (int32), yaw (uint16), session (8 bytes, zeros for None)."""
        return _START_POSE.pack(*self.pose, self.session or _NO_SESSION)

    @classmethod
    def unpack(cls, value: bytes) -> StartPose:
        """What a record's value says."""
        *pose, session = _START_POSE.unpack(value)
        return cls(QuantisedPose(*pose), None if session == _NO_SESSION else session)


def _sound(control: Control) -> bool:
    """Whether subject and value are what the setting wants."""
    if control.setting == Control.EVICT:
        return len(control.subject) == 8 and control.value in {EVICTED, READMITTED}
    if len(control.value) != _START_POSE.size or not ROBOT_ID.fullmatch(control.subject.decode("latin-1")):
        return False
    pose = StartPose.unpack(control.value).pose
    return max(abs(pose.x_mm), abs(pose.y_mm)) <= MAX_COORDINATE_MM


def _hash(control: Control) -> int:
    """BLAKE2b-64 of the record's message, as a number."""
    return int.from_bytes(hashlib.blake2b(encode(control), digest_size=8).digest(), "little")


def _rank(control: Control) -> tuple[int, bytes, bytes]:
    return control.revision, control.issuer, control.value


class Controls:
    """The records in force. Iterates over them in order of setting and subject.

    Attributes:
        check: the sum of their hashes modulo 2^64, by which tables are compared.
        evicted: the sessions that are not to be summed.
    """

    def __init__(self) -> None:
        self.check = 0
        self.evicted: set[SessionId] = set()
        self._records: dict[tuple[int, bytes], Control] = {}

    def __iter__(self) -> Iterator[Control]:
        return iter([self._records[key] for key in sorted(self._records)])

    def __len__(self) -> int:
        return len(self._records)

    def get(self, setting: int, subject: bytes) -> Control | None:
        """The record in force about a subject."""
        return self._records.get((setting, subject))

    def put(self, control: Control) -> bool:
        """Take a record; gives whether it is in force now and was not before.

        Raises:
            Drop: ``bad_control``, ``too_many``.
        """
        if not _sound(control):
            raise Drop("bad_control")
        known = self.get(control.setting, control.subject)
        if known is not None and _rank(known) >= _rank(control):
            return False
        if known is None and len(self) >= MAX_CONTROLS:
            raise Drop("too_many")
        self._records[control.setting, control.subject] = control
        self.check = (self.check + _hash(control) - (_hash(known) if known else 0)) % 2**64
        if control.setting == Control.EVICT:
            (self.evicted.add if control.value == EVICTED else self.evicted.discard)(control.subject)
        return True

    def next(self, setting: int, subject: bytes, issuer: bytes, value: bytes) -> Control:
        """A record that supersedes the one in force.

        Raises:
            ValueError: there have been too many.
        """
        known = self.get(setting, subject)
        revision = 1 if known is None else known.revision + 1
        if revision > MAX_REVISION:
            raise ValueError(f"control record of {subject!r}: revision {MAX_REVISION} cannot be superseded")
        return Control(setting, subject, revision, issuer, value)

    def start_pose(self, robot: str) -> StartPose | None:
        """The start pose that was decided for a robot, or None if none was."""
        known = self.get(Control.START_POSE, robot.encode())
        return None if known is None else StartPose.unpack(known.value)
