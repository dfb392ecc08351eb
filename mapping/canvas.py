"""Dense arrays that rays are drawn onto, on which the cells of any ray are an arithmetic progression.

A canvas has a box of cells twice: once with the cells of a row side by side, for rays that run along y, and once with
those of a column side by side, for rays that run along x. Either way a step along a ray's longer (major) axis is a
whole line of the canvas, and a cell along its minor axis is the neighbour in memory. So an address and the fraction of
a cell below it are one number of 64 bits, and the k-th address of a ray (k = 0, 1, ...) is

    (first + k * step) >> FRACTION

with no other arithmetic: one addition from a cell to the next.

Why this is exact: cell k of a ray of n steps that goes d <= n cells along its minor axis lies at the floor of
v = k * d / n + 1 / 2 (ties away from the start), a multiple of 1 / (2 n). The fraction's step is d / n rounded up to
2^-FRACTION, so the k-th is too large by less than k * 2^-FRACTION < 4096 / 2^32, and that is less than 1 / (2 n) for
n <= 4,095: never enough to reach the next whole number. To the other side, -floor(v) is the floor of 1 / 2 - k * d / n,
less anything smaller than 1 / (2 n); so there one starts 2^-FRACTION lower and goes down in the same steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.lattice import TILE
from mapping.rays import SILENT, Rays
from mapping.tiles import Evidence

FRACTION = 32
"""Fraction bits of a progression; the address is above them."""


class Box(NamedTuple):
    """A rectangle of whole tiles, the first one and how many; and its canvas."""

    ty: int
    tx: int
    rows: int
    columns: int

    @property
    def area(self) -> int:
        """How many cells it has."""
        return self.rows * self.columns * TILE * TILE

    @property
    def lines(self) -> tuple[int, int, int]:
        """Where columns begin in the canvas, and cells from one row to the next, from one column to the next.

        The last two are half a tile more than they need be: were they multiples of a large power of two, the cells of
        a ray would fall into the same few sets of the cache.
        """
        row, column = self.columns * TILE + TILE // 2, self.rows * TILE + TILE // 2
        return self.rows * TILE * row, row, column

    def canvas(self) -> NDArray[np.int32]:
        """A canvas of zeros."""
        columns, _, column = self.lines
        return np.zeros(columns + self.columns * TILE * column, np.int32)


class Progressions(NamedTuple):
    """Rays as they lie on a canvas; shape (R,) each.

    Attributes:
        first: uint64.
        step: uint64, modulo 2^64.
        visits: int64, how many addresses: the ray's cells, less a silent end.
    """

    first: NDArray[np.uint64]
    step: NDArray[np.uint64]
    visits: NDArray[np.int64]


def box_of(rays: Rays) -> Box:
    """The tiles around some rays (at least one)."""
    start, end = rays.start.T, rays.end.T
    low = np.minimum(start.min(axis=1), end.min(axis=1)) // TILE
    high = np.maximum(start.max(axis=1), end.max(axis=1)) // TILE
    (tx, ty), (columns, rows) = low.tolist(), (high - low + 1).tolist()
    return Box(ty, tx, rows, columns)


def progressions(rays: Rays, box: Box) -> Progressions:
    """The addresses of rays on the canvas of a box that holds them."""
    columns, row, column = box.lines
    start = rays.start.T
    i, j = start[0] - box.tx * TILE, start[1] - box.ty * TILE
    di, dj = rays.end.T - start
    steep = np.abs(dj) > np.abs(di)
    major, minor = np.where(steep, dj, di), np.where(steep, di, dj)
    n = np.abs(major)
    # Quotients of doubles are rounded up rightly: one that is not whole is at least 1 / 4095 away from it.
    slope = np.ceil(np.abs(minor) * float(1 << FRACTION) / np.maximum(n, 1)).astype(np.int64) * np.sign(minor)
    line = np.where(steep, row, column)
    start = np.where(steep, j * row + i, columns + i * column + j)
    return Progressions(
        ((start << FRACTION) + (1 << (FRACTION - 1)) - (minor < 0)).view(np.uint64),
        ((np.where(major < 0, -line, line) << FRACTION) + slope).view(np.uint64),
        n + (rays.ending != SILENT),
    )


def tiles_of(canvas: NDArray[np.int32], box: Box) -> Evidence:
    """The tiles of a box that have any evidence on its canvas."""
    columns, _, _ = box.lines
    cells = canvas[:columns].reshape(box.rows * TILE, -1)[:, : box.columns * TILE]
    cells = cells + canvas[columns:].reshape(box.columns * TILE, -1)[:, : box.rows * TILE].T
    tiles = cells.reshape(box.rows, TILE, box.columns, TILE)
    known = np.bitwise_or.reduce(tiles, axis=1).any(axis=2)
    rows, columns_known = np.nonzero(known)
    keys = np.stack([rows + box.ty, columns_known + box.tx], axis=1).astype(np.int32)
    return Evidence(keys, tiles[rows, :, columns_known])
