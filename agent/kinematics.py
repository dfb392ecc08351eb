"""How a differential drive moves: wheel speeds become rolled distances, ticks, and exact arcs on the floor.

Laws kept here: N robots at once, one row each; wheels are (left, right); the encoders count what the wheels roll, not
where the robot gets to: a wheel that slips counts all the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.geometry import Floats


@dataclass(frozen=True, slots=True)
class Chassis:
    """What all robots of a simulation are made of. The paper gives the size, the rest is usual for its kind.

    Attributes:
        half_side: half of the body's side, metres; the paper's robot is 12 x 12 cm.
        wheel_base: between the wheels' contact points, metres.
        ticks_per_metre: of one encoder. A small geared motor: 7 pulses, 4 edges each, 1:50, a wheel of 32 mm.
        top_speed: of a wheel, metres a second.
        lag: time constant with which a wheel's speed follows what it is told, seconds.
    """

    half_side: float = 0.06
    wheel_base: float = 0.1
    ticks_per_metre: int = 13_926
    top_speed: float = 0.4
    lag: float = 0.05

    @property
    def radius(self) -> float:
        """Of the circle around the body, metres: what the robot needs to turn on the spot."""
        return self.half_side * 2**0.5


ORION_CHASSIS = Chassis()


class Motors:
    """The wheels of N robots, at rest at first.

    Attributes:
        speeds: shape (N, 2), metres a second.
        rolled: shape (N, 2), metres since the beginning.
    """

    def __init__(self, robots: int, chassis: Chassis) -> None:
        self._chassis = chassis
        self.speeds: Floats = np.zeros((robots, 2))
        self.rolled: Floats = np.zeros((robots, 2))

    def roll(self, targets: Floats, dt: float) -> Floats:
        """Let time pass; exact for a motor whose speed approaches its target as exp(-t / lag).

        Args:
            targets: shape (N, 2), the speeds wanted, metres a second; more than the top speed is the top speed.
            dt: seconds.

        Returns:
            What each wheel rolled meanwhile, shape (N, 2), metres.
        """
        wanted = np.clip(targets, -self._chassis.top_speed, self._chassis.top_speed)
        behind = self.speeds - wanted
        lag = self._chassis.lag
        left_behind = np.exp(-dt / lag) if lag else 0.0
        rolled = wanted * dt + behind * lag * (1 - left_behind)
        self.speeds = wanted + behind * left_behind
        self.rolled += rolled
        return np.asarray(rolled)

    @property
    def ticks(self) -> NDArray[np.int64]:
        """What the encoders count, shape (N, 2): whole ticks only."""
        return np.floor(self.rolled * self._chassis.ticks_per_metre).astype(np.int64)


def arc(poses: Floats, wheels: Floats, wheel_base: float) -> Floats:
    """Where robots come to whose wheels go given distances over the floor, each at a steady speed: along a circle.

    The chord of an arc of length d that turns by a is d sin(a / 2) / (a / 2) long and points along its middle.

    Args:
        poses: shape (N, 3), x, y, yaw; metres and radians.
        wheels: shape (N, 2), metres that the left and the right wheel go.
        wheel_base: metres.

    Returns:
        Shape (N, 3); yaw is not wrapped.
    """
    forward = wheels.mean(axis=1)
    turn = (wheels[:, 1] - wheels[:, 0]) / wheel_base
    chord = forward * np.sinc(turn / (2 * np.pi))  # numpy's sinc(x) is sin(pi x) / (pi x)
    middle = poses[:, 2] + turn / 2
    return np.asarray(poses + np.column_stack([chord * np.cos(middle), chord * np.sin(middle), turn]))
