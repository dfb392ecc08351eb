"""A driver that explores: it looks around, drives to the nearest frontier of the fused map, looks around, and so on.

Laws kept here: nothing is planned but on the map that all robots share; each place is looked at once from near by, so
that exploring ends; what stands in the way and is not on the map is taken into account all the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from agent.driver import ARRIVED, STILL, Blockage, Limits, Motion, held_back, steer
from agent.frontier import (
    COARSE,
    VIEW,
    Mask,
    Terrain,
    frontiers,
    passable,
    straightened,
    terrain_of,
    viewpoints,
    way_to_nearest,
)
from agent.heading import wrapped
from mapping.lattice import Lattice
from mapping.pose import FULL_TURN, Pose
from mapping.sensor import Sensor
from mapping.tiles import Tiles

Points = NDArray[np.float64]

REPLAN = 1.0
"""Seconds after which the way is looked over again."""

LOOK_RATE = 0.5
"""Radians a second while looking around: ten scans a second then lie 4 cm apart at 0.8 m, a coarse cell."""

LOOKED_AT = VIEW + COARSE
"""Metres around a place from which the robot has looked; what is still unknown there cannot be seen."""

_AROUND = 0.3
"""Metres around a robot in which something is free, once its own scans are in the map."""

WAITS = 30.0
"""Seconds that a robot waits for whoever stands in its way before it takes what is behind for unreachable."""

_MOST_BLOCKS = 5
"""How often something may stop a robot on its way to one place that the map shows to be free."""

_NOBODY: Points = np.zeros((0, 2))


class Explorer:
    """Drives to the nearest frontier until there is none.

    Args:
        tiles: gives the fused map as it is now.
        lattice: its cell size.
        mates: gives the team-mates' last known positions, shape (K, 2), metres in the common frame.
        limits: how the robot may move.
        look: radians to turn by until every direction has been seen (``blind_angle``).
    """

    def __init__(
        self,
        tiles: Callable[[], Tiles],
        lattice: Lattice,
        mates: Callable[[], Points] = lambda: _NOBODY,
        limits: Limits | None = None,
        *,
        look: float = math.tau,
    ) -> None:
        self._tiles = tiles
        self._lattice = lattice
        self._mates = mates
        self._limits = limits or Limits()
        self._look = look
        self._left_to_look = look  # radians; it begins by looking around
        self._last_yaw: float | None = None
        self._corners: list[tuple[float, float]] = []
        self._looked_at: list[tuple[float, float]] = []
        self._planned_at = -math.inf
        self._waits_since: float | None = None
        self._blockage = Blockage()
        self._blocks = 0
        self._sees_nothing = False
        self._done = False

    @property
    def done(self) -> bool:
        """Whether no frontier is left that can be reached."""
        return self._done

    @property
    def status(self) -> str:
        """What keeps it from driving."""
        if self._sees_nothing:
            return "has seen nothing free around it"
        return "waits for its way to become free" if self._waits_since is not None else ""

    def drive(self, stamp: float, T_common_robot: Pose, points_robot: Points) -> Motion:
        """Look around, or go on towards the nearest frontier; see ``Driver``."""
        if self._done:
            return STILL
        if self._left_to_look > 0:
            return self._turn(T_common_robot)
        if self._arrived(T_common_robot):
            self._look_from(T_common_robot)
            return STILL
        if stamp - self._planned_at >= REPLAN:
            self._plan(stamp, T_common_robot, _NOBODY)
        if not self._corners:
            return STILL
        wanted = steer(T_common_robot, *self._corners[0], self._limits)
        motion = held_back(wanted, points_robot, self._limits)
        if self._blockage.lasts(stamp, wanted, motion):
            self._count_blockage()
            self._plan(stamp, T_common_robot, T_common_robot.apply(points_robot))
        return motion

    def placed(self, T_after_before: Pose) -> None:
        """Where it has looked it has looked; the way there is planned anew; see ``Driver``."""
        looked_at = T_after_before.apply(np.array(self._looked_at).reshape(-1, 2))
        self._looked_at = [(x, y) for x, y in looked_at.tolist()]
        self._corners, self._planned_at, self._last_yaw = [], -math.inf, None
        self._done = False

    def _turn(self, T_common_robot: Pose) -> Motion:
        if self._last_yaw is not None:
            self._left_to_look -= wrapped(T_common_robot.yaw - self._last_yaw)
        self._last_yaw = T_common_robot.yaw
        return Motion(0.0, min(LOOK_RATE, self._limits.turn_rate))

    def _look_from(self, T_common_robot: Pose) -> None:
        """Look around here; afterwards this place is done with."""
        self._left_to_look, self._last_yaw = self._look, None
        self._looked_at.append((T_common_robot.x, T_common_robot.y))
        self._planned_at = -math.inf
        self._blocks = 0

    def _arrived(self, T_common_robot: Pose) -> bool:
        """Tick off the corners that are reached; whether that was the last one."""
        had = bool(self._corners)
        while self._corners and math.dist(self._corners[0], (T_common_robot.x, T_common_robot.y)) <= ARRIVED:
            self._corners.pop(0)
        return had and not self._corners

    def _plan(self, stamp: float, T_common_robot: Pose, seen: Points) -> None:
        """Choose where to go, or wait, or be done.

        Args:
            stamp: now.
            T_common_robot: where the robot is.
            seen: shape (K, 2), what stands in the way, if something does; in the common frame.
        """
        self._planned_at = stamp
        here = np.array([[T_common_robot.x, T_common_robot.y]])
        terrain = terrain_of(self._tiles(), self._lattice, np.concatenate([here, seen]))
        self._sees_nothing = not (terrain.free & terrain.discs(here, _AROUND)).any()
        if self._sees_nothing:
            return  # it is not in the map yet, or its sensors are dead
        targets, mates = self._targets(terrain), self._mates()
        if not len(seen) and self._still_good(terrain, passable(terrain, here, mates), targets, here):
            return
        in_the_way = replace(terrain, occupied=terrain.occupied | terrain.discs(seen, 0.0))
        self._corners = _way(in_the_way, here, targets, mates)
        if self._corners:
            self._waits_since = None
        elif _way(terrain, here, targets, _NOBODY):  # what stands there now may go
            self._waits_since = stamp if self._waits_since is None else self._waits_since
            self._done = stamp - self._waits_since > WAITS
        else:
            self._done = True

    def _count_blockage(self) -> None:
        """Blocked again and again on the way to a place: do without it."""
        self._blocks += 1
        if self._blocks > _MOST_BLOCKS and self._corners:
            self._looked_at.append(self._corners[-1])
            self._blocks = 0

    def _targets(self, terrain: Terrain) -> Mask:
        targets = frontiers(terrain)
        if self._looked_at:
            targets &= ~terrain.discs(np.array(self._looked_at), LOOKED_AT)
        return targets

    def _still_good(self, terrain: Terrain, way: Mask, targets: Mask, here: Points) -> bool:
        """Whether the way under foot still leads over free cells to a frontier."""
        if not self._corners:
            return False
        row, column = terrain.cells(np.array(self._corners[-1:]))[0].tolist()
        if not viewpoints(terrain, targets)[row, column]:
            return False
        points = np.concatenate([here, np.array(self._corners)])
        steps = np.linspace(0, 1, max(2, math.ceil(4 * np.hypot(*np.diff(points, axis=0).T).max() / terrain.cell)))
        along = points[:-1, None] + steps[:, None] * np.diff(points, axis=0)[:, None]
        return bool(way[tuple(terrain.cells(along.reshape(-1, 2)).T)].all())


def blind_angle(sensor: Sensor) -> float:
    """Radians that a robot must turn by until each direction was looked into: the widest gap between two beams.

    Half a turn for an Orion, whose beams cover the other half.
    """
    bearings = np.sort(sensor.table[:, 2])
    gaps = np.diff(bearings, append=bearings[0] + FULL_TURN)
    return float(gaps.max()) / FULL_TURN * math.tau


def _way(terrain: Terrain, here: Points, targets: Mask, mates: Points) -> list[tuple[float, float]]:
    """The corners of the way to where the nearest frontier can be looked over; empty if none can be reached."""
    way = passable(terrain, here, mates)
    row, column = terrain.cells(here)[0].tolist()
    trail = way_to_nearest(way, (row, column), viewpoints(terrain, targets))
    if trail is None:
        return []
    corners = straightened(trail, way) or trail[-1:]
    return [(x, y) for x, y in terrain.centres(np.array(corners, np.int64)).tolist()]
