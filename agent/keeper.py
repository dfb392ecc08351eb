"""What a peer keeps on disk, and when.

Laws kept here: what a robot adds to its own session, and what it sensed for it, is kept before it is published, and
so are operators' decisions; others' sessions, which others hold too, once a second, to spare the card; nothing is
written when there is no news. Nothing that was kept decides what a new session is called. Trouble with the file never
stops the swarm: the peer says what is wrong, goes on in memory, and tries again where that may help. A damaged file is
set aside, never written to, and what of it proved true begins a new one.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agent.config import Config
from agent.errors import UserError
from agent.journal import JournalFullError, Past
from agent.lock_file import LockFile
from agent.own_session import OwnSession
from agent.readings import FARTHEST_START_MM
from agent.state_file import StateFile, set_aside
from agent.state_format import DamageError, ForeignError, Run, StateError
from agent.state_reader import Contents, read, read_journal
from mapping.pose import QuantisedPose
from swarm.drops import Drop
from swarm.messages import Control
from swarm.peer import Peer
from swarm.replica import Replica
from swarm.session import Rules, SessionId
from swarm.state import State

_PERIOD = 1.0
"""Seconds between looks at others' sessions."""

_RETRY = 10.0
"""Seconds after which a file is tried again that could not be written."""

_CHUNK_BYTES = 1 << 20
"""The most of a journal that goes into one row."""


class NoKeeper:
    """The keeper of a peer that remembers nothing."""

    status = ""

    def restore(self, peer: Peer, now: float) -> None:
        """There is nothing."""

    def past(self, peer: Peer, run: SessionId) -> Past | None:
        """Nothing is known of earlier runs."""
        return None

    def keep(self, peer: Peer, sessions: Sequence[OwnSession], now: float) -> None:
        """Nothing is kept."""

    def keep_all(self, peer: Peer, sessions: Sequence[OwnSession]) -> None:
        """Nothing is kept."""

    def summary(self) -> dict[str, Any]:
        """Nothing to tell."""
        return {}


class _Stored(NamedTuple):
    """How much of a session is in the file.

    Attributes:
        checkpoint: the copy's own, which moves on while updates follow each other, and is another one after a jump.
        at: the checkpoint of which all tiles are there.
        n: the last update there.
    """

    checkpoint: State
    at: int
    n: int

    @classmethod
    def of(cls, replica: Replica) -> _Stored:
        """All of a session."""
        return cls(replica.checkpoint, replica.checkpoint.n, replica.state.n)


class _Index:
    """What is in the file, so that only news is written."""

    def __init__(self) -> None:
        self.known: set[SessionId] = set()
        self.sessions: dict[SessionId, _Stored] = {}
        self.controls: set[Control] = set()
        self.controls_check: int | None = None  # when they were last written
        self.runs: dict[SessionId, Run] = {}
        self.rows: dict[SessionId, int] = {}  # of each run's journal

    def lacks(self, replica: Replica) -> bool:
        """Whether there is news of a session."""
        stored = self.sessions.get(replica.descriptor.session)
        return stored is None or stored.checkpoint is not replica.checkpoint or stored.n != replica.state.n


class Keeper:
    """A peer's file in the folder of ``--state``, for this process alone until ``close``.

    Args:
        folder: where the file lies; made if it is not there.
        name: the robot's id, or ``observer``.
        swarm: the swarm's name.
        rules: the swarm's.

    Attributes:
        path: the file.
        status: what is wrong with the file, in words; empty if nothing is.

    Raises:
        UserError: the folder cannot be made, or another process has the file.
    """

    def __init__(self, folder: Path, name: str, swarm: str, rules: Rules) -> None:
        try:
            folder = folder.absolute()
            folder.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            what = (isinstance(error, OSError) and error.strerror) or str(error)
            raise UserError(folder, f"is no folder to keep the state in: {what}", "choose another --state") from None
        self.path = folder / f"{name}.sqlite"
        self.status = ""
        self._lock = LockFile(folder / f"{name}.lock")
        self._swarm, self._rules = swarm, rules
        self._file: StateFile | None = None
        self._index = _Index()
        self._restored = {"sessions": 0, "updates": 0}
        self._set_aside: list[str] = []
        self._look_at = -math.inf
        self._retry_at = -math.inf
        self._usable = True
        self._judged: int | None = None  # the controls by which the earlier runs were last looked at

    # --- coming back

    def restore(self, peer: Peer, now: float) -> None:
        """Give a new peer what was kept, as far as it proves true."""
        try:
            contents = read(self.path, self._swarm, self._rules)
        except StateError as error:
            self._usable = False
            what = str(error) if isinstance(error, ForeignError) else f"cannot be read: {error}"
            self.status = f"{self.path}: {what}; the map is kept in memory only: move it away, or give another --state"
            return
        self._restore_sessions(peer, contents, now)
        for control in contents.controls:
            try:
                peer.restore_control(control, now)
                self._index.controls.add(control)
            except Drop as drop:
                contents.damage.append(f"a control record is left out: {drop}")
        self._index.runs = {run.run: run for run in contents.runs}
        if contents.damage:
            self._begin_anew(contents.damage)
        self.keep(peer, [], now)

    def _restore_sessions(self, peer: Peer, contents: Contents, now: float) -> None:
        """Sessions that others replace come before those."""
        waiting = contents.sessions
        while ready := [
            kept for kept in waiting if kept.descriptor.replaces is None or kept.descriptor.replaces in peer.descriptors
        ]:
            for kept in ready:
                session, at = kept.descriptor.session, kept.checkpoint.n
                try:
                    peer.restore(kept.descriptor, kept.checkpoint, kept.updates, now)
                except Drop as drop:
                    contents.damage.append(f"session {session.hex()}: {drop}")
                self._index.known.add(session)
                if (replica := peer.replicas.get(session)) is not None:
                    self._index.sessions[session] = _Stored(replica.checkpoint, at, replica.state.n)
            waiting = [kept for kept in waiting if kept not in ready]
        contents.damage += [
            f"session {kept.descriptor.session.hex()} is left out: it replaces one that is not there"
            for kept in waiting
        ]
        self._restored["sessions"] = len(peer.replicas)
        self._restored["updates"] = sum(replica.state.n for replica in peer.replicas.values())

    def past(self, peer: Peer, run: SessionId) -> Past | None:
        """An earlier run of this robot that is to be published anew, or None.

        Its start pose has been corrected since, or the robot died while it published it anew.

        Args:
            peer: with the controls in force.
            run: the name of the present run.
        """
        if self._judged == peer.controls.check:
            return None
        for earlier in self._index.runs.values():
            head = peer.replicas.get(earlier.session)
            if earlier.run == run or head is None:  # it is somebody else's now
                continue
            descriptor = head.descriptor
            start = _start_of(peer, earlier)
            if earlier.whole and start == descriptor.start:
                continue
            try:
                readings = read_journal(self.path, earlier.run, descriptor.sensor)
            except (DamageError, StateError, JournalFullError) as error:
                self.status = f"{self.path}: session {descriptor.session.hex()} stays as it is: {error}"
                continue
            if len(readings):
                self._index.rows[earlier.run] = len(readings)
                return Past(earlier.run, descriptor.session, start, descriptor.sensor, readings)
        self._judged = peer.controls.check
        return None

    # --- keeping

    def keep(self, peer: Peer, sessions: Sequence[OwnSession], now: float) -> None:
        """Write what is due: all news of the session that we write, all decisions, and once in a while all else.

        Args:
            peer: what it knows is kept.
            sessions: those that this robot writes.
            now: seconds.
        """
        if not self._usable or now < self._retry_at:
            return
        everything = now >= self._look_at
        written = peer.writer is not None and self._index.lacks(peer.writer.replica)
        if not (everything or written or self._index.controls_check != peer.controls.check):
            return
        try:
            if self._file is None:
                self._file = StateFile(self.path, self._swarm, self._rules)
            self._write(self._file, peer, sessions, everything=everything)
        except StateError as error:
            self._retry_at = now + _RETRY
            remedy = "the map is kept in memory only; free this place or make it writable, it is tried again"
            self.status = f"{self.path}: cannot be written: {error}; {remedy}"
        except DamageError as error:
            self._begin_anew([str(error)])
            self._retry_at = now + _RETRY
        else:
            if everything:
                self._look_at = now + _PERIOD
            if self._retry_at > -math.inf:
                self._retry_at, self.status = -math.inf, f"{self.path}: is written again"

    def keep_all(self, peer: Peer, sessions: Sequence[OwnSession]) -> None:
        """Write all news, for the process ends."""
        self._look_at = self._retry_at = -math.inf
        self.keep(peer, sessions, 0.0)

    def _write(self, file: StateFile, peer: Peer, sessions: Sequence[OwnSession], *, everything: bool) -> None:
        """Write in one transaction what the index lacks; the index follows when it is done."""
        index = self._index
        replicas = [*peer.replicas.values()] if everything else [peer.writer.replica] if peer.writer else []
        news = [replica for replica in replicas if index.lacks(replica)]
        controls = set(peer.controls) - index.controls if index.controls_check != peer.controls.check else set()
        if everything:
            known = peer.descriptors.keys() - peer.refused.keys() - index.known
            gone = index.sessions.keys() - peer.replicas.keys()
        else:
            known = {replica.descriptor.session for replica in news} - index.known
            gone = set()
        runs = {own.run: Run(own.run, own.descriptor.session, own.whole) for own in sessions}
        runs = {name: run for name, run in runs.items() if index.runs.get(name) != run}
        rows = {own.run: len(own.journal) for own in sessions if len(own.journal) > self._rows_of(own)}
        if not (news or known or controls or gone or runs or rows):
            index.controls_check = peer.controls.check
            return
        with file.transaction():
            for session in known:
                file.put_descriptor(peer.descriptors[session])
            for replica in news:
                self._put(file, replica)
            for session in gone:
                file.forget(session)
            for control in controls:
                file.put_control(control)
            for run in runs.values():
                file.put_run(run)
            for own in sessions:
                self._put_readings(file, own)
        index.known |= known
        index.sessions |= {each.descriptor.session: _Stored.of(each) for each in news}
        for session in gone:
            del index.sessions[session]
        if controls:
            index.controls = set(peer.controls)
        index.controls_check = peer.controls.check
        index.runs |= runs
        index.rows |= rows

    def _put(self, file: StateFile, replica: Replica) -> None:
        session = replica.descriptor.session
        stored = self._index.sessions.get(session)
        same = stored is not None and stored.checkpoint is replica.checkpoint
        if stored is not None and same and stored.at == replica.checkpoint.n:
            file.put_updates(replica.updates_after(stored.n))
        else:
            file.put_checkpoint(session, replica.checkpoint, stored.at if stored is not None and same else None)
            file.put_updates(replica.updates_after(replica.checkpoint.n))

    def _put_readings(self, file: StateFile, own: OwnSession) -> None:
        step = max(1, _CHUNK_BYTES // (8 * (4 + len(own.journal.sensor.beams))))
        for first in range(self._rows_of(own), len(own.journal), step):
            file.put_readings(own.run, first, own.journal[first : first + step])

    def _rows_of(self, own: OwnSession) -> int:
        """How many rows of a session's journal are in the file."""
        return self._index.rows.get(own.run, 0)

    # --- trouble

    def _begin_anew(self, damage: list[str]) -> None:
        """Set the damaged file aside; what we hold is written into a new one.

        No journals of earlier runs: nobody knows whether their ends are there.
        """
        self._index = _Index()
        self._look_at = -math.inf
        if self._file is not None:
            self._file.close()
            self._file = None
        more = f" and {len(damage) - 1} more" if len(damage) > 1 else ""
        what = f"{self.path}: is damaged ({damage[0]}{more})"
        try:
            aside = set_aside(self.path)
        except OSError as error:
            self._usable = False
            self.status = f"{what} and cannot be set aside: {error.strerror}; the map is kept in memory only"
        else:
            self._set_aside.append(str(aside))
            self.status = f"{what}: set aside as {aside.name}; a new one holds what proved true"

    # --- the end

    def summary(self) -> dict[str, Any]:
        """Where the file is, how large, and what came of it."""
        size = 0
        for suffix in ("", "-wal"):
            with contextlib.suppress(OSError):
                size += self.path.with_name(self.path.name + suffix).stat().st_size
        facts = {"restored": self._restored, "set_aside": self._set_aside, "status": self.status}
        return {"state": {"path": str(self.path), "bytes": size, **facts}}

    def close(self) -> None:
        """Let go of the file, as a crash would: nothing more is written."""
        if self._file is not None:
            self._file.close()
            self._file = None
        self._lock.close()


def _start_of(peer: Peer, run: Run) -> QuantisedPose | None:
    """Where a run started, as it is known now: a control record that was made about it is stronger."""
    descriptor = peer.descriptors[run.session]
    record = peer.controls.start_pose(descriptor.robot)
    if record is None or record.session is None or max(map(abs, record.pose[:2])) > FARTHEST_START_MM:
        return descriptor.start
    session: SessionId | None = run.session
    while session is not None and session != record.session:
        known = peer.descriptors.get(session)
        session = known.replaces if known is not None else None
    return descriptor.start if session is None else record.pose


@contextlib.contextmanager
def open_keeper(config: Config, name: str, folder: Path | None) -> Iterator[Keeper | NoKeeper]:
    """The keeper of a peer, for as long as it is used.

    Args:
        config: the swarm.
        name: the robot's id, or ``observer``.
        folder: what ``--state`` said; None keeps nothing.

    Raises:
        UserError: as ``Keeper``.
    """
    if folder is None:
        yield NoKeeper()
        return
    with contextlib.closing(Keeper(folder, name, config.swarm, config.rules())) as keeper:
        yield keeper
