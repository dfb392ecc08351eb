"""How near robots are to what they could run into, and who may not make a step because it would touch.

Laws kept here: a robot's footprint is the circle around its body; what a step touches stops it where it was, and it may
always move away. Other robots count where they were before the step, so two that meet head-on may overlap by one
step, some millimetres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.geometry import Floats
from agent.obstacle import Obstacle
from agent.world import World


def gaps(points: Floats, robots: Floats, radius: float, world: World, obstacles: Floats) -> Floats:
    """How much room each robot would have at its point to the nearest wall, to each obstacle, and to each other robot.

    Args:
        points: shape (N, 2), where the robots' centres would be, metres.
        robots: shape (N, 2), where they are.
        radius: of the robots, metres.
        world: the walls, and what the obstacles are.
        obstacles: shape (K, 2), the obstacles' centres.

    Returns:
        Shape (N, 1 + K + N), metres; below 0 they would overlap. A robot has all the room in the world to itself.
    """
    things = [world.clearance(points)]
    things += [gap_to(points, obstacle, centre) for obstacle, centre in zip(world.obstacles, obstacles, strict=True)]
    others = np.hypot(points[:, :1] - robots[:, 0], points[:, 1:] - robots[:, 1]) - radius
    np.fill_diagonal(others, np.inf)
    return np.column_stack([*things, others]) - radius


def touching(before: Floats, after: Floats) -> NDArray[np.bool_]:
    """Who would touch something by a step that does not lead away from it, shape (N,); from the gaps of two `gaps`."""
    return np.asarray(((after < 0) & (after < before)).any(axis=1))


def gap_to(points: Floats, obstacle: Obstacle, centre: Floats) -> Floats:
    """From each point, shape (N, 2), to an obstacle's rim, shape (N,), metres; not above 0 within it."""
    x, y = np.abs(points - centre).T
    if obstacle.shape == "disc":
        return np.asarray(np.hypot(x, y) - obstacle.radius)
    return np.asarray(np.hypot(np.maximum(x - obstacle.radius, 0), np.maximum(y - obstacle.radius, 0)))
