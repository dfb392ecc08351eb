"""What a peer's state file is made of: its tables, its rows to the byte, and what SQLite's errors mean.

A session is kept as its descriptor, its last checkpoint (a row for it, one for each tile) and the updates since; what
a robot sensed in a run as chunks of its journal. Tiles are proved by their hashes and the checkpoint's root, updates by
the check that each carries; every other row, and an update's trail, by a seal: BLAKE2b-64 of its table and content. A
row's content says where it belongs.
"""

from __future__ import annotations

import hashlib
import sqlite3
import struct
from typing import NamedTuple

import msgpack
import numpy as np

from agent.readings import Readings
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from swarm.session import Rules, SessionId

FORMAT = 1
APPLICATION = int.from_bytes(b"Orsw")
PAGE_BYTES = 1024
"""What an update of a robot changes fits into few small pages: a commit writes 2.4 kB, with SQLite's 4096 it is 6."""

SCHEMA = (
    "CREATE TABLE swarm (body BLOB NOT NULL)",
    "CREATE TABLE control (setting INTEGER, subject BLOB, body BLOB NOT NULL, PRIMARY KEY (setting, subject))"
    " WITHOUT ROWID",
    "CREATE TABLE session (session BLOB PRIMARY KEY, body BLOB NOT NULL) WITHOUT ROWID",
    "CREATE TABLE checkpoint (session BLOB PRIMARY KEY, body BLOB NOT NULL) WITHOUT ROWID",
    "CREATE TABLE tile (session BLOB, ty INTEGER, tx INTEGER, version INTEGER NOT NULL, body BLOB NOT NULL,"
    " PRIMARY KEY (session, ty, tx)) WITHOUT ROWID",
    "CREATE TABLE log (session BLOB, n INTEGER, body BLOB NOT NULL, PRIMARY KEY (session, n)) WITHOUT ROWID",
    "CREATE TABLE run (run BLOB PRIMARY KEY, body BLOB NOT NULL) WITHOUT ROWID",
    "CREATE TABLE journal (run BLOB, first INTEGER, body BLOB NOT NULL, PRIMARY KEY (run, first)) WITHOUT ROWID",
)

_MAX_ROW = 16 << 20
"""Bytes. A damaged length shall not make us reserve gigabytes."""
_SEAL_BYTES = 8
_CHECKPOINT = struct.Struct("<8sI16s")
_RUN = struct.Struct("<8s8s?")
_CHUNK = struct.Struct("<8sQ")

_FROM_OUTSIDE = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}
"""Errors that come from where the file lies and who else uses it, and say nothing against what is in it ..."""
_UNREADABLE = {sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_SHORT_READ, sqlite3.SQLITE_IOERR_CORRUPTFS}
"""... but for these."""


SQLITE_ERRORS = (sqlite3.Error, UnicodeError, MemoryError, OverflowError)
"""What Python's sqlite3 raises on damaged files: UnicodeError, where SQLite's message quotes them."""


class StateError(Exception):
    """The file cannot be used now, through no fault of what is in it."""


class ForeignError(StateError):
    """The file is not this swarm's, or not of this format: it is not ours to write to."""


class DamageError(Exception):
    """What is in the file is not what was written."""


def judged(error: Exception) -> str:
    """What damage an error means, in words.

    Raises:
        StateError: it means none.
    """
    code = getattr(error, "sqlite_errorcode", 0)
    if code & 0xFF in _FROM_OUTSIDE and code not in _UNREADABLE:
        raise StateError(str(error)) from error
    return str(error)


def connect(uri: str) -> sqlite3.Connection:
    """A connection that suspects what it reads; transactions are begun by hand."""
    db = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=1.0)
    db.text_factory = bytes
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_ROW)
    db.execute("PRAGMA trusted_schema = OFF")
    db.execute("PRAGMA cell_size_check = ON")
    return db


def is_new(db: sqlite3.Connection) -> bool:
    """Whether there is nothing in the file yet: its maker may have been killed before there was."""
    return not db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]


# --- rows


def sealed(table: str, body: bytes) -> bytes:
    """A table's row: its content and the seal."""
    return body + hashlib.blake2b(body, digest_size=_SEAL_BYTES, person=table.encode()).digest()


def unsealed(table: str, row: object) -> bytes:
    """The content of what ``sealed`` gave.

    Raises:
        DamageError: it is something else.
    """
    if isinstance(row, bytes) and len(row) >= _SEAL_BYTES and sealed(table, row[:-_SEAL_BYTES]) == row:
        return row[:-_SEAL_BYTES]
    raise DamageError("a row does not match its seal")


def encode_owner(swarm: str, rules: Rules) -> bytes:
    """Whose file it is."""
    model = rules.model
    fields = [swarm, rules.lattice.cell_mm, model.occupied, model.free, model.limit]
    return sealed("swarm", msgpack.packb(fields))


def decode_owner(row: object) -> tuple[str, Rules]:
    """The swarm's name and rules.

    Raises:
        DamageError: the row is damaged.
    """
    swarm, cell_mm, occupied, free, limit = msgpack.unpackb(unsealed("swarm", row))
    return swarm, Rules(Lattice(cell_mm), EvidenceModel(occupied, free, limit))


class Checkpoint(NamedTuple):
    """Which state the tiles of a session make up.

    Attributes:
        session: whose.
        n: its last update.
        root: ``swarm.state.State.root``.
    """

    session: SessionId
    n: int
    root: bytes

    def encode(self) -> bytes:
        """The row."""
        return sealed("checkpoint", _CHECKPOINT.pack(*self))

    @classmethod
    def decode(cls, row: object) -> Checkpoint:
        """What a row says.

        Raises:
            DamageError: it is damaged.
        """
        return cls(*_CHECKPOINT.unpack(unsealed("checkpoint", row)))


class Run(NamedTuple):
    """A robot's run, from its start to its end.

    Attributes:
        run: its name: the id of its first session.
        session: the session that holds what was sensed in it.
        whole: whether that session holds all that those held which it replaced.
    """

    run: SessionId
    session: SessionId
    whole: bool

    def encode(self) -> bytes:
        """The row."""
        return sealed("run", _RUN.pack(*self))

    @classmethod
    def decode(cls, row: object) -> Run:
        """What a row says.

        Raises:
            DamageError: it is damaged.
        """
        return cls(*_RUN.unpack(unsealed("run", row)))


def encode_chunk(run: SessionId, first: int, readings: Readings) -> bytes:
    """Some rows of a run's journal, of which ``first`` is the first."""
    arrays = (readings.stamps_ms.astype("<i8"), readings.poses.astype("<f8"), readings.ranges.astype("<f8"))
    return sealed("journal", _CHUNK.pack(run, first) + b"".join(array.tobytes() for array in arrays))


def decode_chunk(row: object, beams: int) -> tuple[SessionId, int, Readings]:
    """The run, the first row's number, and the rows.

    Raises:
        DamageError: it is damaged, or of a sensor with another number of beams.
    """
    body = unsealed("journal", row)
    run, first = _CHUNK.unpack_from(body)
    count, odd = divmod(len(body) - _CHUNK.size, 8 * (1 + 3 + beams))
    if odd:
        raise DamageError("a chunk of the journal is another sensor's")
    stamps = np.frombuffer(body, "<i8", count, _CHUNK.size)
    numbers = np.frombuffer(body, "<f8", count * (3 + beams), _CHUNK.size + 8 * count)
    poses, ranges = numbers[: 3 * count].reshape(count, 3), numbers[3 * count :].reshape(count, beams)
    return run, first, Readings(stamps.astype(np.int64), poses.astype(np.float64), ranges.astype(np.float64))
