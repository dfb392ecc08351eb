"""Reading a state file: everything in it that proves true, and what was wrong with the rest, in words.

Laws kept here: reading changes nothing; whatever the bytes are, what is read is a true past state of each session or is
left out, and nothing is raised but that the file is not ours or cannot be read at all.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.journal import Journal
from agent.readings import Readings
from agent.state_format import (
    APPLICATION,
    FORMAT,
    SQLITE_ERRORS,
    Checkpoint,
    DamageError,
    ForeignError,
    Run,
    connect,
    decode_chunk,
    decode_owner,
    is_new,
    judged,
    unsealed,
)
from mapping.lattice import Cells, TileKey
from mapping.sensor import Sensor
from swarm.drops import Drop
from swarm.messages import Control, Mark, Update, decode
from swarm.session import Descriptor, Rules, SessionId, difference
from swarm.state import State, tile_hash
from swarm.tile_block import decode_tiles

_DAMAGE = (DamageError, Drop, *SQLITE_ERRORS)


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A session as it was kept.

    Attributes:
        descriptor: the session's.
        checkpoint: a true state of it; the empty one, if no more than the descriptor was kept.
        updates: those that follow the checkpoint, in order.
    """

    descriptor: Descriptor
    checkpoint: State
    updates: list[Update]


@dataclass(slots=True)
class Contents:
    """What a file holds, as far as it proved true.

    Attributes:
        sessions: each with a whole checkpoint, and as far as its updates are whole.
        controls: operators' decisions.
        runs: a robot's own, whose journals lie in the file.
        damage: what was left out, in words.
    """

    sessions: list[Kept] = field(default_factory=list)
    controls: list[Control] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)


def read(path: Path, swarm: str, rules: Rules) -> Contents:
    """Everything in a file that proves true but the journals; nothing, if there is no file.

    Args:
        path: the file.
        swarm: the swarm's name.
        rules: the swarm's.

    Raises:
        ForeignError: it is another program's, format's or swarm's.
        StateError: it cannot be read, and nobody can say whether anything is wrong with it.
    """
    contents = Contents()
    if not path.exists():
        return contents
    if not path.is_file():
        raise ForeignError("is no file")
    try:
        with closing(_open(path)) as db:
            if not is_new(db):
                _check_owner(db, swarm, rules)
                _read(db, contents)
    except _DAMAGE as error:
        if getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_NOTADB:
            raise ForeignError("is no state file") from error
        contents.damage.append(judged(error))
    return contents


def read_journal(path: Path, run: SessionId, sensor: Sensor) -> Readings:
    """All that was sensed in a run.

    Raises:
        DamageError: something of it is not what was written.
        StateError: it cannot be read.
        JournalFullError: it is too long.
    """
    journal = Journal(sensor)
    try:
        with closing(_open(path)) as db:
            for first, body in db.execute("SELECT first, body FROM journal WHERE run = ? ORDER BY first", (run,)):
                *place, readings = decode_chunk(body, len(sensor.beams))
                if place != [run, len(journal)] or first != len(journal):
                    raise DamageError("rows of the journal are missing")
                journal.append(readings)
    except SQLITE_ERRORS as error:
        raise DamageError(judged(error)) from error
    return journal[:]


def _open(path: Path) -> sqlite3.Connection:
    """A connection that writes nothing: not even what a killed process left in the log beside the file.

    On a medium that is read-only that log cannot be looked at; then the file is read as it is without it.
    """
    uri = path.absolute().as_uri()
    db = connect(f"{uri}?mode=ro")
    try:
        is_new(db)
    except SQLITE_ERRORS:
        if os.access(path.parent, os.W_OK):
            return db  # whoever reads finds out why
        db.close()
        db = connect(f"{uri}?immutable=1")
    return db


def _check_owner(db: sqlite3.Connection, swarm: str, rules: Rules) -> None:
    if db.execute("PRAGMA application_id").fetchone()[0] != APPLICATION:
        raise ForeignError("is another program's database")
    version = db.execute("PRAGMA user_version").fetchone()[0]
    if version != FORMAT:
        raise ForeignError(f"has format {version}, this program knows format {FORMAT}")
    row = db.execute("SELECT body FROM swarm").fetchone()
    owner, owners = decode_owner(row and row[0])
    if owner != swarm:
        raise ForeignError(f"belongs to swarm {owner!r}, ours is {swarm!r}")
    other = difference(rules, owners)
    if other is not None:
        raise ForeignError(f"holds a map with {other}")


def _read(db: sqlite3.Connection, contents: Contents) -> None:
    for session, body in _rows(db, "session", contents):
        _read_session(db, session, body, contents)
    for setting, subject, body in _rows(db, "control", contents):
        try:
            control = decode(unsealed("control", body))
            if not isinstance(control, Control) or (control.setting, control.subject) != (setting, subject):
                raise DamageError("it lies in the wrong place")
            contents.controls.append(control)
        except _DAMAGE as error:
            contents.damage.append(f"a control record is left out: {judged(error)}")
    for run, body in _rows(db, "run", contents):
        try:
            decoded = Run.decode(body)
            if decoded.run != run:
                raise DamageError("it lies in the wrong place")
            contents.runs.append(decoded)
        except _DAMAGE as error:
            contents.damage.append(f"a run is left out: {judged(error)}")
    for (complaint,) in db.execute("PRAGMA quick_check(1)"):
        if complaint != b"ok":
            contents.damage.append(complaint.decode(errors="replace"))


def _rows(db: sqlite3.Connection, table: str, contents: Contents) -> Iterator[tuple[Any, ...]]:
    """A table's rows, as far as they can be read."""
    try:
        yield from db.execute(f"SELECT * FROM {table}").fetchall()  # noqa: S608 - our own names
    except _DAMAGE as error:
        contents.damage.append(f"the table of each {table} cannot be read: {judged(error)}")


def _read_session(db: sqlite3.Connection, session: object, body: object, contents: Contents) -> None:
    """Add a session if its checkpoint proves true, and as many of its updates as do."""
    try:
        descriptor = Descriptor.decode(unsealed("session", body))
        if descriptor.session != session:
            raise DamageError("it lies in the wrong place")
        checkpoint = _read_checkpoint(db, descriptor.session)
    except _DAMAGE as error:
        name = session.hex() if isinstance(session, bytes) else "without a name"
        contents.damage.append(f"session {name} is left out: {judged(error)}")
        return
    updates: list[Update] = []
    try:
        for update in _read_log(db, descriptor.session, checkpoint.n):
            updates.append(update)  # noqa: PERF402 - those before an error are kept
    except _DAMAGE as error:
        n = checkpoint.n + len(updates)
        contents.damage.append(f"session {descriptor.session.hex()} ends at update {n}: {judged(error)}")
    contents.sessions.append(Kept(descriptor, checkpoint, updates))


def _read_checkpoint(db: sqlite3.Connection, session: SessionId) -> State:
    """The checkpoint, proved; the empty state, if there is none."""
    row = db.execute("SELECT body FROM checkpoint WHERE session = ?", (session,)).fetchone()
    if row is None:
        return State()
    whose, n, root = Checkpoint.decode(row[0])
    if whose != session:
        raise DamageError("a checkpoint lies in the wrong place")
    cells: dict[TileKey, Cells] = {}
    marks: dict[TileKey, Mark] = {}
    for ty, tx, version, body in db.execute("SELECT ty, tx, version, body FROM tile WHERE session = ?", (session,)):
        if not (isinstance(body, bytes) and isinstance(version, int) and 0 < version <= n):
            raise DamageError("a tile is none")
        tile = decode_tiles(body)
        if tile.keys() != {(ty, tx)}:
            raise DamageError("a tile lies in the wrong place")
        cells |= tile
        marks |= {key: Mark(version, tile_hash(key, content)) for key, content in tile.items()}
    return State.verified(n, marks, cells, root)


def _read_log(db: sqlite3.Connection, session: SessionId, n: int) -> Iterator[Update]:
    for number, body in db.execute("SELECT n, body FROM log WHERE session = ? AND n > ? ORDER BY n", (session, n)):
        update = decode(unsealed("log", body))
        if not isinstance(update, Update) or (update.session, update.n) != (session, number):
            raise DamageError("an update lies in the wrong place")
        if update.n != n + 1:
            raise DamageError("an update is missing")
        yield update
        n = update.n
