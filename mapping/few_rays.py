"""The evidence of few rays, in plain Python: a call of NumPy costs what a dozen cells cost here.

One scan of a small robot is a handful of short rays: arrays would cost what a hundred calls cost, not what they do.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator

import numpy as np

from mapping.canvas import Box
from mapping.cosine import COSINE, Q
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Lattice
from mapping.pose import FULL_TURN
from mapping.rays import FREE, HIT, SILENT, check_beams, fan
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor
from mapping.tiles import Evidence, merged

Ray = tuple[int, int, int, int, int]
"""Cell (i, j) where it starts, cell (i, j) of its end, ending (``mapping.rays.Rays``)."""

_COSINE = array("h", COSINE.astype(np.int16).tobytes())
_QUARTER = FULL_TURN // 4
_ANGLE = FULL_TURN - 1


_RAYS = 32
_VISITS = 512
_AREA = 1 << 16


def raster(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence | None:
    """The evidence of scans (``mapping.raster.raster``), if it is one scan of few short rays that lie close together.

    Raises:
        ValueError: the scans are another sensor's.
    """
    if len(scans) != 1 or len(fan(sensor, lattice).rays) > _RAYS:
        return None
    rays = list(rays_of_one(scans, sensor, lattice))
    if not rays:
        return merged([])
    i, j, to_i, to_j, _ = zip(*rays, strict=True)
    if sum(max(abs(ray[2] - ray[0]), abs(ray[3] - ray[1])) + 1 for ray in rays) > _VISITS:
        return None
    box = Box.around(min(j + to_j), min(i + to_i), max(j + to_j), max(i + to_i))
    return drawn(rays, box, model) if box.area <= _AREA else None


def rays_of_one(scans: Scans, sensor: Sensor, lattice: Lattice) -> Iterator[Ray]:
    """The rays of one scan.

    Raises:
        ValueError: it is another sensor's.
    """
    check_beams(scans, sensor)
    (ranges,), ((x_mm, y_mm, yaw),) = scans.ranges.tolist(), scans.poses.tolist()
    cell = lattice.cell_mm << Q
    x, y = x_mm << Q, y_mm << Q
    c, s = _COSINE[yaw & _ANGLE], _COSINE[yaw - _QUARTER & _ANGLE]
    for beam, ahead_mm, left_mm, bearing, says in fan(sensor, lattice).rays:
        reading = ranges[beam]
        if reading == INVALID:
            continue
        reach, ending = (sensor.max_range_mm, FREE) if reading == NO_RETURN else (reading, says)
        turn = yaw + bearing
        x0, y0 = x + ahead_mm * c - left_mm * s, y + ahead_mm * s + left_mm * c
        x1, y1 = x0 + reach * _COSINE[turn & _ANGLE], y0 + reach * _COSINE[turn - _QUARTER & _ANGLE]
        yield x0 // cell, y0 // cell, x1 // cell, y1 // cell, ending


def drawn(rays: Iterable[Ray], box: Box, model: EvidenceModel) -> Evidence:
    """The evidence of rays in a box.

    Which cells they have is told at ``mapping.raster``; here it is Bresenham's algorithm. The error is counted in
    halves of a step aside, and begins with one, for rounding.
    """
    free, more = model.free, model.occupied - model.free
    row, origin = box.columns * TILE, (box.ty * box.columns * TILE + box.tx) * TILE
    cells = array("i", [0]) * box.area
    for i0, j0, i1, j1, ending in rays:
        di, dj = i1 - i0, j1 - j0
        across, up = abs(di), abs(dj)
        along, aside = (1 if di > 0 else -1), (row if dj > 0 else -row)
        n, d = across, up
        if up > across:
            n, d, along, aside = up, across, aside, along
        address, error = j0 * row + i0 - origin, n
        for _ in range(n + (ending != SILENT)):
            cells[address] += free
            address += along
            error += 2 * d
            if error >= 2 * n:
                address += aside
                error -= 2 * n
        if ending == HIT:
            cells[j1 * row + i1 - origin] += more
    return box.tiles(np.frombuffer(cells, np.int32).reshape(-1, row))
