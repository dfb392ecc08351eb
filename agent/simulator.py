"""Robots in one world: their wheels turn, they bump and slip, they see walls and each other, and the truth is kept.

Laws kept here: time goes in steps of 10 ms; the whole run follows from the world, the seed and what the robots are
told to do at which step; nothing here knows of real time, frames or ports.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.collision import gap_to, gaps, touching
from agent.errors import UserError
from agent.geometry import Floats, box_walls, meet_discs, meet_walls
from agent.kinematics import ORION_CHASSIS, Chassis, Motors, arc
from agent.senses import ORION_NOISE, WHEELS, Dice, HeadingSensors, Noise, RangeSensors
from agent.world import World
from mapping.pose import FULL_TURN
from mapping.sensor import Sensor

STEP_MS = 10
STEP = STEP_MS / 1000

_RAYS_IN_CONE = 9
"""A wide beam is as many thin ones, side by side: one every 3 degrees of a VL53L0X's 25."""

_FREE_AGAIN = 0.005
"""Metres that a robot must have gone since it last touched something before the next touch is a new collision."""

_POLITE = 0.03
"""Metres that an obstacle keeps from a robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What N robots sense at one instant.

    Attributes:
        stamp_ms: since the simulation began.
        ticks: shape (N, 2), what the left and the right encoder count.
        headings: shape (N,), radians counter-clockwise from the common frame's y axis, not wrapped.
        ranges: shape (N, B), metres along each beam; infinity is nothing in range, NaN is invalid.
    """

    stamp_ms: int
    ticks: NDArray[np.int64]
    headings: Floats
    ranges: Floats


class Simulator:
    """N robots, the k-th at the world's k-th start.

    Args:
        world: where they drive.
        seed: decides all noise; not negative.
        robots: N.
        sensor: every robot's ranging module. A beam with a width reads the nearest thing in its cone.
        noise: what is wrong with senses and wheels.
        chassis: what the robots are made of.
        period: seconds between two calls of ``sense``.

    Attributes:
        now_ms: simulated time.
        poses: shape (N, 3), the true x, y, yaw of each robot, metres and radians; yaw is not wrapped.
        targets: shape (N, 2), the speeds that the left and the right wheels are told to have, metres a second.
        collisions: shape (N,), how often each robot ran into something.
        driven: shape (N,), the true length of each robot's way, metres.
        stamps_ms: when the truth was kept: at every sample.
        truth: the poses then, each of shape (N, 3).

    Raises:
        UserError: the world has fewer starts.
    """

    def __init__(
        self,
        world: World,
        seed: int,
        robots: int,
        sensor: Sensor,
        *,
        noise: Noise = ORION_NOISE,
        chassis: Chassis = ORION_CHASSIS,
        period: float = 0.1,
    ) -> None:
        if robots > len(world.starts):
            raise UserError(
                f"world {world.name}",
                f"it has {len(world.starts)} starts, there is none for robot {len(world.starts) + 1}",
                f"use {len(world.starts)} robots at most, or add a start",
            )
        self.now_ms = 0
        self.poses: Floats = np.array([(start.x, start.y, start.yaw) for start in world.starts[:robots]])
        self.targets: Floats = np.zeros((robots, 2))
        self.collisions = np.zeros(robots, np.int64)
        self.driven: Floats = np.zeros(robots)
        self.stamps_ms: list[int] = []
        self.truth: list[Floats] = []
        self._world = world
        self._noise = noise
        self._chassis = chassis
        self._motors = Motors(robots, chassis)
        self._slip = Dice(seed, WHEELS, robots, 2)
        self._range_sensors = RangeSensors(seed, robots, len(sensor.beams), sensor.max_range_mm / 1000, noise)
        self._heading_sensors = HeadingSensors(seed, robots, period, noise)
        self._beams = _Beams(sensor)
        self._gone = np.zeros(len(world.obstacles))
        self._since_touch = np.full(robots, np.inf)
        self._room = 0.0  # metres that robots and obstacles must still go before anything can touch
        self._obstacle_step = max((it.speed for it in world.obstacles), default=0.0) * STEP

    def advance(self, until_ms: int) -> None:
        """Let time pass, in whole steps, until then."""
        while self.now_ms + STEP_MS <= until_ms:
            self._step()

    def _step(self) -> None:
        self._move_obstacles()
        rolled = self._motors.roll(self.targets, STEP)
        lost = self._noise.slip * rolled + self._noise.slip_walk * np.sqrt(np.abs(rolled)) * self._slip.throw()
        after = arc(self.poses, rolled - lost, self._chassis.wheel_base)
        way = np.hypot(*(after - self.poses)[:, :2].T)
        touch = self._touching(after, way)
        # A robot that touches something stays, its wheels slip on; being round, it can still turn.
        after[touch, :2] = self.poses[touch, :2]
        way[touch] = 0.0
        self.collisions += touch & (self._since_touch > _FREE_AGAIN)
        self._since_touch = np.where(touch, 0.0, self._since_touch + way)
        self.driven += way
        self.poses = after
        self.now_ms += STEP_MS

    def _touching(self, after: Floats, way: Floats) -> NDArray[np.bool_]:
        """Who would run into something; looked at only once the narrowest gap of the last look may have closed."""
        self._room -= 2 * float(way.max()) + self._obstacle_step
        if self._room > 0:
            return np.zeros(len(way), np.bool_)
        where = self.poses[:, :2], self._chassis.radius, self._world, self.obstacles
        then = gaps(after[:, :2], *where)
        self._room = float(then.min())
        return touching(gaps(self.poses[:, :2], *where), then) if self._room < 0 else np.zeros(len(way), np.bool_)

    @property
    def obstacles(self) -> Floats:
        """Where the world's obstacles are, shape (K, 2), metres."""
        centres = [it.at(gone) for it, gone in zip(self._world.obstacles, self._gone.tolist(), strict=True)]
        return np.array(centres).reshape(-1, 2)

    def _move_obstacles(self) -> None:
        """An obstacle goes its way, and waits for a robot that is in it."""
        for k, obstacle in enumerate(self._world.obstacles):
            further = float(self._gone[k]) + obstacle.speed * STEP
            gap = gap_to(self.poses[:, :2], obstacle, obstacle.at(further)) - self._chassis.radius
            if gap.min(initial=np.inf) >= _POLITE:
                self._gone[k] = further

    def sense(self) -> Readings:
        """What all robots sense now; keeps the truth. To be called once a period."""
        self.stamps_ms.append(self.now_ms)
        self.truth.append(self.poses.copy())
        headings = self._heading_sensors.read(self.poses[:, 2])
        return Readings(self.now_ms, self._motors.ticks, headings, self._range_sensors.read(self.distances()))

    def distances(self) -> Floats:
        """The true distance along each beam of each robot to whatever it meets first, shape (N, B), metres.

        What lies well beyond the sensors' range may be left out.
        """
        robots = len(self.poses)
        origins, bearings = self._beams.placed(self.poses)
        nearest = self._world.cast(origins, bearings, self._beams.reach)
        bodies = box_walls(self.poses[:, :2], self._chassis.half_side, self.poses[:, 2])
        met = meet_walls(origins, bearings, bodies.reshape(-1, 4)).reshape(robots, -1, robots, 4)
        met[np.arange(robots), :, np.arange(robots)] = np.inf  # nobody sees itself
        nearest = np.minimum(nearest, met.reshape(len(nearest), -1).min(axis=1))
        for obstacle, centre in zip(self._world.obstacles, self.obstacles, strict=True):
            if obstacle.shape == "disc":
                met = meet_discs(origins, bearings, np.array([[*centre, obstacle.radius]]))
            else:
                met = meet_walls(origins, bearings, box_walls(centre[None], obstacle.radius, 0.0)[0])
            nearest = np.minimum(nearest, met.min(axis=1))
        return np.asarray(nearest.reshape(robots, -1, self._beams.rays).min(axis=2))


class _Beams:
    """A sensor's beams as thin rays: one each, or a fan if any of them has a width."""

    def __init__(self, sensor: Sensor) -> None:
        table = sensor.table
        widths = table[:, 3:] / FULL_TURN * 2 * np.pi
        fan = np.linspace(-1, 1, _RAYS_IN_CONE) if widths.any() else np.zeros(1)
        self.rays = len(fan)
        self.reach = 1.5 * sensor.max_range_mm / 1000  # noise may bring near what is a little too far
        self._bearings = (table[:, 2:3] / FULL_TURN * 2 * np.pi + widths * fan).ravel()
        self._ahead, self._left = np.repeat(table[:, :2] / 1000, self.rays, axis=0).T

    def placed(self, poses: Floats) -> tuple[Floats, Floats]:
        """Where the rays of robots at these poses, shape (N, 3), start and look: shapes (K, 2) and (K,)."""
        x, y, yaw = poses.T[:, :, None]
        cos, sin = np.cos(yaw), np.sin(yaw)
        origins = np.stack(
            [x + cos * self._ahead - sin * self._left, y + sin * self._ahead + cos * self._left], axis=-1
        )
        return origins.reshape(-1, 2), (yaw + self._bearings).ravel()
