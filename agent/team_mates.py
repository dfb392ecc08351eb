"""Team-mates are not walls: readings that fall on one say nothing, in time or, where its pose came late, afterwards.

Laws kept here: what a robot saw of a team-mate follows from its own scans and the poses that the team-mate's sessions
published, by swarm time, and from nothing else; so whoever hears of a pose late, or of a corrected one, comes to the
same map as who knew it in time. A robot whose session was evicted is still a body in the way.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from agent.driver import ROBOT_RADIUS
from agent.published import published_scans
from agent.tracks import Span, Track
from mapping.pose import FULL_TURN
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from swarm.drops import Drop
from swarm.messages import Update
from swarm.session import Descriptor, SessionId

MARGIN = 0.03
"""Metres around a team-mate's body that a reading may fall on: what two robots' odometry and a reading are wrong by."""

_FOOTPRINT_MM = (ROBOT_RADIUS + MARGIN) * 1000

Points = NDArray[np.float64]
Masks = NDArray[np.bool_]
"""Shape (N, B): which readings of N scans say nothing because they fell on a team-mate."""


class NoMates:
    """What a recorded robot knows of the others: nothing that it would have to take out of its scans."""

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Not heard."""

    def replaced(self, session: SessionId) -> None:
        """Not known."""

    def news(self) -> list[Span]:
        """None."""
        return []

    def masks(self, scans: Scans) -> Masks:
        """Nothing fell on anybody."""
        return np.zeros(scans.ranges.shape, np.bool_)


class TeamMates:
    """What a robot knows of the others' whereabouts.

    Args:
        robot: its own id; its own sessions are none of its team-mates'.
        sensor: its own.

    Attributes:
        counters: ``bad_poses``, updates whose poses could not be read.
    """

    def __init__(self, robot: str, sensor: Sensor) -> None:
        self.counters: Counter[str] = Counter()
        self._robot = robot
        self._sensor = sensor
        self._tracks: dict[str, Track] = {}
        self._replaced: set[SessionId] = set()
        self._news: list[Span] = []

    # --- hearing of others

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take the poses out of an update that was applied (``swarm.peer.Listener``)."""
        if descriptor.robot == self._robot or descriptor.start is None or descriptor.session in self._replaced:
            return
        try:
            poses = _poses(descriptor, update)
        except Drop:
            self.counters["bad_poses"] += 1
            return
        if len(poses):
            track = self._tracks.setdefault(descriptor.robot, Track())
            self._news.append(track.add(descriptor.session, poses.stamps_ms, poses.poses[:, :2]))

    def replaced(self, session: SessionId) -> None:
        """Another session of the same robot tells the same anew, from a corrected start pose: this one was wrong."""
        if session in self._replaced:
            return
        self._replaced.add(session)
        spans = [track.drop(session) for track in self._tracks.values()]
        self._news += [span for span in spans if span is not None]

    def news(self) -> list[Span]:
        """The times of readings that what was heard since the last question may concern."""
        news, self._news = self._news, []
        return news

    def positions(self) -> Points:
        """Where each team-mate was last heard of, shape (K, 2), metres in the common frame."""
        return np.array([track.newest for track in self._tracks.values() if len(track)]).reshape(-1, 2) / 1000

    # --- own scans

    def masks(self, scans: Scans) -> Masks:
        """Which readings of own scans fall on a team-mate, by what is known now."""
        masks = np.zeros(scans.ranges.shape, np.bool_)
        reach = self._sensor.max_range_mm + np.abs(self._sensor.table[:, :2]).max() * 2 + _FOOTPRINT_MM
        for track in self._tracks.values():
            which, places = track.around(scans.stamps_ms)
            points = places.astype(np.float64)
            near = (np.abs(points - scans.poses[which, :2]) <= reach).all(axis=1)
            which, points = which[near], points[near]
            pair, beam = np.nonzero(falls_on(scans.poses[which], scans.ranges[which], self._sensor, points))
            masks[which[pair], beam] = True
        return masks


def without(scans: Scans, masks: Masks) -> Scans:
    """The scans with the masked readings invalid: as they are published."""
    return Scans(scans.stamps_ms, scans.poses, np.where(masks, np.uint16(INVALID), scans.ranges))


def falls_on(
    poses: NDArray[np.int32], ranges: NDArray[np.uint16], sensor: Sensor, points_mm: Points
) -> NDArray[np.bool_]:
    """Which readings of scans fall on a robot whose centre is at a point, shape (P, B): scan by scan, each its point.

    A wide beam's reading may have come from anywhere on its arc: the nearest place counts.

    Args:
        poses: shape (P, 3), x_mm, y_mm, yaw_turn16 of each scan.
        ranges: shape (P, B), millimetres, ``INVALID`` or ``NO_RETURN``.
        sensor: whose readings they are.
        points_mm: shape (P, 2), x, y in the common frame, millimetres.
    """
    x_mm, y_mm, bearing, half_width = sensor.table.T
    to_radians = 2 * np.pi / FULL_TURN
    x, y, yaw = poses.astype(np.float64).T[:, :, None]
    c, s = np.cos(yaw * to_radians), np.sin(yaw * to_radians)
    dx = points_mm[:, :1] - (x + x_mm * c - y_mm * s)
    dy = points_mm[:, 1:] - (y + x_mm * s + y_mm * c)
    aside = np.arctan2(dy, dx) - (yaw + bearing) * to_radians
    off_beam = np.maximum(np.abs((aside + np.pi) % (2 * np.pi) - np.pi) - half_width * to_radians, 0.0)
    away = np.hypot(dx, dy)
    reach = ranges.astype(np.float64)
    squared = reach**2 + away**2 - 2 * reach * away * np.cos(off_beam)  # the law of cosines
    returned = (ranges != INVALID) & (ranges != NO_RETURN)
    return np.asarray(returned & (squared <= _FOOTPRINT_MM**2))


def _poses(descriptor: Descriptor, update: Update) -> Scans:
    """Stamps and poses that an update carries, whatever its form."""
    scans = published_scans(descriptor, update)
    return Scans.empty(0) if scans is None else scans
