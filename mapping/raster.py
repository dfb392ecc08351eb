"""From scans to evidence, with NumPy alone: rays as strokes, strokes onto a dense box of cells, the box as tiles.

The evidence of a batch (algorithms 1 and 2) is two sums over the cells of its rays: free for every visit, and what
occupied is worth more than that for every hit. A ray with a silent end does not visit its last cell.

Few rays, such as one scan of a small robot, cost what the calls of NumPy cost, not what these do. So their cells come
from the definition in one expression (``_direct``), at a division a visit; many rays are worth the way to strokes.

What makes it fast, here and in ``raster_jit``, which gives the same integers from compiled loops:

* two passes: first the addresses of many cells in one affine expression without a branch (``mapping.strokes``), then
  one loop that does nothing but add to them;
* the cells lie in a plain array as large as the batch's box, so that no ray is cut at tiles' borders and no cell is
  looked up; tiles are cut out of it once a batch. The box costs its area, so a batch that is spread thinly is halved;
* sums have no bound (``EvidenceModel.limit`` is applied afterwards), so that a visit is one addition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Lattice
from mapping.rays import SILENT, Rays, fan, rays_of
from mapping.scan import Scans
from mapping.sensor import Sensor
from mapping.strokes import LENGTH, SHIFT, Box, Strokes, box_of, strokes_of
from mapping.tiles import Evidence, merged

MAX_TILES = 65_536
"""The most tiles that one call may touch (256 MiB): few bytes can describe scans far apart."""

Raster = Callable[[Scans, Sensor, Lattice, EvidenceModel], Evidence]
"""What scans add to a map, without any limit."""

BATCH = 1 << 15
"""Rays that go through the stages together: few enough for the cache, many enough for NumPy."""

_AREA = 1 << 16
_AREA_A_VISIT = 64
_MOST_AREA = 1 << 22
_LANES = 16
_FEW = 1 << 10
_K = np.arange(LENGTH, dtype=np.int32)[:, None]
_FEW_RAYS = 1 << 7
_FEW_CELLS = 1 << 12
_ALONG = np.arange(_FEW_CELLS + 1)[:, None]


def raster(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
    """The evidence of scans, summed over all of them: the kernel that needs nothing but NumPy.

    Raises:
        ValueError: the scans are another sensor's, or touch more than ``MAX_TILES`` tiles.
    """
    if len(scans) * len(fan(sensor, lattice).beam) <= _FEW_RAYS:
        return raster_rays(rays_of(scans, sensor, lattice), model)
    batches = (strokes_of(rays_of(some, sensor, lattice)) for some in in_batches(scans, sensor, lattice))
    return in_boxes(batches, model, box_of, _draw)


def raster_rays(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of rays: occupied at a hit, free before it, nothing behind it.

    At an end without a hit it is free, at a silent one nothing.

    Raises:
        ValueError: they touch more than ``MAX_TILES`` tiles.
    """
    if 0 < len(rays) <= _FEW_RAYS and (evidence := _direct(rays, model)) is not None:
        return bounded(evidence)
    return in_boxes([strokes_of(rays)], model, box_of, _draw)


def _direct(rays: Rays, model: EvidenceModel) -> Evidence | None:
    """The evidence of few short rays (one at least) that share a box which is worth its area; None of others.

    The k-th cell of a ray of n steps lies k / n of the way from its first to its last, on either axis rounded to the
    nearest whole number, ties away from the start. A ray that is shorter than the longest waits at its end for nothing.
    """
    start, end = rays.start.T, rays.end.T
    way = end - start
    far = np.abs(way)
    n = np.maximum(far[0], far[1])
    visits = n + (rays.ending != SILENT)
    longest = int(n.max())
    corners = np.concatenate([start, end], axis=1) // TILE
    tx, ty = corners.min(axis=1).tolist()
    last_tx, last_ty = corners.max(axis=1).tolist()
    box = Box(ty, tx, last_ty - ty + 1, last_tx - tx + 1)
    if len(rays) * longest > _FEW_CELLS or not is_worth_its_area(box.area, int(visits.sum())):
        return None

    k, half = _ALONG[: longest + 1], np.maximum(n, 1)
    units = (k < visits) * np.int32(model.free)  # of each step of each ray
    units[-1] += rays.hit * np.int32(model.occupied - model.free)
    aside_i, aside_j = (np.minimum(k, n) * (2 * far[:, None]) + half) // (2 * half)
    sign_i, sign_j = np.sign(way)
    first = (start[1] - ty * TILE) * box.stride + (start[0] - tx * TILE)
    addresses = first + aside_i * sign_i + aside_j * (sign_j * box.stride)
    cells = np.zeros(box.rows * TILE * box.stride, np.int32)
    np.add.at(cells, addresses.ravel(), units.ravel())
    return _cut(cells, box)


def in_batches(scans: Scans, sensor: Sensor, lattice: Lattice) -> Iterator[Scans]:
    """Scans with about ``BATCH`` rays at a time, one at least."""
    size = max(1, BATCH // len(fan(sensor, lattice).beam))
    return (scans[first : first + size] for first in range(0, len(scans), size))


def in_boxes(
    batches: Iterable[Strokes],
    model: EvidenceModel,
    box_of: Callable[[Strokes], Box],
    draw: Callable[[list[Strokes], Box, EvidenceModel], Evidence],
) -> Evidence:
    """The evidence of many strokes, drawn a box at a time, so that memory stays bounded wherever a robot was carried.

    Args:
        batches: strokes in the order of their scans, so that neighbours lie close together.
        model: what readings are worth.
        box_of: as ``mapping.strokes.box_of``.
        draw: the evidence of all strokes in a list, given the box around them.

    Raises:
        ValueError: they touch more than ``MAX_TILES`` tiles.
    """
    parts: list[Evidence] = []
    touched = 0
    for together, box in _grouped([(strokes, box_of(strokes)) for strokes in batches if len(strokes)], box_of):
        parts.append(draw(together, box, model))
        touched += len(parts[-1].keys)
        if touched > MAX_TILES:  # of one part or another: how many are there really?
            parts = [bounded(merged(parts))]
            touched = len(parts[0].keys)
    return merged(parts)


def bounded(evidence: Evidence) -> Evidence:
    """The evidence, if it touches no more tiles than one call may.

    Raises:
        ValueError: it does.
    """
    if len(evidence.keys) > MAX_TILES:
        raise ValueError(f"rays: they touch more than {MAX_TILES} tiles")
    return evidence


def is_worth_its_area(area: int, visits: int) -> bool:
    """Whether strokes that visit so many cells may be drawn onto one box of that area."""
    return area <= _AREA or area <= min(_AREA + _AREA_A_VISIT * visits, _MOST_AREA)


def _grouped(
    batches: list[tuple[Strokes, Box]], box_of: Callable[[Strokes], Box]
) -> Iterator[tuple[list[Strokes], Box]]:
    """Strokes that share a box which is worth its area in visits, or small anyhow."""
    if not batches:
        return
    box = Box.around([box for _, box in batches])
    visits = sum(int(strokes["visits"].sum()) for strokes, _ in batches)
    if not is_worth_its_area(box.area, visits) and len(batches) + len(batches[0][0]) > 2:
        if len(batches) == 1:
            ((strokes, _),) = batches
            batches = [(half, box_of(half)) for half in np.array_split(strokes, 2)]
        half = len(batches) // 2
        yield from _grouped(batches[:half], box_of)
        yield from _grouped(batches[half:], box_of)
        return
    yield [strokes for strokes, _ in batches], box


def _draw(batches: list[Strokes], box: Box, model: EvidenceModel) -> Evidence:
    cells = np.zeros(box.rows * TILE * box.stride, np.int32)
    for strokes in batches:
        _add(cells, strokes, box, model)
    return _cut(cells, box)


def _add(cells: NDArray[np.int32], strokes: Strokes, box: Box, model: EvidenceModel) -> None:
    """Strokes of about the same length together are arrays of shape (lanes, strokes) with few lanes too many."""
    stride, spread = np.int32(box.stride), _LANES if len(strokes) > _FEW else LENGTH
    order = np.argsort(strokes["visits"], kind="stable")
    visits, intercept, slope, hit = (strokes[name].take(order) for name in ("visits", "intercept", "slope", "hit"))
    start = ((strokes["j"] - np.int32(box.ty * TILE)) * stride + (strokes["i"] - np.int32(box.tx * TILE))).take(order)
    major = (strokes["major_j"] * stride + strokes["major_i"]).take(order)
    minor = (strokes["minor_j"] * stride + strokes["minor_i"]).take(order)
    first = 0
    while first < len(order):
        longest = -(-int(visits[first]) // spread) * spread
        some = slice(first, int(visits.searchsorted(np.int16(longest), side="right")))
        first = some.stop
        k = _K[: int(visits[first - 1])]
        addresses = k * slope[some]
        addresses += intercept[some]
        addresses >>= SHIFT
        addresses *= minor[some]
        addresses += start[some]
        addresses += k * major[some]
        common = max(0, longest - spread)  # lanes that all of them have
        np.add.at(cells, addresses[:common].ravel().astype(np.intp), np.int32(model.free))
        np.add.at(cells, addresses[common:][k[common:] < visits[some]].astype(np.intp), np.int32(model.free))
    hits = np.flatnonzero(hit)
    last = visits[hits] - np.int32(1)
    aside = (intercept[hits] + last * slope[hits]) >> SHIFT
    addresses = start[hits] + last * major[hits] + aside * minor[hits]
    np.add.at(cells, addresses.astype(np.intp), np.int32(model.occupied - model.free))


def _cut(cells: NDArray[np.int32], box: Box) -> Evidence:
    """The tiles of a box that have any evidence."""
    tiles = cells.reshape(box.rows, TILE, -1)[:, :, : box.columns * TILE]
    known = np.bitwise_or.reduce(tiles, axis=1).reshape(box.rows, box.columns, TILE).any(axis=2)
    rows, columns = np.nonzero(known)
    tiles = tiles.reshape(box.rows, TILE, box.columns, TILE)[rows, :, columns]
    return Evidence(np.stack([rows + box.ty, columns + box.tx], axis=1).astype(np.int32), tiles)
