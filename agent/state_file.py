"""A peer's memory on disk: one SQLite file, open for writing (``agent.state_format`` says what is in it).

Laws kept here: a transaction is there whole or not at all, whenever the process dies; a damaged file is renamed, never
overwritten.

The file is in WAL mode with ``synchronous=NORMAL``. A process that is killed, at any instruction, loses nothing that
was committed: the kernel has it. A power cut never damages the file, but may take back the last transactions, those of
the seconds since the kernel wrote its pages or SQLite moved the log into the file. What is read then is an older true
state, and others have what is missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from agent.readings import Readings
from agent.state_format import (
    APPLICATION,
    FORMAT,
    PAGE_BYTES,
    SCHEMA,
    SQLITE_ERRORS,
    Checkpoint,
    DamageError,
    Run,
    connect,
    encode_chunk,
    encode_owner,
    is_new,
    judged,
    sealed,
)
from swarm.messages import Control, Update, encode
from swarm.session import Descriptor, Rules, SessionId
from swarm.state import State
from swarm.tile_block import encode_tile


class StateFile:
    """The file, open for writing. Use its verbs within ``transaction``.

    Args:
        path: where it is; it is made if there is none.
        swarm: the swarm's name.
        rules: the swarm's.

    Raises:
        StateError: it cannot be opened or made.
        DamageError: it is damaged.
    """

    def __init__(self, path: Path, swarm: str, rules: Rules) -> None:
        with _errors():
            self._db = connect(f"{path.absolute().as_uri()}?mode=rwc")
            try:
                self._db.execute(f"PRAGMA page_size = {PAGE_BYTES}")
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.execute("PRAGMA synchronous = NORMAL")
                if is_new(self._db):
                    self._make(swarm, rules)
            except BaseException:
                self._db.close()
                raise

    def _make(self, swarm: str, rules: Rules) -> None:
        with self.transaction():
            for statement in SCHEMA:
                self._db.execute(statement)
            self._db.execute(f"PRAGMA application_id = {APPLICATION}")
            self._db.execute(f"PRAGMA user_version = {FORMAT}")
            self._db.execute("INSERT INTO swarm VALUES (?)", (encode_owner(swarm, rules),))

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """All that is written within is there at the end, or nothing of it.

        Raises:
            StateError: it could not be written, for reasons outside the file; what is there is as it was.
            DamageError: the file is damaged.
        """
        with _errors():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    # --- sessions

    def put_descriptor(self, descriptor: Descriptor) -> None:
        """Know a session."""
        row = sealed("session", descriptor.encode())
        self._db.execute("INSERT OR REPLACE INTO session VALUES (?, ?)", (descriptor.session, row))

    def put_checkpoint(self, session: SessionId, checkpoint: State, since: int | None) -> None:
        """Keep a session's checkpoint instead of the one before, and no updates.

        Args:
            session: whose.
            checkpoint: the state.
            since: the n of the one before, from which updates led here; None if there is none that counts.
        """
        if since is None:
            self.forget(session)
        row = Checkpoint(session, checkpoint.n, checkpoint.root()).encode()
        changed = {key: mark for key, mark in checkpoint.marks.items() if mark.version > (since or 0)}
        self._db.execute("INSERT OR REPLACE INTO checkpoint VALUES (?, ?)", (session, row))
        self._db.executemany(
            "INSERT OR REPLACE INTO tile VALUES (?, ?, ?, ?, ?)",
            ((session, *key, mark.version, encode_tile(key, checkpoint.cells[key])) for key, mark in changed.items()),
        )
        self._db.execute("DELETE FROM log WHERE session = ?", (session,))

    def put_updates(self, updates: Iterable[Update]) -> None:
        """Keep updates that follow what is kept."""
        rows = ((update.session, update.n, sealed("log", encode(update))) for update in updates)
        self._db.executemany("INSERT OR REPLACE INTO log VALUES (?, ?, ?)", rows)

    def forget(self, session: SessionId) -> None:
        """Keep no more of a session than its descriptor."""
        self._db.execute("DELETE FROM checkpoint WHERE session = ?", (session,))
        self._db.execute("DELETE FROM tile WHERE session = ?", (session,))
        self._db.execute("DELETE FROM log WHERE session = ?", (session,))

    # --- decisions

    def put_control(self, control: Control) -> None:
        """Keep an operator's decision instead of the one before about that subject."""
        row = (control.setting, control.subject, sealed("control", encode(control)))
        self._db.execute("INSERT OR REPLACE INTO control VALUES (?, ?, ?)", row)

    # --- what a robot sensed

    def put_run(self, run: Run) -> None:
        """Know a run of this robot, and which session holds it now."""
        self._db.execute("INSERT OR REPLACE INTO run VALUES (?, ?)", (run.run, run.encode()))

    def put_readings(self, run: SessionId, first: int, readings: Readings) -> None:
        """Keep the next rows of a run's journal, of which ``first`` is the first."""
        row = (run, first, encode_chunk(run, first, readings))
        self._db.execute("INSERT OR REPLACE INTO journal VALUES (?, ?, ?)", row)

    def close(self) -> None:
        """Let go of the file."""
        self._db.close()


@contextmanager
def _errors() -> Iterator[None]:
    """SQLite's errors as ours."""
    try:
        yield
    except SQLITE_ERRORS as error:
        raise DamageError(judged(error)) from error


def set_aside(path: Path) -> Path:
    """Rename a damaged file, and the log beside it, to a name that is free; gives the new name.

    Raises:
        OSError: it cannot be renamed.
    """
    k = 1
    while (aside := path.with_name(f"{path.name}.damaged-{k}")).exists():
        k += 1
    for suffix in ("-wal", ""):  # the log first: a file without its log is an older one, a log without its file nothing
        part = path.with_name(path.name + suffix)
        if part.exists() and (not suffix or part.stat().st_size):
            part.rename(aside.with_name(aside.name + suffix))
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    return aside
