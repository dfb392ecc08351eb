"""Where rays meet straight walls and discs, and how far points are from straight walls.

Laws kept here: exact up to floating point, and without a gap where two walls share a corner; one row a ray or point,
one column a thing, so that the caller may rule pairs out before taking the least.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def meet_walls(origins: Floats, bearings: Floats, walls: Floats) -> Floats:
    """How far each ray goes until it meets each wall.

    A wall is met where its ends lie on either side of the ray's line. A shared corner is on one and the same side for
    both of its walls, so no ray slips through between them.

    Args:
        origins: shape (K, 2), metres.
        bearings: shape (K,), radians counter-clockwise from the x axis.
        walls: shape (M, 4), x0, y0, x1, y1, metres.

    Returns:
        Shape (K, M), metres; infinity where the wall is not met.
    """
    dx, dy = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
    ahead0, aside0 = _along(walls[:, 0] - origins[:, :1], walls[:, 1] - origins[:, 1:], dx, dy)
    ahead1, aside1 = _along(walls[:, 2] - origins[:, :1], walls[:, 3] - origins[:, 1:], dx, dy)
    apart = aside0 != aside1  # otherwise the wall is parallel, and at best its nearer end is met
    share = np.divide(aside0, aside0 - aside1, out=np.zeros_like(aside0), where=apart)
    distance = np.where(apart, ahead0 + share * (ahead1 - ahead0), np.minimum(ahead0, ahead1))
    met = (np.minimum(aside0, aside1) <= 0) & (np.maximum(aside0, aside1) >= 0) & (distance >= 0)
    return np.where(met, distance, np.inf)


def meet_discs(origins: Floats, bearings: Floats, discs: Floats) -> Floats:
    """How far each ray goes until it meets each disc; 0 for a ray that starts inside.

    Args:
        origins: shape (K, 2), metres.
        bearings: shape (K,), radians counter-clockwise from the x axis.
        discs: shape (M, 3), x, y of the centre and the radius, metres.

    Returns:
        Shape (K, M), metres; infinity where the disc is not met.
    """
    dx, dy = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
    ahead, aside = _along(discs[:, 0] - origins[:, :1], discs[:, 1] - origins[:, 1:], dx, dy)
    half_chord2 = discs[:, 2] ** 2 - aside**2
    half_chord = np.sqrt(np.maximum(half_chord2, 0))
    met = (half_chord2 >= 0) & (ahead + half_chord >= 0)
    return np.where(met, np.maximum(ahead - half_chord, 0), np.inf)


def distances_to_walls(points: Floats, walls: Floats) -> Floats:
    """From each point, shape (N, 2), to the nearest point of each wall, shape (M, 4); metres, shape (N, M)."""
    x, y = points[:, :1] - walls[:, 0], points[:, 1:] - walls[:, 1]
    along_x, along_y = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    share = np.clip((x * along_x + y * along_y) / (along_x**2 + along_y**2), 0, 1)
    return np.hypot(x - share * along_x, y - share * along_y)


def box_walls(centres: Floats, half_side: Floats | float, yaws: Floats | float) -> Floats:
    """The four sides of each of N squares.

    Args:
        centres: shape (N, 2), metres.
        half_side: metres, one for all or shape (N,).
        yaws: how far each is turned, radians, one for all or shape (N,).

    Returns:
        Shape (N, 4, 4): of each square four walls x0, y0, x1, y1.
    """
    quarter = np.arange(5) * (np.pi / 2) + np.pi / 4 + np.reshape(yaws, (-1, 1))
    reach = np.reshape(half_side, (-1, 1)) * np.sqrt(2)
    corners = centres[:, None, :] + np.stack([reach * np.cos(quarter), reach * np.sin(quarter)], axis=-1)
    return np.concatenate([corners[:, :-1], corners[:, 1:]], axis=-1)


def _along(x: Floats, y: Floats, dx: Floats, dy: Floats) -> tuple[Floats, Floats]:
    """Offsets (x, y) measured along the unit direction (dx, dy) and to its left."""
    return x * dx + y * dy, y * dx - x * dy
