"""A simulated Orion: it drives its world's waypoints and reads its ranging module by ray casting.

Laws kept here: the whole run follows from the world, the robot's index and the seed, and is laid out when the body is
made, so it does not matter how it is read. Robots see walls, not each other; nothing slips and nothing collides.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from agent.body import BATCH
from agent.errors import UserError
from agent.world import World
from mapping.pose import FULL_TURN, Pose, QuantisedPose
from mapping.scan import Scans, quantise
from mapping.sensor import Sensor

LONGEST_RUN = 3600.0
"""Seconds of simulated time a robot may need; a waypoint misplaced by a kilometre ends here, not in the memory."""


_HALF_TURN = np.pi + 1e-9
"""A hair more, so that about-turns all go left, whatever the last bit of an arctangent says."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What is wrong with what the robot senses: independent draws for each reading and each pose.

    Attributes:
        range_floor: standard deviation of a range near zero, metres.
        range_share: what is added to it per metre of range. The VL53L0X's data sheet gives 3 to 5 % for a fast reading
            of a far target; our 1 % is kinder and keeps a 2 cm map crisp: raise it to see what that does to a map.
        dropout: probability that a reading is invalid.
        position: standard deviation of x and of y as the robot reports them, metres (encoders).
        heading: standard deviation of the reported heading, radians (BNO055 behind the paper's moving average).
    """

    range_floor: float = 0.003
    range_share: float = 0.01
    dropout: float = 0.005
    position: float = 0.001
    heading: float = radians(0.2)


ORION_NOISE = Noise()
"""A well-kept Orion."""

NO_NOISE = Noise(0.0, 0.0, 0.0, 0.0, 0.0)
"""The robot knows where it is and how far it is to the wall."""


class SimulatedBody:
    """One robot's run through its waypoints, a scan every ``1 / rate_hz`` seconds; see ``agent.body.Body``.

    Attributes:
        sensor: what its scans' ranges mean.
        stamps: shape (N,), seconds since the body's start.
        truth: shape (N, 3), x, y, yaw of the robot in the world at each stamp, metres and radians; not wrapped.
    """

    def __init__(
        self,
        world: World,
        index: int,
        sensor: Sensor,
        *,
        start: QuantisedPose | None = None,
        seed: int,
        rate_hz: float = 10.0,
        speed_m_s: float = 0.1,
        turn_rad_s: float = 1.0,
        noise: Noise = ORION_NOISE,
    ) -> None:
        """Lays out the whole run.

        Args:
            world: where it drives.
            index: which of the world's starts is this robot's, from 0.
            sensor: its beams.
            start: where the robot believes it started, in the common frame; None is the truth.
            seed: with ``index`` it decides all noise; not negative.
            rate_hz: scans a second.
            speed_m_s: how fast it drives.
            turn_rad_s: how fast it turns on the spot.
            noise: of ranges and poses.

        Raises:
            UserError: the world has no such start, or its waypoints take more than ``LONGEST_RUN``.
        """
        if not 0 <= index < len(world.starts):
            raise UserError(
                f"world {world.name}",
                f"it has {len(world.starts)} starts, there is none for robot {index + 1}",
                f"use {len(world.starts)} robots at most, or add a start",
            )
        times, knots = drive(world.starts[index], world.waypoints[index], speed_m_s, turn_rad_s)
        if times[-1] > LONGEST_RUN:
            raise UserError(
                f"world {world.name}: starts[{index}].waypoints",
                f"the way takes {times[-1]:.0f} s, at most {LONGEST_RUN:.0f} s are simulated",
                "bring the waypoints nearer",
            )
        self.sensor = sensor
        self.stamps = np.arange(int(times[-1] * rate_hz + 1e-6) + 1) / rate_hz
        self.truth = np.column_stack([np.interp(self.stamps, times, knots[:, axis]) for axis in range(3)])

        rng = np.random.default_rng((seed, index))
        ranges = _measure(_look(world, self.truth, sensor), sensor.max_range_mm / 1000, noise, rng)
        sigma = (noise.position, noise.position, noise.heading)
        T_world_robot = self.truth + rng.standard_normal(self.truth.shape) * sigma
        # The truth is rounded as the belief is: a start that is right then moves nothing at all.
        T_world_start = QuantisedPose.of(world.starts[index])
        T_common_world = (T_world_start if start is None else start).pose() @ T_world_start.pose().inverse()
        self._scans = quantise(self.stamps, T_common_world.compose(T_world_robot), ranges, sensor)
        self._given = 0

    def read(self, until: float) -> Scans:
        """The next scans (at most ``BATCH``) sensed before ``until``, seconds of the body's own time."""
        sensed = int(np.searchsorted(self.stamps, until))
        first = self._given
        self._given = max(first, min(first + BATCH, sensed))
        return self._scans[first : self._given]

    @property
    def progress(self) -> tuple[int, int]:
        """Scans read so far, and of how many in all."""
        return self._given, len(self._scans)

    @property
    def done(self) -> bool:
        """Whether the last waypoint is reached and all scans are read."""
        return self._given == len(self._scans)


def drive(
    start: Pose, waypoints: NDArray[np.float64], speed: float, turn_rate: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The way of a differential drive that turns on the spot towards each waypoint, then drives straight to it.

    Args:
        start: where it stands at time 0.
        waypoints: shape (W, 2), metres.
        speed: metres a second.
        turn_rate: radians a second.

    Returns:
        When the motion changes, seconds, shape (K,), and the poses then, shape (K, 3). Between them every coordinate
        is linear in time; yaw is not wrapped.
    """
    times, knots = [0.0], [(start.x, start.y, start.yaw)]
    for x, y in waypoints.tolist():
        here_x, here_y, yaw = knots[-1]
        distance = float(np.hypot(x - here_x, y - here_y))
        if distance == 0.0:
            continue
        turn = float(np.arctan2(y - here_y, x - here_x)) - yaw
        turn = _HALF_TURN - (_HALF_TURN - turn) % (2 * np.pi)  # the short way round
        times.append(times[-1] + abs(turn) / turn_rate)
        knots.append((here_x, here_y, yaw + turn))
        times.append(times[-1] + distance / speed)
        knots.append((x, y, yaw + turn))
    return np.array(times), np.array(knots)


def _look(world: World, poses: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """True distances along each beam from each pose, shape (N, B), metres."""
    beams = sensor.table
    x, y, yaw = (column[:, None] for column in poses.T)
    ahead, left = beams[:, 0] / 1000, beams[:, 1] / 1000
    cos, sin = np.cos(yaw), np.sin(yaw)
    origins = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1)
    bearings = yaw + beams[:, 2] / FULL_TURN * 2 * np.pi
    return world.cast(origins.reshape(-1, 2), bearings.ravel()).reshape(bearings.shape)


def _measure(
    distances: NDArray[np.float64], max_range: float, noise: Noise, rng: np.random.Generator
) -> NDArray[np.float64]:
    """What the sensor makes of true distances: noisy ones, infinity beyond ``max_range``, NaN where it fails."""
    sigma = noise.range_floor + noise.range_share * np.minimum(distances, max_range)
    ranges = np.maximum(distances + sigma * rng.standard_normal(distances.shape), 0.001)  # never less than a millimetre
    ranges[ranges > max_range] = np.inf
    ranges[rng.random(distances.shape) < noise.dropout] = np.nan
    return ranges
