"""From scans to evidence, with NumPy alone: rays onto a canvas of cells, the canvas as tiles.

The evidence of a batch (algorithms 1 and 2) is two sums over the cells of its rays: free for every visit, and what
occupied is worth more than that for every hit. A ray with a silent end does not visit its last cell.

What makes it fast, here and in ``raster_jit``, which gives the same integers from compiled loops:

* the cells lie in a plain array as large as the batch's box, so that no ray is cut at tiles' borders and no cell is
  looked up; tiles are made of it once a batch. It costs its area, so a batch that is spread thinly is halved;
* on it a ray is an arithmetic progression (``mapping.canvas``): no division, no product, no branch from cell to cell;
* sums have no bound (``EvidenceModel.limit`` is applied afterwards), so that a visit is one addition. Here not even
  that: a ray is drawn by its corners, of which there are fewer (``mapping.corners``).

One scan of a few short rays would cost what the calls of NumPy cost, not what these do: it is left to plain Python
(``mapping.few_rays``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from mapping import few_rays
from mapping.canvas import Box
from mapping.corners import Drawing
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Lattice
from mapping.rays import Rays, fan, rays_of
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
_RAYS = 1 << 14


def raster(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
    """The evidence of scans, summed over all of them: the kernel that needs nothing but NumPy.

    Raises:
        ValueError: the scans are another sensor's, or touch more than ``MAX_TILES`` tiles.
    """
    few = few_rays.raster(scans, sensor, lattice, model)
    return gathered(_parts(scans, sensor, lattice, model)) if few is None else few


def raster_rays(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of rays: occupied at a hit, free before it, nothing behind it.

    At an end without a hit it is free, at a silent one nothing.

    Raises:
        ValueError: they touch more than ``MAX_TILES`` tiles.
    """
    return gathered(_drawn([rays[k : k + _RAYS] for k in range(0, len(rays), _RAYS)], model))


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
        some = max(1, _RAYS // len(fan(sensor, lattice).beam))
        yield from _drawn([rays_of(scans[k : k + some], sensor, lattice) for k in range(0, len(scans), some)], model)
        return
    half = len(scans) // 2
    yield from _parts(scans[:half], sensor, lattice, model)
    yield from _parts(scans[half:], sensor, lattice, model)


def box_of(batches: Sequence[Rays]) -> Box:
    """The tiles around some rays (at least one)."""
    ends = [cells.T for rays in batches for cells in (rays.start, rays.end) if len(rays)]
    low_i, low_j = np.min([cells.min(axis=1) for cells in ends], axis=0).tolist()
    high_i, high_j = np.max([cells.max(axis=1) for cells in ends], axis=0).tolist()
    return Box.around(low_j, low_i, high_j, high_i)


def _drawn(batches: Sequence[Rays], model: EvidenceModel) -> Iterator[Evidence]:
    """The evidence of rays, of which those that lie far apart come in parts: each is as large as its rays are worth."""
    count = sum(map(len, batches))
    if count <= 1:
        yield from (_alone(rays, model) for rays in batches if len(rays))
        return
    box = box_of(batches)
    if is_worth_its_area(box.area, sum(int(rays.visits.sum()) for rays in batches)):
        drawing = Drawing(box, model)
        for rays in batches:
            drawing.add(rays)
        yield drawing.evidence()
        return
    if len(batches) == 1:
        (rays,) = batches
        batches = rays[: count // 2], rays[count // 2 :]
    half = len(batches) // 2
    yield from _drawn(batches[:half], model)
    yield from _drawn(batches[half:], model)


def _alone(ray: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of one ray, whose box may be large and all but empty.

    Cell k of a ray of n steps lies k / n of the way from its first to its last, on either axis rounded to the nearest
    whole number, ties away from the start.
    """
    (start,), (end,), (n,) = ray.start, ray.end, ray.steps
    k = np.arange(ray.visits[0])[:, None]
    cells = start + np.sign(end - start) * ((2 * k * np.abs(end - start) + n) // max(2 * n, 1))
    keys, slots = np.unique(cells[:, ::-1] // TILE, axis=0, return_inverse=True)
    tiles = np.zeros((len(keys), TILE, TILE), np.int32)
    i, j = cells.T % TILE
    tiles[slots.reshape(-1), j, i] = np.where(ray.hit & (k[:, 0] == n), model.occupied, model.free)
    return Evidence(keys.astype(np.int32), tiles)
