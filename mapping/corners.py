"""Rays by their corners: a third of the additions that their cells are.

A ray along x is a run of cells in each row that it touches. Along a row its evidence changes only where a run begins or
ends; and where one run ends, the next begins in the neighbouring row. So a ray of n steps that goes d <= n cells aside
is its two ends and d *corners*, each of which takes from one line what it gives to the next: in logs of lasers d is a
third of n. Two canvases are kept, of what changes from a cell to the next,

    change[line] = edges[line] - corners[line] + corners[line - 1]

and the running sum of that along each line is the evidence. It costs the canvas' area once, whatever the number of
rays. (Rays along y are the same with columns for rows.)

Where the corners are: cell k lies at k * d / n aside, rounded to the nearest whole number, ties away from the start. So
corner m = 1 ... d is before cell k = x rounded up, x = (2 m - 1) * n / (2 d), a multiple of 1 / (2 d). In fixed point
n / (2 d) is rounded down to 2^-FRACTION, so that the m-th is too small by less than 2 d * 2^-FRACTION < 8192 / 2^32,
and that is less than 1 / (2 d) for d <= 4,095, with 2^-FRACTION to spare. So x rounded up is the floor of this number
plus 1 - 2^-FRACTION; and for a ray that runs the other way, 1 - x rounded up is the floor of 1 less this number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.canvas import FRACTION, Box
from mapping.evidence import EvidenceModel
from mapping.lattice import MAX_RAY_CELLS, TILE
from mapping.rays import HIT, SILENT, Rays
from mapping.tiles import Evidence

_CELLS = 1 << 15
_BELOW = np.uint64(FRACTION)
_M = np.arange(MAX_RAY_CELLS)[:, None]


class Courses(NamedTuple):
    """How rays lie on a canvas; shape (R,) each.

    Attributes:
        low: int64, the first place with the ray's evidence along its line: its start, or its end if it runs backwards.
        high: int64, the first place behind it, on the line of the other end.
        end: int64, its last cell.
        first: uint64, its first corner, the place behind which the line with the smaller address has nothing of it.
        step: uint64, from one corner to the next, modulo 2^64.
        corners: int64, how many; negative where it is the line with the larger address that comes to its end.
    """

    low: NDArray[np.int64]
    high: NDArray[np.int64]
    end: NDArray[np.int64]
    first: NDArray[np.uint64]
    step: NDArray[np.uint64]
    corners: NDArray[np.int64]


def courses(rays: Rays, box: Box) -> Courses:
    """Rays on the canvas of a box that holds them."""
    columns, row, column = box.lines
    (i, j), (di, dj) = rays.start.T, (rays.end - rays.start).T
    steep = np.abs(dj) > np.abs(di)
    major, minor = np.where(steep, dj, di), np.where(steep, di, dj)
    backwards, down = major < 0, minor < 0
    line = np.where(steep, column, row)
    i, j = i - box.tx * TILE, j - box.ty * TILE
    start = np.where(steep, columns + i * column + j, j * row + i)
    end = start + minor * line + major
    last = end - (rays.ending == SILENT) * np.where(backwards, -1, 1)  # with evidence

    n, d = np.abs(major), np.abs(minor)
    # Quotients of doubles are rounded down rightly: one that is not whole is at least 1 / 4095 away from the next.
    half = (n * float(1 << (FRACTION - 1)) / np.maximum(d, 1)).astype(np.int64)
    half = np.where(backwards, -half, half)
    return Courses(
        low=np.where(backwards, last, start),
        high=np.where(backwards, start, last) + 1,
        end=end,
        first=(((start + 1 - down * line) << FRACTION) - ~backwards + half).view(np.uint64),
        step=((np.where(down, -line, line) << FRACTION) + 2 * half).view(np.uint64),
        corners=np.where(backwards == down, d, -d),
    )


class Drawing:
    """The evidence of rays on the canvas of a box that holds them."""

    def __init__(self, box: Box, model: EvidenceModel) -> None:
        self._box = box
        self._free, self._more = np.int32(model.free), np.int32(model.occupied - model.free)
        self._corners, self._edges = box.canvases(2)
        self._memory = np.empty(_CELLS, np.uint64)

    def add(self, rays: Rays) -> None:
        """Rays onto the canvas."""
        low, high, end, first, step, corners = courses(rays, self._box)
        np.add.at(self._edges, low, self._free)
        np.add.at(self._edges, high, -self._free)
        hits = end[rays.ending == HIT]
        np.add.at(self._edges, hits, self._more)
        np.add.at(self._edges, hits + 1, -self._more)

        order = np.argsort(corners.astype(np.int16), kind="stable")
        first, step, corners = first[order], step[order], corners[order]
        falling, rising = np.searchsorted(corners, [0, 1])  # between them are the rays without any
        self._turn(first[:falling], step[:falling], -corners[:falling], -self._free)
        self._turn(first[rising:][::-1], step[rising:][::-1], corners[rising:][::-1], self._free)

    def _turn(
        self, first: NDArray[np.uint64], step: NDArray[np.uint64], corners: NDArray[np.int64], units: np.int32
    ) -> None:
        """Corners of rays that have ever fewer: some rays together are an array of shape (corners, rays)."""
        begin = 0
        while begin < len(corners):
            most = int(corners[begin])
            some = slice(begin, begin + max(1, _CELLS // most))
            begin, counts = some.stop, corners[some]
            places = self._memory[: most * len(counts)].reshape(most, -1)
            np.multiply(_M[:most].view(np.uint64), step[some], out=places)
            places += first[some]
            places >>= _BELOW
            cells, common = places.view(np.intp), int(counts[-1])  # so many all of them have
            np.add.at(self._corners, cells[:common].ravel(), units)
            if common < most:
                np.add.at(self._corners, cells[common:][_M[common:most] < counts], units)

    def evidence(self) -> Evidence:
        """The tiles that have any; nothing can be added afterwards."""
        for edges, corners in zip(*map(self._box.halves, (self._edges, self._corners)), strict=True):
            np.subtract(edges, corners, out=edges)
            np.add(edges[1:], corners[:-1], out=edges[1:])
            np.cumsum(edges, axis=1, dtype=np.int32, out=edges)
        rows, columns = self._box.halves(self._edges)
        return self._box.tiles(rows[:, : self._box.columns * TILE] + columns[:, : self._box.rows * TILE].T)
