"""The mapping pipeline as the paper prints it, line by line, to be compared with ours.

Laws kept here: the paper's frames (a robot's axis is y, bearings count from its right), its floats, its Manhattan
distances; only the misprint of eq. 7 is mended. Nothing that maps for a swarm imports this file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mapping.sensor import TABLE_I

Matrix = NDArray[np.float64]
Cell = tuple[int, int]
"""Column and row, counted along x and y."""

LogOdds = dict[Cell, float]
"""l_{t,i} by cell, in nats; a cell that is absent has the prior."""

L_PRIOR = 0.0
"""l_0: nothing is known, p = 0.5."""

L_OCC = 0.85
L_FREE = -0.40
"""The paper sets both "empirically" and prints neither; these are our evidence model's."""


# --- A. Point cloud mapping


def theta_of(yaw: float) -> float:
    """The paper's heading of a robot whose x axis has this yaw: its y axis is what looks ahead."""
    return yaw - math.pi / 2


def points_S(rho: Sequence[float], phi: Sequence[float] = TABLE_I) -> Matrix:  # noqa: N802
    """Eq. 1: readings in the sensor's frame [S], homogeneous, shape (3, B).

    Args:
        rho: the reading of each sensor, metres.
        phi: the angle of each sensor (Table I), radians from the robot's right.
    """
    x = [r * math.cos(angle) for r, angle in zip(rho, phi, strict=True)]
    y = [r * math.sin(angle) for r, angle in zip(rho, phi, strict=True)]
    return np.array([x, y, [1.0] * len(x)])


def T_R_S(d_RS: float) -> Matrix:  # noqa: N802
    """Eq. 2: the sensor's frame in the robot's; d_RS in metres ahead."""
    return np.array([[1, 0, 0], [0, 1, d_RS], [0, 0, 1]], np.float64)


def T_W_R(x: float, y: float, theta: float) -> Matrix:  # noqa: N802
    """Eq. 4: the robot's frame in the world's; eq. 8 is the same with R2's start, and gives [C] from [R2]."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


def point_cloud(
    pose: tuple[float, float, float], rho: Sequence[float], d_RS: float, phi: Sequence[float] = TABLE_I
) -> Matrix:
    """Eq. 3: one scan's points in the world's frame, shape (B, 2), metres.

    Args:
        pose: x, y, theta of the robot in the world's frame; theta is the paper's.
        rho: metres.
        d_RS: metres.
        phi: radians.
    """
    points_W = T_W_R(*pose) @ T_R_S(d_RS) @ points_S(rho, phi)
    return np.asarray(points_W[:2].T)


# --- B. Occupancy grid mapping


def grid_cell(point: Iterable[float], size: float) -> Cell:
    """GRID: the cell that a point in metres lies in; ``size`` is that of a cell in metres."""
    x, y = point
    return math.floor(x / size), math.floor(y / size)


def bresenham(x: Cell, z: Cell) -> list[Cell]:
    """The cells of the ray from x to z, both included: the perceptual field of view of one sensor."""
    distance = abs(z[0] - x[0]), abs(z[1] - x[1])
    sign = (1 if z[0] > x[0] else -1), (1 if z[1] > x[1] else -1)
    steps = max(distance)
    error = [steps, steps]  # in units of half a cell / steps
    cell = list(x)
    ray = [x]
    for _ in range(steps):
        for axis in (0, 1):
            error[axis] += 2 * distance[axis]
            if error[axis] >= 2 * steps:
                error[axis] -= 2 * steps
                cell[axis] += sign[axis]
        ray.append((cell[0], cell[1]))
    return ray


def occupancy_grid_mapping(log_odds: Mapping[Cell, float], x: Cell, z: Cell) -> LogOdds:
    """Algorithm 1 for one sensor: l_t out of l_{t-1}; ``log_odds`` is left alone.

    The paper loops over all cells of the grid; those that are not in the field of view keep their value, so this loops
    over those that are.

    Args:
        log_odds: l_{t-1}.
        x: the robot's cell, GRID(x_t).
        z: the reading's cell, GRID(z_t).
    """
    result = dict(log_odds)
    update_grid(result, x, z)
    return result


def update_grid(log_odds: LogOdds, x: Cell, z: Cell) -> None:
    """``occupancy_grid_mapping`` in place."""
    for m_i in bresenham(x, z):
        value = inv_sensor(m_i, x, z)
        if value is not None:
            log_odds[m_i] = log_odds.get(m_i, L_PRIOR) + value - L_PRIOR  # line 4


# --- C. Inverse sensor model


def inv_sensor(m_i: Cell, x: Cell, z: Cell) -> float | None:
    """Algorithm 2: what a reading at z says of a cell; None behind the reading, where the paper returns nothing."""
    distance_z = manhattan_distance(x, z)
    distance_r = manhattan_distance(x, m_i)
    if abs(distance_r - distance_z) < 1:
        return L_OCC
    if distance_r < distance_z:
        return L_FREE
    return None


def manhattan_distance(a: Cell, b: Cell) -> int:
    """Cells along x and cells along y."""
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def probability(log_odds: float) -> float:
    """Eq. 7 in its right form, p = 1 - 1 / (1 + exp l); the paper prints 1 - exp l, which has a pole at the prior."""
    return 1 - 1 / (1 + math.exp(log_odds))


# --- all of it


def mapped(log_odds: LogOdds, pose: tuple[float, float, float], cloud: Matrix, size: float) -> None:
    """Take one scan into a grid, in place.

    Args:
        log_odds: l_{t-1}, which becomes l_t.
        pose: x, y (metres) and theta of the robot in the world's frame.
        cloud: its points there, shape (N, 2), metres.
        size: of a cell, metres.
    """
    x = grid_cell(pose[:2], size)
    for point in cloud.tolist():
        update_grid(log_odds, x, grid_cell(point, size))
