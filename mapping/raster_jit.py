"""From scans to evidence with compiled loops (numba, extra ``fast``): the same integers as ``raster``, sooner.

Its stages are jitted functions: rays, their progressions on a canvas (``mapping.canvas``), an addition for every cell,
tiles. (An addition costs so little here that corners would save no more than their running sums cost.) A call from
Python costs microseconds, mostly for the arrays that go in and out; so all stages are one call (``_at_once``), unless
the rays are not worth one canvas. Compiled code is cached beside this file, so that only the first process on a machine
compiles.

Rays along y are drawn by rows, those along x by columns: a step along a ray's longer (major) axis is a whole line, and
a cell along its minor axis is the neighbour in memory. Why the progressions are exact: cell k of a ray of n steps that
goes d <= n cells along its minor axis lies at the floor of v = k * d / n + 1 / 2 (ties away from the start), a multiple
of 1 / (2 n). The fraction's step is d / n rounded up to 2^-FRACTION, so the k-th is too large by less than
k * 2^-FRACTION < 4096 / 2^32, and that is less than 1 / (2 n) for n <= 4,095: never enough to reach the next whole
number. To the other side, -floor(v) is the floor of 1 / 2 - k * d / n, less anything smaller than 1 / (2 n); so there
one starts 2^-FRACTION lower and goes down in the same steps.
"""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
from numpy.typing import NDArray

from mapping import raster as numpys
from mapping.canvas import FRACTION
from mapping.cosine import DIRECTIONS, Q
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Lattice
from mapping.pose import FULL_TURN
from mapping.raster import bounded, gathered, is_worth_its_area
from mapping.rays import FREE, HIT, SILENT, Rays, check_beams, fan
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from mapping.tiles import Evidence

_TOGETHER = 256
_DIRECTIONS = DIRECTIONS.T.astype(np.int16, order="C")  # cosine and sine side by side, a quarter of the cache
_jit = numba.njit(cache=True, nogil=True, error_model="numpy")
_is_worth_its_area = _jit(is_worth_its_area)


def raster(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
    """The evidence of scans; see ``mapping.raster.raster``."""
    check_beams(scans, sensor)
    evidence = _together(scans, sensor, lattice, model)
    return gathered(_parts(scans, sensor, lattice, model)) if evidence is None else bounded(evidence)


def raster_rays(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of rays; see ``mapping.raster.raster_rays``."""
    ends = np.stack([*rays.start.T, *rays.end.T, rays.ending]).astype(np.int32)
    fits, keys, cells = _drawn(ends, model.free, model.occupied - model.free)
    return bounded(Evidence(keys, cells)) if fits else numpys.raster_rays(rays, model)


def _together(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence | None:
    """The evidence of scans if they are few enough for one call, and worth one canvas."""
    beams = fan(sensor, lattice).table
    if len(scans) * beams.shape[1] > numpys.BATCH:
        return None
    reach, scale = sensor.max_range_mm, lattice.cell_mm << Q
    fits, keys, cells = _at_once(
        scans.poses, scans.ranges, beams, _DIRECTIONS, reach, scale, model.free, model.occupied - model.free
    )
    return Evidence(keys, cells) if fits else None


def _parts(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Iterator[Evidence]:
    """Scans that do not go together by halves; one alone is left to NumPy, which halves its rays."""
    half = len(scans) // 2
    if half == 0:
        yield numpys.raster(scans, sensor, lattice, model)
        return
    for some in (scans[:half], scans[half:]):
        evidence = _together(some, sensor, lattice, model)
        if evidence is None:
            yield from _parts(some, sensor, lattice, model)
        else:
            yield evidence


@_jit
def _at_once(
    poses: NDArray[np.int32],
    ranges: NDArray[np.uint16],
    beams: NDArray[np.int64],
    directions: NDArray[np.int16],
    max_range_mm: int,
    scale: int,
    free: int,
    more: int,
) -> tuple[bool, NDArray[np.int32], NDArray[np.int32]]:
    """The evidence of scans, if one canvas for all of them is worth its area."""
    return _drawn(_ends(poses, ranges, beams, directions, max_range_mm, scale), free, more)


@_jit
def _floor(coordinate: int, per_cell: float) -> int:
    return int(np.floor((coordinate + 0.5) * per_cell))  # exact: what is not whole is farther away than doubles err


@_jit
def _ends(
    poses: NDArray[np.int32],
    ranges: NDArray[np.uint16],
    beams: NDArray[np.int64],
    directions: NDArray[np.int16],
    max_range_mm: int,
    scale: int,
) -> NDArray[np.int32]:
    """The rays of scans (``mapping.rays.rays_of``), shape (5, R): i and j of the first and the last cell, ending."""
    beam, x_mm, y_mm, bearing, endings = beams
    ends = np.empty((5, len(poses) * len(beam)), np.int32)
    count = 0
    per_cell = 1.0 / scale
    for scan in range(len(poses)):
        x, y, yaw = np.int64(poses[scan, 0]) << Q, np.int64(poses[scan, 1]) << Q, np.int64(poses[scan, 2])
        c, s = directions[np.uintp(yaw & (FULL_TURN - 1))]
        for ray in range(len(beam)):
            reading = ranges[scan, np.uintp(beam[ray])]
            if reading == INVALID:
                continue
            reach, ending = np.int64(reading), endings[ray]
            if reading == NO_RETURN:
                reach, ending = np.int64(max_range_mm), np.int64(FREE)
            along = directions[np.uintp((yaw + bearing[ray]) & (FULL_TURN - 1))]
            x0 = x + x_mm[ray] * c - y_mm[ray] * s
            y0 = y + x_mm[ray] * s + y_mm[ray] * c
            ends[0, count], ends[1, count] = _floor(x0, per_cell), _floor(y0, per_cell)
            ends[2, count] = _floor(x0 + reach * along[0], per_cell)
            ends[3, count] = _floor(y0 + reach * along[1], per_cell)
            ends[4, count] = ending
            count += 1
    return ends[:, :count]


@_jit
def _drawn(ends: NDArray[np.int32], free: int, more: int) -> tuple[bool, NDArray[np.int32], NDArray[np.int32]]:
    """The evidence of rays, if one canvas for all of them is worth its area."""
    ty, tx, rows, columns, visits = _measured(ends)
    if not _is_worth_its_area(rows * columns * TILE * TILE, visits):
        return False, np.empty((0, 2), np.int32), np.empty((0, TILE, TILE), np.int32)
    row, column = columns * TILE + TILE // 2, rows * TILE + TILE // 2
    start = rows * TILE * row
    canvas = np.zeros(start + columns * TILE * column, np.int32)
    several = np.empty((_TOGETHER, 3), np.uint64)
    for first in range(0, ends.shape[1], _TOGETHER):
        some = ends[:, first : first + _TOGETHER]
        _progressions(some, several, ty * TILE, tx * TILE, start, row, column)
        _add(canvas, some[4], several, free, more)
    keys, cells = _tiles(canvas, start, row, column, ty, tx, rows, columns)
    return True, keys, cells


@_jit
def _measured(ends: NDArray[np.int32]) -> tuple[int, int, int, int, int]:
    """The box around rays (an empty one around none), and how many cells they visit."""
    i, j, to_i, to_j, _ = ends
    if len(i) == 0:
        return 0, 0, 0, 0, 0
    low_i, low_j = high_i, high_j = i[0], j[0]
    visits = 0
    for ray in range(len(i)):
        low_i, high_i = min(low_i, i[ray], to_i[ray]), max(high_i, i[ray], to_i[ray])
        low_j, high_j = min(low_j, j[ray], to_j[ray]), max(high_j, j[ray], to_j[ray])
        visits += max(abs(to_i[ray] - i[ray]), abs(to_j[ray] - j[ray])) + 1
    ty, tx = low_j // TILE, low_i // TILE
    return ty, tx, high_j // TILE - ty + 1, high_i // TILE - tx + 1, visits


@_jit
def _progressions(
    ends: NDArray[np.int32], several: NDArray[np.uint64], j0: int, i0: int, start: int, row: int, column: int
) -> None:
    """First, step and visits of rays on the canvas."""
    for ray in range(ends.shape[1]):
        i, j = np.int64(ends[0, ray]), np.int64(ends[1, ray])
        di, dj = ends[2, ray] - i, ends[3, ray] - j
        i, j = i - i0, j - j0
        if abs(dj) > abs(di):
            major, minor, line, address = dj, di, row, j * row + i
        else:
            major, minor, line, address = di, dj, column, start + i * column + j
        n = abs(major)
        slope = np.int64(np.ceil(np.float64(abs(minor) << FRACTION) / max(n, 1)))
        first = (address << FRACTION) + (1 << (FRACTION - 1))
        if minor < 0:
            slope, first = -slope, first - 1
        step = ((-line if major < 0 else line) << FRACTION) + slope
        several[ray, 0], several[ray, 1] = np.uint64(first), np.uint64(step)
        several[ray, 2] = np.uint64(n + (ends[4, ray] != SILENT))


@_jit
def _add(
    canvas: NDArray[np.int32], endings: NDArray[np.int32], several: NDArray[np.uint64], free: int, more: int
) -> None:
    """Free at each address, more at the last one of a hit."""
    below = np.uint64(FRACTION)
    for ray in range(len(endings)):
        address, step = several[ray, 0], several[ray, 1]
        for _ in range(several[ray, 2]):  # counted, so that the compiler can take several at once
            canvas[np.uintp(address >> below)] += free  # unsigned: no test for an index that counts from the end
            address += step
        if endings[ray] == HIT:
            canvas[np.uintp((address - step) >> below)] += more


@_jit
def _tiles(
    canvas: NDArray[np.int32], start: int, row: int, column: int, ty: int, tx: int, rows: int, columns: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The tiles that have any evidence (``mapping.canvas.Box.tiles``)."""
    keys, cells = np.empty((rows * columns, 2), np.int32), np.empty((rows * columns, TILE, TILE), np.int32)
    count = 0
    for y in range(rows):
        for x in range(columns):
            by_row, by_column = y * TILE * row + x * TILE, start + x * TILE * column + y * TILE
            seen = np.int32(0)
            for j in range(TILE):
                for i in range(TILE):
                    seen |= canvas[np.uintp(by_row + j * row + i)] | canvas[np.uintp(by_column + j * column + i)]
            if not seen:
                continue
            seen = np.int32(0)
            for j in range(TILE):
                for i in range(TILE):
                    units = canvas[np.uintp(by_row + j * row + i)] + canvas[np.uintp(by_column + i * column + j)]
                    cells[np.uintp(count), np.uintp(j), np.uintp(i)] = units
                    seen |= units
            if seen:
                keys[count, 0], keys[count, 1] = ty + y, tx + x
                count += 1
    return keys[:count], cells[:count]
