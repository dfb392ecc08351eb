"""Rays as strokes: at most 256 cells each, all of which are one affine expression in int32.

The k-th cell of a stroke (k = 0 ... visits - 1) lies k cells along the ray's longer (major) axis and

    (intercept + k * slope) >> SHIFT

cells along its minor axis from where the stroke starts. Why this is exact: cell K of a ray of n steps that goes d <= n
cells along its minor axis lies at the floor of v = K * d / n + 1 / 2 (ties away from the start), a multiple of
1 / (2 n). The intercept is the fraction of v at the stroke's first cell and the slope is d / n, both rounded up to
2^-SHIFT. So at its k-th cell a stroke is too large by less than (k + 1) * 2^-SHIFT <= 256 / 2^21 = 1 / 8192, which is
less than 1 / (2 n) for n <= 4,095: never enough to reach the next whole number. Nor does it leave int32: it stays below
257 * 2^21 < 2^30.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.lattice import TILE
from mapping.rays import Rays

SHIFT = 21
"""Fraction bits of a stroke's intercept and slope."""

LENGTH = 256
"""The most cells of a stroke."""

STROKE = np.dtype(
    [
        ("i", np.int32),  # the cell where it starts
        ("j", np.int32),
        ("intercept", np.int32),
        ("slope", np.int32),
        ("visits", np.int16),  # how many cells, 1 ... LENGTH
        ("major_i", np.int8),  # one cell along the major axis: -1, 0 or 1 on each
        ("major_j", np.int8),
        ("minor_i", np.int8),  # one cell along the minor axis
        ("minor_j", np.int8),
        ("hit", np.bool_),  # whether its last cell is where something was seen
    ],
    align=True,
)

Strokes = NDArray[np.void]
"""Shape (S,), of type ``STROKE``."""


class Box(NamedTuple):
    """A rectangle of whole tiles: the first one, and how many."""

    ty: int
    tx: int
    rows: int
    columns: int

    @property
    def area(self) -> int:
        """How many cells it has."""
        return self.rows * self.columns * TILE * TILE

    @property
    def stride(self) -> int:
        """Cells from one row of the box in memory to the next.

        Half a tile more than its columns take: were it a multiple of a large power of two, the cells of a steep ray
        would fall into the same few sets of the cache.
        """
        return self.columns * TILE + TILE // 2

    @classmethod
    def around(cls, boxes: Sequence[Box]) -> Box:
        """The smallest box that holds some boxes (at least one)."""
        if len(boxes) == 1:
            return boxes[0]
        ty, tx, ty_end, tx_end = zip(
            *((ty, tx, ty + rows, tx + columns) for ty, tx, rows, columns in boxes), strict=True
        )
        return cls(min(ty), min(tx), max(ty_end) - min(ty), max(tx_end) - min(tx))


def strokes_of(rays: Rays) -> Strokes:
    """The strokes of rays, in order; a ray that says nothing has none."""
    (i, j), (di, dj) = rays.start.T, (rays.end - rays.start).T
    left, hit = rays.visits, rays.hit
    first: NDArray[np.int64] | int = 0
    count = (left + (LENGTH - 1)) // LENGTH
    if (count != 1).any():  # some are cut, or say nothing
        ray = np.repeat(np.arange(len(rays)), count)
        first = (np.arange(len(ray)) - (np.cumsum(count) - count)[ray]) * LENGTH
        i, j, di, dj, left, hit = i[ray], j[ray], di[ray], dj[ray], left[ray] - first, hit[ray]

    across, along = np.abs(di), np.abs(dj)
    steep = along > across
    n, d = np.maximum(np.maximum(across, along), 1), np.minimum(across, along)
    sign_i, sign_j = np.sign(di), np.sign(dj)
    major_i, major_j, minor_i, minor_j = sign_i * ~steep, sign_j * steep, sign_i * steep, sign_j * ~steep
    v = 2 * first * d + n  # at the first cell, in halves of 1 / n
    whole = v // (2 * n)

    strokes = np.empty(len(left), STROKE)
    strokes["i"] = i + first * major_i + whole * minor_i
    strokes["j"] = j + first * major_j + whole * minor_j
    # Quotients of doubles are rounded up rightly: one that is not whole is at least 1 / 8190 away from it.
    strokes["intercept"] = np.ceil((v - whole * 2 * n << SHIFT) / (2 * n))
    strokes["slope"] = np.ceil((d << SHIFT) / n)
    strokes["visits"] = np.minimum(left, LENGTH)
    strokes["major_i"], strokes["major_j"] = major_i, major_j
    strokes["minor_i"], strokes["minor_j"] = minor_i, minor_j
    strokes["hit"] = hit & (left <= LENGTH)
    return strokes


def box_of(strokes: Strokes) -> Box:
    """The tiles around some strokes (at least one)."""
    last = strokes["visits"] - np.int32(1)
    aside = (strokes["intercept"] + last * strokes["slope"]) >> SHIFT
    j, i = (
        np.concatenate([strokes[axis], strokes[axis] + last * strokes[major] + aside * strokes[minor]]) // TILE
        for axis, major, minor in (("j", "major_j", "minor_j"), ("i", "major_i", "minor_i"))
    )
    ty, tx = int(j.min()), int(i.min())
    return Box(ty, tx, int(j.max()) - ty + 1, int(i.max()) - tx + 1)
