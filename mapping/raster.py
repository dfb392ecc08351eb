"""From scans to evidence, with NumPy alone: rays onto a canvas of cells, the canvas as tiles.

The evidence of a batch (algorithms 1 and 2) is two sums over the cells of its rays: free for every visit, and what
occupied is worth more than that for every hit. A ray with a silent end does not visit its last cell.

Few rays, such as one scan of a small robot, would cost what the calls of NumPy cost, not what these do; and one long
ray alone would need a canvas of nothing. So their cells come one by one, in plain Python (``_few``).

What makes it fast, here and in ``raster_jit``, which gives the same integers from compiled loops:

* the cells lie in a plain array as large as the batch's box, so that no ray is cut at tiles' borders and no cell is
  looked up; tiles are made of it once a batch. It costs its area, so a batch that is spread thinly is halved;
* on it a ray is an arithmetic progression (``mapping.canvas``): no division, no product, no branch from cell to cell;
* sums have no bound (``EvidenceModel.limit`` is applied afterwards), so that a visit is one addition.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from mapping.canvas import FRACTION, Box, box_of, progressions, tiles_of
from mapping.evidence import EvidenceModel
from mapping.lattice import MAX_RAY_CELLS, TILE, Lattice
from mapping.rays import HIT, SILENT, Rays, fan, rays_of
from mapping.scan import Scans
from mapping.sensor import Sensor
from mapping.tiles import Evidence, merged

MAX_TILES = 65_536
"""The most tiles that one call may touch (256 MiB): few bytes can describe scans far apart."""

Raster = Callable[[Scans, Sensor, Lattice, EvidenceModel], Evidence]
"""What scans add to a map, without any limit."""

BATCH = 1 << 20
"""The most rays that go onto a canvas together."""

_AREA = 1 << 16
_AREA_A_VISIT = 64
_MOST_AREA = 1 << 22
_FEW = 1 << 8
_CACHE = 1 << 13
_CELLS = 1 << 16
_BELOW = np.uint64(FRACTION)
_K = np.arange(MAX_RAY_CELLS + 1)[:, None]
_NOTHING = bytes(4 * TILE * TILE)


def raster(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
    """The evidence of scans, summed over all of them: the kernel that needs nothing but NumPy.

    Raises:
        ValueError: the scans are another sensor's, or touch more than ``MAX_TILES`` tiles.
    """
    if len(scans) == 1:
        return gathered(_drawn(rays_of(scans, sensor, lattice), model))
    return gathered(_parts(scans, sensor, lattice, model))


def raster_rays(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of rays: occupied at a hit, free before it, nothing behind it.

    At an end without a hit it is free, at a silent one nothing.

    Raises:
        ValueError: they touch more than ``MAX_TILES`` tiles.
    """
    return gathered(_drawn(rays, model))


def gathered(parts: Iterable[Evidence]) -> Evidence:
    """The sum of parts, which are made as they are taken: no more tiles are held than one call may touch.

    Raises:
        ValueError: they touch more.
    """
    kept: list[Evidence] = []
    touched = 0
    for part in parts:
        kept.append(part)
        touched += len(part.keys)
        if touched > MAX_TILES:  # of one part or another: how many are there really?
            kept = [bounded(merged(kept))]
            touched = len(kept[0].keys)
    return merged(kept)


def bounded(evidence: Evidence) -> Evidence:
    """The evidence, if it touches no more tiles than one call may.

    Raises:
        ValueError: it does.
    """
    if len(evidence.keys) > MAX_TILES:
        raise ValueError(f"rays: they touch more than {MAX_TILES} tiles")
    return evidence


def fits_a_call(scans: Scans, sensor: Sensor, lattice: Lattice) -> bool:
    """Whether scans are few enough to go through the stages together."""
    return len(scans) <= 1 or len(scans) * len(fan(sensor, lattice).beam) <= BATCH


def is_worth_its_area(area: int, visits: int) -> bool:
    """Whether rays that visit so many cells may be drawn onto one canvas of that area."""
    return area <= _AREA or area <= min(_AREA + _AREA_A_VISIT * visits, _MOST_AREA)


def _parts(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Iterator[Evidence]:
    if fits_a_call(scans, sensor, lattice):
        some = max(1, _CACHE // len(fan(sensor, lattice).beam))
        batches = [rays_of(scans[k : k + some], sensor, lattice) for k in range(0, len(scans), some)]
        if batches:
            yield from _drawn(Rays.join(batches), model)
        return
    half = len(scans) // 2
    yield from _parts(scans[:half], sensor, lattice, model)
    yield from _parts(scans[half:], sensor, lattice, model)


def _drawn(rays: Rays, model: EvidenceModel) -> Iterator[Evidence]:
    """The evidence of rays, of which those that lie far apart come in parts: each is as large as its rays are worth."""
    visits = int(rays.visits.sum())
    if visits <= _FEW:
        yield _few(rays, model)
        return
    box = box_of(rays)
    if is_worth_its_area(box.area, visits):
        canvas = box.canvas()
        _add(canvas, rays, box, model)
        yield tiles_of(canvas, box)
        return
    if len(rays) == 1:
        yield _few(rays, model)
        return
    half = len(rays) // 2
    yield from _drawn(rays[:half], model)
    yield from _drawn(rays[half:], model)


def _add(canvas: NDArray[np.int32], rays: Rays, box: Box, model: EvidenceModel) -> None:
    """Rays of about the same length together are arrays of shape (cells, rays) with few cells too many."""
    batches = [progressions(rays[k : k + _CACHE], box) for k in range(0, len(rays), _CACHE)]
    first, step, visits = map(np.concatenate, zip(*batches, strict=True))
    last = (first + np.maximum(visits - 1, 0).view(np.uint64) * step) >> _BELOW
    np.add.at(canvas, last.view(np.intp), rays.hit * np.int32(model.occupied - model.free))

    order = np.argsort(-visits.astype(np.int16), kind="stable")
    first, step, visits = first[order], step[order], visits[order]
    memory, free = np.empty(_CELLS, np.uint64), np.int32(model.free)
    begin = 0
    while begin < len(order) and (longest := int(visits[begin])):
        some = slice(begin, begin + max(1, _CELLS // longest))
        begin, lengths = some.stop, visits[some]
        addresses = memory[: longest * len(lengths)].reshape(longest, -1)
        np.multiply(_K[:longest].view(np.uint64), step[some], out=addresses)
        addresses += first[some]
        addresses >>= _BELOW
        cells, common = addresses.view(np.intp), int(lengths[-1])  # so many all of them have
        np.add.at(canvas, cells[:common].ravel(), free)
        if common < longest:
            np.add.at(canvas, cells[common:][_K[common:longest] < lengths], free)


def _few(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of few cells, wherever they are.

    The k-th cell of a ray of n steps lies k / n of the way from its first to its last, on either axis rounded to the
    nearest whole number, ties away from the start.
    """
    tiles: dict[tuple[int, int], array[int]] = {}
    for (i, j), (to_i, to_j), ending in zip(rays.start.tolist(), rays.end.tolist(), rays.ending.tolist(), strict=True):
        steep = abs(to_j - j) > abs(to_i - i)
        (major, minor), (to_major, to_minor) = ((j, i), (to_j, to_i)) if steep else ((i, j), (to_i, to_j))
        n, d, way = abs(to_major - major), abs(to_minor - minor), 1 if to_major > major else -1
        sign = 1 if to_minor > minor else -1
        last = n if ending == HIT else -1
        for k in range(n + (ending != SILENT)):
            along, aside = major + way * k, minor + sign * ((2 * k * d + n) // (2 * n) if n else 0)
            y, x = (along, aside) if steep else (aside, along)
            key = y // TILE, x // TILE
            if (tile := tiles.get(key)) is None:
                tile = tiles[key] = array("i", _NOTHING)
            tile[y % TILE * TILE + x % TILE] += model.occupied if k == last else model.free
    keys = sorted(key for key, tile in tiles.items() if any(tile))
    cells = np.frombuffer(b"".join(tiles[key] for key in keys), np.int32).reshape(-1, TILE, TILE)
    return Evidence(np.array(keys, np.int32).reshape(-1, 2), cells)
