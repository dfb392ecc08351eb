"""Where one team-mate was, by the poses that its sessions published, in order of time.

Laws kept here: a pose belongs to its session and goes with it; whatever changes tells which times it concerns, so that
nobody has to look at all that he ever sensed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.column import Column
from swarm.session import SessionId

WINDOW_MS = 300
"""A team-mate's pose counts for readings that long before and after it: 3 cm of way at 0.1 m/s, like the margin."""

MAX_POSES = 1 << 20
"""Poses kept of one robot, 20 MiB: 29 hours at ten a second. Beyond it the oldest eighth is forgotten."""

MOST_AROUND = 64
"""Poses that count for one reading at most, the newest of the window: 100 a second are all there, and nobody's nonsense
costs more."""

_ENDLESS = np.iinfo(np.int64).max
_STAMP_LIMIT = 1 << 62


class Span(NamedTuple):
    """A stretch of time, milliseconds, both ends included."""

    first_ms: int
    last_ms: int


class Track:
    """One robot's poses.

    Args:
        max_poses: how many are kept.
    """

    def __init__(self, max_poses: int = MAX_POSES) -> None:
        self._most = max_poses
        self._stamps_ms = Column(np.int64)
        self._points = Column(np.int32, (2,))
        self._sessions = Column(np.uint64)

    def __len__(self) -> int:
        return len(self._stamps_ms)

    @property
    def newest(self) -> NDArray[np.int32]:
        """x, y of the newest pose, millimetres; of a track that has one."""
        newest: NDArray[np.int32] = self._points.rows[-1]
        return newest

    def add(self, session: SessionId, stamps_ms: NDArray[np.int64], points: NDArray[np.int32]) -> Span:
        """More poses; late ones find their place.

        Args:
            session: who published them.
            stamps_ms: shape (K,), K at least 1, in any order.
            points: shape (K, 2), x, y in the common frame, millimetres.

        Returns:
            The readings that they may concern.
        """
        stamps_ms = np.clip(stamps_ms, -_STAMP_LIMIT, _STAMP_LIMIT)
        first, last = int(stamps_ms.min()), int(stamps_ms.max())
        span = self._concerned(first, last)
        in_order = not len(self) or first >= self._stamps_ms.rows[-1]
        self._stamps_ms.append(stamps_ms)
        self._points.append(points)
        self._sessions.append(np.full(len(stamps_ms), _number(session)))
        if not (in_order and (np.diff(stamps_ms) >= 0).all()):
            self._keep(np.argsort(self._stamps_ms.rows, kind="stable"))
        if len(self) > self._most:
            self._keep(np.arange(len(self) - self._most + self._most // 8, len(self)))
        return span

    def drop(self, session: SessionId) -> Span | None:
        """Forget what a session said; gives the readings that it concerned, if any."""
        of_it = self._sessions.rows == _number(session)
        if not of_it.any():
            return None
        gone = self._stamps_ms.rows[of_it]
        self._keep(np.flatnonzero(~of_it))
        return self._concerned(int(gone[0]), int(gone[-1]))

    def around(self, stamps_ms: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        """Where it may have been at some times: at its poses within the window; else where it last was before.

        A robot publishes wherever it goes: one that says nothing stands.

        Args:
            stamps_ms: shape (N,).

        Returns:
            Shapes (P,) and (P, 2): which of the N, and x, y of a place, as many as there are.
        """
        known = self._stamps_ms.rows
        first = np.searchsorted(known, stamps_ms - WINDOW_MS, side="left")
        last = np.searchsorted(known, stamps_ms + WINDOW_MS, side="right")
        first = np.where(first == last, np.maximum(first - 1, 0), np.maximum(first, last - MOST_AROUND))
        counts = last - first
        which = np.repeat(np.arange(len(stamps_ms)), counts)
        places = np.arange(len(which)) + np.repeat(first - np.cumsum(counts) + counts, counts)
        return which, self._points.rows[places]

    def _concerned(self, first_ms: int, last_ms: int) -> Span:
        """The readings that poses of that time concern, whether they come or go: up to where the next pose counts."""
        after = int(np.searchsorted(self._stamps_ms.rows, last_ms, side="right"))
        until = int(self._stamps_ms.rows[after]) if after < len(self) else _ENDLESS
        return Span(first_ms - WINDOW_MS, max(last_ms, until) + WINDOW_MS if until < _ENDLESS else _ENDLESS)

    def _keep(self, rows: NDArray[np.intp]) -> None:
        for column in (self._stamps_ms, self._points, self._sessions):
            column.replace(column.rows[rows])


def _number(session: SessionId) -> np.uint64:
    return np.uint64(int.from_bytes(session, "big"))
