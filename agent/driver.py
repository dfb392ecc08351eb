"""How a robot drives: the contract of every driver, the steering that all share, and a list of waypoints.

Laws kept here: a driver sees what the robot sees (where it believes to be, what its beams meet), never the truth; time
is an argument; whatever stands close ahead stops the robot, whoever wants it to go on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.heading import wrapped
from mapping.pose import Pose

ROBOT_RADIUS = 0.085
"""Metres: the circle around the paper's robot of 12 x 12 cm."""

ARRIVED = 0.015
"""Metres from a point at which a robot is there."""

BLOCKED_AFTER = 1.5
"""Seconds that a robot waits for what stands ahead to go away."""

_FACING = math.radians(20)  # within this the robot drives, beyond it turns on the spot
_TURN_GAIN = 3.0  # 1/s: far from what ten samples a second, each answered 0.1 s late, would make swing
_SPEED_GAIN = 1.5  # 1/s: it slows down from 0.1 m/s over the last 7 cm
_CREEP = 0.02  # metres a second: the last centimetre takes no eternity

_ASIDE = 0.2  # metres to the side of what stands ahead: a robot's width and room
_PAST = 0.4  # metres to get past it: what stopped it, its own length and room


class Motion(NamedTuple):
    """What a robot is told to do now: metres a second forward, radians a second counter-clockwise."""

    speed: float
    turn_rate: float

    def wheels(self, base: float) -> tuple[float, float]:
        """The left and the right wheel's speed, metres a second, for wheels ``base`` metres apart."""
        aside = self.turn_rate * base / 2
        return self.speed - aside, self.speed + aside


STILL = Motion(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Limits:
    """How a robot may move.

    Attributes:
        speed: metres a second.
        turn_rate: radians a second.
        half_width: metres to either side of its way that must be free: its radius and 1 cm.
        stop: metres from its centre at which something ahead stops it: its radius and 4.5 cm, so that two robots that
            meet can still turn (what one sees of the other is its side, 2.5 cm within its radius).
    """

    speed: float = 0.1
    turn_rate: float = 1.0
    half_width: float = 0.095
    stop: float = 0.13


class Driver(Protocol):
    """Where a robot wants to go."""

    @property
    def done(self) -> bool:
        """Whether it has been everywhere it wanted to be."""
        ...

    @property
    def status(self) -> str:
        """What keeps it from driving, in words; empty if nothing does."""
        ...

    def drive(self, stamp: float, T_common_robot: Pose, points_robot: NDArray[np.float64]) -> Motion:
        """What to do now; to be asked at every sample.

        Args:
            stamp: when the sample was sensed, seconds of any one clock.
            T_common_robot: where the robot believes to be.
            points_robot: shape (K, 2), what its beams meet, metres in its own frame.
        """
        ...

    def placed(self, T_after_before: Pose) -> None:
        """The robot learnt that it is elsewhere in the common frame than it believed.

        Args:
            T_after_before: what places that it knows from being there are moved by.
        """
        ...


class NoDriver:
    """The driver of a robot that is carried, or driven by somebody else: it stands still and is never done."""

    done = False
    status = ""

    def drive(self, stamp: float, T_common_robot: Pose, points_robot: NDArray[np.float64]) -> Motion:
        """Stay."""
        return STILL

    def placed(self, T_after_before: Pose) -> None:
        """Stay there."""


def steer(T_common_robot: Pose, x: float, y: float, limits: Limits) -> Motion:
    """Towards a point of the common frame: turn to it on the spot, then drive, slowly at the end."""
    dx, dy = x - T_common_robot.x, y - T_common_robot.y + 0.0  # never -0.0: what is straight behind is to the left
    error = wrapped(math.atan2(dy, dx) - T_common_robot.yaw)
    turn_rate = min(limits.turn_rate, max(-limits.turn_rate, _TURN_GAIN * error))
    facing = max(0.0, 1 - abs(error) / _FACING)
    return Motion(min(limits.speed, max(_CREEP, _SPEED_GAIN * math.hypot(dx, dy))) * facing, turn_rate)


def room_ahead(points_robot: NDArray[np.float64], limits: Limits) -> float:
    """Metres from the robot's centre to the nearest thing on its way straight ahead; infinity if there is none."""
    x, y = points_robot.T
    return float(x[(x > 0) & (np.abs(y) < limits.half_width)].min(initial=math.inf))


def held_back(motion: Motion, points_robot: NDArray[np.float64], limits: Limits) -> Motion:
    """The motion, slower or without going ahead where there is no room; turning on the spot is always free."""
    return motion._replace(speed=min(motion.speed, _allowed_speed(points_robot, limits)))


def _allowed_speed(points_robot: NDArray[np.float64], limits: Limits) -> float:
    return max(0.0, _SPEED_GAIN * (room_ahead(points_robot, limits) - limits.stop))


class Blockage:
    """Notices that a robot wants to go on and has no room, for too long."""

    def __init__(self) -> None:
        self._since: float | None = None

    def lasts(self, stamp: float, wanted: Motion, got: Motion) -> bool:
        """Whether it has lasted ``BLOCKED_AFTER`` by now; then it is told once and counted anew."""
        if not (wanted.speed > 0 and got.speed < _CREEP / 4):
            self._since = None
        elif self._since is None:
            self._since = stamp
        elif stamp - self._since >= BLOCKED_AFTER:
            self._since = None
            return True
        return False


class WaypointDriver:
    """Drives straight from point to point.

    When something stands in the way and does not leave, the robot goes round it on the right; if that does not help,
    on the left; so two robots that meet head-on pass each other. A waypoint that ``tries`` such detours do not help to
    reach is given up.

    Args:
        waypoints: x, y of the points to visit in order, metres in the common frame.
        limits: how the robot may move.
        tries: detours a waypoint.

    Attributes:
        given_up: the waypoints not reached, by index.
    """

    def __init__(
        self, waypoints: Sequence[tuple[float, float]], limits: Limits | None = None, *, tries: int = 3
    ) -> None:
        self.given_up: list[int] = []
        self._waypoints = [(float(x), float(y)) for x, y in waypoints]
        self._limits = limits or Limits()
        self._tries = tries
        self._next = 0
        self._detours = 0
        self._detour: list[tuple[float, float]] = []
        self._blockage = Blockage()
        self._blocked = False

    @property
    def done(self) -> bool:
        """Whether the last waypoint is reached or given up."""
        return self._next == len(self._waypoints)

    @property
    def status(self) -> str:
        """What keeps it from driving."""
        return f"something stands before waypoint {self._next + 1}" if self._blocked else ""

    def drive(self, stamp: float, T_common_robot: Pose, points_robot: NDArray[np.float64]) -> Motion:
        """Towards the next waypoint; see ``Driver``."""
        self._tick_off(T_common_robot)
        if self.done:
            return STILL
        wanted = steer(T_common_robot, *(self._detour or self._waypoints[self._next :])[0], self._limits)
        motion = held_back(wanted, points_robot, self._limits)
        self._blocked = wanted.speed > motion.speed == 0.0
        if self._blockage.lasts(stamp, wanted, motion):
            self._go_round(T_common_robot)
        return motion

    def placed(self, T_after_before: Pose) -> None:
        """The waypoints lie where they lay; a detour begins anew; see ``Driver``."""
        self._detour = []

    def _tick_off(self, T_common_robot: Pose) -> None:
        while self._detour and _at(T_common_robot, *self._detour[0]):
            self._detour.pop(0)
        while not self.done and not self._detour and _at(T_common_robot, *self._waypoints[self._next]):
            self._go_on()

    def _go_on(self) -> None:
        self._next += 1
        self._detours = 0
        self._blocked = False

    def _go_round(self, T_common_robot: Pose) -> None:
        """Aside, then past what stands ahead: right first, farther at each turn; or give the waypoint up."""
        self._detours += 1
        if self._detours > self._tries:
            self.given_up.append(self._next)
            self._detour = []
            self._go_on()
            return
        aside = (-1 if self._detours % 2 else 1) * _ASIDE * (1 + self._detours) / 2
        corners = T_common_robot.apply(np.array([[0.0, aside], [_PAST, aside]]))
        self._detour = [(x, y) for x, y in corners.tolist()]


def _at(T_common_robot: Pose, x: float, y: float) -> bool:
    return math.hypot(x - T_common_robot.x, y - T_common_robot.y) <= ARRIVED
