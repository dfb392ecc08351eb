"""Recordings given back to robots: the way in to every format, a log cut into several robots, the body that plays one.

Laws kept here: every scan of a log goes to exactly one robot, as it was recorded; the recording's frame is the robot's
start frame.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from agent import carmen, nano_swarm
from agent.body import BATCH
from agent.errors import UserError
from agent.readings import Readings
from agent.recording import POSES, Recording
from mapping.pose import QuantisedPose


def read(path: Path, *, poses: str | None = None, max_range: float | None = None) -> list[Recording]:
    """The recordings in a file or folder, one a robot.

    Args:
        path: a CARMEN log (plain or gzip) or a nano_swarm folder.
        poses: one of ``POSES``; ``None`` takes the best that the recording has.
        max_range: metres, the sensor's range to map with; ``None`` is the format's default.

    Raises:
        UserError: whatever is wrong with the path, its content, or an argument.
    """
    if poses is not None and poses not in POSES:
        raise UserError("--poses", f"{poses!r} is unknown", f"choose one of {', '.join(POSES)}")
    try:
        exists, is_folder = path.exists(), path.is_dir()
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the path") from error
    if not exists:
        raise UserError(path, "there is no such file or folder", "check the path")
    if is_folder:
        return nano_swarm.read(path, poses=poses, max_range=max_range)
    return [carmen.read(path, poses=poses, max_range=max_range)]


def split(recording: Recording, parts: int) -> list[Recording]:
    """Consecutive pieces of equal path length, as if that many robots had shared the run; poses stay as they are.

    The path is the polyline through the scans' positions; a scan at a cut opens the next piece.

    Raises:
        UserError: a piece would have no scan.
    """
    if not 1 <= parts <= len(recording):
        raise UserError(recording.name, f"{len(recording)} scans cannot become {parts} robots", "choose other --robots")
    if parts == 1:
        return [recording]
    steps = np.diff(recording.poses[:, :2], axis=0)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    cuts = np.searchsorted(path, path[-1] * np.arange(1, parts) / parts)
    bounds = [0, *cuts.tolist(), len(recording)]
    pieces = list(pairwise(bounds))
    for number, (start, stop) in enumerate(pieces, start=1):
        if start == stop:
            raise UserError(
                recording.name,
                f"piece {number} of {parts} of its {path[-1]:.2f} m of path has no scan",
                "choose fewer --robots",
            )
    return [
        Recording(
            f"{recording.name} {number}/{parts}",
            recording.stamps[start:stop] - recording.stamps[start],
            recording.poses[start:stop],
            recording.ranges[start:stop],
            recording.sensor,
        )
        for number, (start, stop) in enumerate(pieces, start=1)
    ]


class RecordedBody:
    """A robot played back from a recording (implements ``Body``).

    Every scan is given once, in the recording's order, when its ``due`` time has passed; its published stamp is that
    time.

    Args:
        recording: what to play; its frame is the start frame.
    """

    patience = 0.02
    status = ""

    def __init__(self, recording: Recording) -> None:
        self.sensor = recording.sensor
        self._recording = recording
        self._due = recording.due
        self._stamps_ms = np.rint(self._due * 1000).astype(np.int64)
        self._next = 0

    def place(self, start: QuantisedPose) -> None:
        """Wherever it lies: nobody drives it."""

    def read(self, until: float) -> Readings:
        """The next scans, at most ``BATCH``, that are due before ``until`` (seconds since the first scan)."""
        due = int(np.searchsorted(self._due, until))
        rows = slice(self._next, max(self._next, min(due, self._next + BATCH)))
        self._next = rows.stop
        return Readings(self._stamps_ms[rows], self._recording.poses[rows], self._recording.ranges[rows])

    @property
    def progress(self) -> tuple[int, int]:
        """Scans given so far, and how many there are."""
        return self._next, len(self._recording)

    @property
    def done(self) -> bool:
        """Whether every scan has been given."""
        return self._next == len(self._recording)

    def close(self) -> None:
        """Nothing moves."""
