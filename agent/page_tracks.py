"""Where each session's robot went and what it hit last, as far as its updates tell: what the page draws over the map.

Laws kept here: what was handed out is never written again; a trail costs what its way costs, not its time, and when it
has become long every other pose of it goes; of the hits only the newest are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.column import Column
from agent.published import published_scans
from mapping.pose import FULL_TURN
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from swarm.messages import Update
from swarm.session import Descriptor, SessionId

STRIDE_MM = 20
"""Way between two poses of a trail, at first: a pixel or two."""

MOST_POSES = 10_000
"""Poses of one trail at most, 120 kB: 200 m at first, then every other goes and they come half as often."""

MOST_HITS = 2000
"""Hits of one session that are shown, the newest."""

_NO_POSES = np.zeros((0, 3), np.int32)
_NO_HITS = np.zeros((0, 2), np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What is known of one session's way.

    Attributes:
        trail: int32, shape (N, 3), x_mm, y_mm, yaw_turn16 in the common frame. It only ever becomes longer, for as
            long as the stride is the same.
        stride_mm: how far its poses are apart.
        pose: the newest pose, shape (3,), or None.
        hits: int32, shape (M, 2), x_mm, y_mm, in the order in which they were sensed.
        hits_in_all: how many there ever were, so that a viewer knows which of them are new.
    """

    trail: NDArray[np.int32]
    stride_mm: int
    pose: NDArray[np.int32] | None
    hits: NDArray[np.int32]
    hits_in_all: int


class Tracks:
    """The tracks of all sessions; told of every update that is applied (``swarm.peer.Listener``)."""

    def __init__(self) -> None:
        self._trails: dict[SessionId, Column] = {}
        self._way_mm: dict[SessionId, float] = {}
        self._tracks: dict[SessionId, Track] = {}

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        scans = published_scans(descriptor, update)
        if scans is None:
            return
        before = self.of(update.session)
        new = hits(scans, descriptor.sensor)
        trail, stride_mm = self._extended(update.session, before, scans.poses)
        self._tracks[update.session] = Track(
            trail=trail,
            stride_mm=stride_mm,
            pose=scans.poses[-1],
            hits=np.concatenate([before.hits, new])[-MOST_HITS:],
            hits_in_all=before.hits_in_all + len(new),
        )

    def copy(self) -> Tracks:
        """The same tracks, which stay when these move on. Shares the arrays."""
        other = Tracks()
        other._trails = {session: Column.of(track.trail) for session, track in self._tracks.items()}
        other._way_mm, other._tracks = self._way_mm.copy(), self._tracks.copy()
        return other

    def of(self, session: SessionId) -> Track:
        """One session's track."""
        return self._tracks.get(session, _NOTHING)

    def keep_only(self, sessions: set[SessionId]) -> None:
        """Forget all others."""
        for session in self._tracks.keys() - sessions:
            del self._trails[session], self._way_mm[session], self._tracks[session]

    def _extended(self, session: SessionId, before: Track, poses: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
        """The trail with the poses at which another stride of way is complete, and the stride."""
        column, last, stride_mm = (
            self._trails.setdefault(session, Column(np.int32, (3,))),
            before.pose,
            before.stride_mm,
        )
        points = (poses if last is None else np.concatenate([last[None], poses]))[:, :2].astype(np.float64)
        way = np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T)) + self._way_mm.get(session, 0.0)
        strides = np.floor(way / stride_mm)
        new = np.diff(strides, prepend=-1.0 if last is None else strides[0]) > 0
        column.append(poses[new if last is None else new[1:]])
        self._way_mm[session] = float(way[-1])
        while len(column) > MOST_POSES:
            column = self._trails[session] = Column.of(column.rows[::2])
            stride_mm *= 2
        trail: NDArray[np.int32] = column.rows.view()
        trail.setflags(write=False)
        return trail, stride_mm


_NOTHING = Track(_NO_POSES, STRIDE_MM, None, _NO_HITS, 0)


def hits(scans: Scans, sensor: Sensor) -> NDArray[np.int32]:
    """Where the beams ended that met something: x_mm, y_mm in the common frame, shape (M, 2); for the eye alone."""
    if scans.beams == 0:
        return _NO_HITS
    beams = np.array([beam[:3] for beam in sensor.beams], np.float64)
    yaw = scans.poses[:, 2:] * (2 * np.pi / FULL_TURN)
    bearing = yaw + beams[:, 2] * (2 * np.pi / FULL_TURN)
    met = (scans.ranges != INVALID) & (scans.ranges != NO_RETURN)
    x = scans.poses[:, :1] + np.cos(yaw) * beams[:, 0] - np.sin(yaw) * beams[:, 1] + np.cos(bearing) * scans.ranges
    y = scans.poses[:, 1:2] + np.sin(yaw) * beams[:, 0] + np.cos(yaw) * beams[:, 1] + np.sin(bearing) * scans.ranges
    points: NDArray[np.int32] = np.rint(np.column_stack([x[met], y[met]])).astype(np.int32)
    return points
