"""From scans to evidence with compiled loops (numba, extra ``fast``): the same integers as ``raster``, sooner.

The same stages as there, each a jitted function: strokes, their box, addresses and additions, tiles. A call from Python
costs microseconds, mostly for the arrays that go in and out; so scans that need one box alone, as most updates do, go
through all stages in one call (``_at_once``). Compiled code is cached beside this file, so that only the first process
on a machine compiles.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from mapping.cosine import COSINE, Q
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Lattice
from mapping.pose import FULL_TURN
from mapping.raster import BATCH, bounded, in_batches, in_boxes, is_worth_its_area
from mapping.rays import FREE, HIT, SILENT, Rays, fan
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from mapping.strokes import LENGTH, SHIFT, STROKE, Box, Strokes
from mapping.tiles import Evidence

_LANES = 16
_BUFFER = 1 << 13
_COSINE = COSINE.astype(np.int16)  # a quarter of the cache
_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


def raster(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
    """The evidence of scans; see ``mapping.raster.raster``."""
    if scans.beams != len(sensor.beams):
        raise ValueError(f"rays: {scans.beams} readings a scan cannot be broadcast to {len(sensor.beams)} beams")
    beams, reach, scale = fan(sensor, lattice).table, sensor.max_range_mm, lattice.cell_mm << Q
    if len(scans) * beams.shape[1] <= BATCH:
        fits, keys, cells = _at_once(
            scans.poses, scans.ranges, beams, _COSINE, reach, scale, model.free, model.occupied - model.free
        )
        if fits:
            return bounded(Evidence(keys, cells))
    batches = (
        _of_scans(some.poses, some.ranges, beams, _COSINE, reach, scale) for some in in_batches(scans, sensor, lattice)
    )
    return in_boxes(batches, model, _box_of, _draw)


def raster_rays(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of rays; see ``mapping.raster.raster_rays``."""
    start, end, ending = (np.ascontiguousarray(each, np.int64) for each in (rays.start, rays.end, rays.ending))
    return in_boxes([_of_rays(start, end, ending)], model, _box_of, _draw)


@_jit
def _floor(coordinate: int, per_cell: float) -> int:
    return int(np.floor((coordinate + 0.5) * per_cell))  # exact: what is not whole is farther away than doubles err


@_jit
def _of_scans(
    poses: NDArray[np.int32],
    ranges: NDArray[np.uint16],
    beams: NDArray[np.int64],
    table: NDArray[np.int16],
    max_range_mm: int,
    scale: int,
) -> Strokes:
    beam, x_mm, y_mm, bearing, endings = beams
    pieces = (max_range_mm << Q) // (scale * LENGTH) + 1
    strokes = np.empty(len(poses) * len(beam) * pieces, STROKE)
    count = 0
    per_cell = 1.0 / scale
    for scan in range(len(poses)):
        x, y, yaw = np.int64(poses[scan, 0]) << Q, np.int64(poses[scan, 1]) << Q, np.int64(poses[scan, 2])
        c, s = np.int64(table[yaw & (FULL_TURN - 1)]), np.int64(table[(yaw - FULL_TURN // 4) & (FULL_TURN - 1)])
        for ray in range(len(beam)):
            reading = ranges[scan, beam[ray]]
            if reading == INVALID:
                continue
            reach, ending = int(reading), int(endings[ray])
            if reading == NO_RETURN:
                reach, ending = max_range_mm, FREE
            angle = yaw + bearing[ray]
            x0 = x + x_mm[ray] * c - y_mm[ray] * s
            y0 = y + x_mm[ray] * s + y_mm[ray] * c
            x1 = x0 + reach * table[angle & (FULL_TURN - 1)]
            y1 = y0 + reach * table[(angle - FULL_TURN // 4) & (FULL_TURN - 1)]
            count = _cut_ray(
                _floor(x0, per_cell),
                _floor(y0, per_cell),
                _floor(x1, per_cell),
                _floor(y1, per_cell),
                ending,
                strokes,
                count,
            )
    return strokes[:count]


@_jit
def _cut_ray(i0: int, j0: int, i1: int, j1: int, ending: int, strokes: Strokes, count: int) -> int:
    """Append one ray's strokes (``mapping.strokes.strokes_of``)."""
    di, dj = i1 - i0, j1 - j0
    steep = abs(dj) > abs(di)
    n, d = max(abs(di), abs(dj)), min(abs(di), abs(dj))
    sign_i, sign_j = np.sign(di), np.sign(dj)
    major_i, minor_i = (0, sign_i) if steep else (sign_i, 0)
    major_j, minor_j = (sign_j, 0) if steep else (0, sign_j)
    visits = n + (ending != SILENT)
    n = max(n, 1)
    slope = np.int32(np.ceil((d << SHIFT) / n))
    intercept, whole = 1 << (SHIFT - 1), 0
    first = 0
    while first < visits:
        if first:
            v = 2 * first * d + n
            whole = v // (2 * n)
            intercept = int(np.ceil(((v - whole * 2 * n) << SHIFT) / (2 * n)))
        stroke = strokes[count]
        stroke.i = i0 + first * major_i + whole * minor_i
        stroke.j = j0 + first * major_j + whole * minor_j
        stroke.intercept, stroke.slope = intercept, slope
        stroke.visits = min(visits - first, LENGTH)
        stroke.major_i, stroke.major_j, stroke.minor_i, stroke.minor_j = major_i, major_j, minor_i, minor_j
        stroke.hit = ending == HIT and visits - first <= LENGTH
        count += 1
        first += LENGTH
    return count


@_jit
def _of_rays(start: NDArray[np.int64], end: NDArray[np.int64], ending: NDArray[np.int64]) -> Strokes:
    most = 0
    for ray in range(len(ending)):
        n = max(abs(end[ray, 0] - start[ray, 0]), abs(end[ray, 1] - start[ray, 1]))
        most += n // LENGTH + 1
    strokes = np.empty(most, STROKE)
    count = 0
    for ray in range(len(ending)):
        count = _cut_ray(start[ray, 0], start[ray, 1], end[ray, 0], end[ray, 1], ending[ray], strokes, count)
    return strokes[:count]


def _box_of(strokes: Strokes) -> Box:
    return Box(*_box(strokes))


@_jit
def _box(strokes: Strokes) -> tuple[int, int, int, int]:
    low_i = high_i = strokes[0].i
    low_j = high_j = strokes[0].j
    for s in range(len(strokes)):
        stroke = strokes[s]
        last = stroke.visits - 1
        aside = (stroke.intercept + last * stroke.slope) >> SHIFT
        i = stroke.i + last * stroke.major_i + aside * stroke.minor_i
        j = stroke.j + last * stroke.major_j + aside * stroke.minor_j
        low_i, high_i = min(low_i, stroke.i, i), max(high_i, stroke.i, i)
        low_j, high_j = min(low_j, stroke.j, j), max(high_j, stroke.j, j)
    ty, tx = low_j // TILE, low_i // TILE
    return ty, tx, high_j // TILE - ty + 1, high_i // TILE - tx + 1


def _draw(batches: list[Strokes], box: Box, model: EvidenceModel) -> Evidence:
    cells = np.zeros(box.rows * TILE * box.stride, np.int32)
    for strokes in batches:
        _add(cells, strokes, box.ty * TILE, box.tx * TILE, box.stride, model.free, model.occupied - model.free)
    return Evidence(*_cut(cells, box.stride, *box))


@_jit
def _fill(
    addresses: NDArray[np.int32],
    visits: np.int32,
    start: np.int32,
    major: np.int32,
    minor: np.int32,
    intercept: np.int32,
    slope: np.int32,
) -> None:
    """A stroke's addresses, run over to whole vectors; the next stroke writes over what is too much.

    A loop of its own and int32 throughout, so that it compiles to vector instructions: numba computes in int64 wherever
    it is not told otherwise.
    """
    for k in range((visits + _LANES - 1) & -_LANES):
        aside = np.int32(np.int32(intercept + np.int32(np.int32(k) * slope)) >> np.int32(SHIFT))
        addresses[k] = np.int32(start + np.int32(np.int32(k) * major) + np.int32(aside * minor))


@_jit
def _scatter(cells: NDArray[np.int32], addresses: NDArray[np.int32], filled: int, units: int) -> None:
    for m in range(filled):
        cells[np.uintp(addresses[m])] += units  # unsigned: no test for an index that counts from the end


@_jit
def _add(cells: NDArray[np.int32], strokes: Strokes, j0: int, i0: int, stride: int, free: int, more: int) -> None:
    addresses = np.empty(_BUFFER + LENGTH + _LANES, np.int32)
    filled = 0
    for s in range(len(strokes)):
        stroke = strokes[s]
        start = np.int32((stroke.j - j0) * stride + stroke.i - i0)
        major = np.int32(stroke.major_j * stride + stroke.major_i)
        minor = np.int32(stroke.minor_j * stride + stroke.minor_i)
        _fill(addresses[filled:], np.int32(stroke.visits), start, major, minor, stroke.intercept, stroke.slope)
        filled += stroke.visits
        if stroke.hit:
            cells[np.uintp(addresses[filled - 1])] += more
        if filled > _BUFFER:
            _scatter(cells, addresses, filled, free)
            filled = 0
    _scatter(cells, addresses, filled, free)


@_jit
def _cut(
    cells: NDArray[np.int32], stride: int, ty: int, tx: int, rows: int, columns: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    corners = np.empty(rows * columns, np.int64)  # of the tiles that have any evidence
    count = 0
    for row in range(rows):
        for column in range(columns):
            corner = row * TILE * stride + column * TILE
            seen = np.int32(0)
            for j in range(TILE):
                for i in range(TILE):
                    seen |= cells[np.uintp(corner + j * stride + i)]
            if seen:
                corners[count] = corner
                count += 1
    keys = np.empty((count, 2), np.int32)
    tiles = np.empty((count, TILE, TILE), np.int32)
    for kept in range(count):
        row, column = corners[kept] // (TILE * stride), corners[kept] % stride // TILE
        keys[kept, 0], keys[kept, 1] = ty + row, tx + column
        for j in range(TILE):
            for i in range(TILE):
                tiles[np.uintp(kept), np.uintp(j), np.uintp(i)] = cells[np.uintp(corners[kept] + j * stride + i)]
    return keys, tiles


_is_worth_its_area = _jit(is_worth_its_area)


@_jit
def _at_once(
    poses: NDArray[np.int32],
    ranges: NDArray[np.uint16],
    beams: NDArray[np.int64],
    table: NDArray[np.int16],
    max_range_mm: int,
    scale: int,
    free: int,
    more: int,
) -> tuple[bool, NDArray[np.int32], NDArray[np.int32]]:
    """The evidence of scans, if one box for all of them is worth its area."""
    strokes = _of_scans(poses, ranges, beams, table, max_range_mm, scale)
    fits = len(strokes) > 0
    ty = tx = rows = columns = 0
    if fits:
        ty, tx, rows, columns = _box(strokes)
        visits = 0
        for s in range(len(strokes)):
            visits += strokes[s].visits
        fits = _is_worth_its_area(rows * columns * TILE * TILE, visits)
    if not fits:
        return False, np.empty((0, 2), np.int32), np.empty((0, TILE, TILE), np.int32)
    stride = columns * TILE + TILE // 2
    cells = np.zeros(rows * TILE * stride, np.int32)
    _add(cells, strokes, ty * TILE, tx * TILE, stride, free, more)
    keys, tiles = _cut(cells, stride, ty, tx, rows, columns)
    return True, keys, tiles
