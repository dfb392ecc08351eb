"""From rays to evidence, with NumPy alone: Bresenham's cells in closed form, counted, weighed.

The k-th cell of a ray of n steps lies at start + round(k * d / n) on each axis, ties away from the start. So all
cells of all rays are one array expression, and the evidence of a batch is two histograms (algorithms 1 and 2):
free * (visits that are no hits) + occupied * hits. A ray with a silent end does not visit its last cell.
``raster_jit`` gives the same integers from compiled loops.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mapping.evidence import EvidenceModel
from mapping.lattice import TILE
from mapping.rays import Rays
from mapping.tiles import Evidence, merged

SHIFT = 26
"""Fraction bits of a ray's slope.

With f = ceil(|d| * 2^26 / n), (k * f + 2^25) >> 26 is exactly the rounded k * |d| / n for all k <= n <= 4096: the exact
value plus a half is a multiple of 1 / (2 n), and the error k * 2^-26 is less than that.
"""

MAX_TILES = 65_536
"""The most tiles that one call may touch (256 MiB): few bytes can describe scans far apart."""

_CHUNK_CELLS = 1 << 19
_CHUNK_TILES = 1 << 20

Raster = Callable[[Rays, EvidenceModel], Evidence]
"""What rays add to a map, without any limit."""


def tile_box(rays: Rays) -> tuple[int, int, int, int]:
    """The box of tiles around some rays (at least one): ty0, tx0, rows, columns."""
    ends = np.concatenate([rays.start, rays.end]) // TILE
    tx0, ty0 = ends.min(axis=0).tolist()
    tx1, ty1 = ends.max(axis=0).tolist()
    return ty0, tx0, ty1 - ty0 + 1, tx1 - tx0 + 1


def in_chunks(rays: Rays, model: EvidenceModel, raster_chunk: Raster) -> Evidence:
    """The evidence of many rays, a chunk at a time, so that memory stays bounded wherever a robot was carried.

    Raises:
        ValueError: they touch more than ``MAX_TILES`` tiles.
    """
    parts = []
    touched = 0
    for chunk in split(rays):
        parts.append(raster_chunk(chunk, model))
        touched += len(parts[-1].keys)
        if touched > MAX_TILES:  # of one chunk or another: how many are there really?
            parts = [merged(parts)]
            touched = len(parts[0].keys)
            if touched > MAX_TILES:
                raise ValueError(f"rays: {len(rays)} of them touch more than {MAX_TILES} tiles")
    return merged(parts)


def split(rays: Rays, most_tiles: int = _CHUNK_TILES) -> list[Rays]:
    """Chunks, in order, that visit few cells and lie close together."""
    if len(rays) < 2:
        return [rays] if len(rays) else []
    _, _, rows, columns = tile_box(rays)
    if rows * columns <= most_tiles and int(rays.steps.sum()) + len(rays) <= _CHUNK_CELLS:
        return [rays]
    half = len(rays) // 2
    return split(rays[:half], most_tiles) + split(rays[half:], most_tiles)


def slopes(rays: Rays) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Steps n (R,), fixed-point slopes f (R, 2) and signs (R, 2) of the rays."""
    d = rays.end - rays.start
    n = rays.steps
    f = -((-np.abs(d) << SHIFT) // np.maximum(n, 1)[:, None])
    return n, f, np.sign(d)


def raster(rays: Rays, model: EvidenceModel) -> Evidence:
    """The evidence of the rays, summed over all of them: occupied at a hit, free before it, nothing behind it.

    At an end without a hit it is free, at a silent one nothing.

    Raises:
        ValueError: they touch more than ``MAX_TILES`` tiles.
    """
    return in_chunks(rays, model, _raster_chunk)


def _raster_chunk(rays: Rays, model: EvidenceModel) -> Evidence:
    _, f, sign = slopes(rays)
    lengths = rays.visits
    ends = np.cumsum(lengths)
    ray = np.repeat(np.arange(len(rays)), lengths)
    k = np.arange(int(ends[-1])) - (ends - lengths)[ray]

    i = rays.start[ray, 0] + sign[ray, 0] * ((k * f[ray, 0] + (1 << SHIFT - 1)) >> SHIFT)
    j = rays.start[ray, 1] + sign[ray, 1] * ((k * f[ray, 1] + (1 << SHIFT - 1)) >> SHIFT)

    ty0, tx0, rows, columns = tile_box(rays)
    tile = (j // TILE - ty0) * columns + (i // TILE - tx0)
    touched = np.zeros(rows * columns, np.bool_)
    touched[tile] = True
    used = np.flatnonzero(touched)
    slot = np.cumsum(touched) - 1
    address = (slot[tile] * TILE + j % TILE) * TILE + i % TILE

    size = len(used) * TILE * TILE
    visits = np.bincount(address, minlength=size)
    hits = np.bincount(address[ends[rays.hit] - 1], minlength=size)
    cells = model.free * (visits - hits) + model.occupied * hits
    keys = np.stack([used // columns + ty0, used % columns + tx0], axis=1)
    return Evidence(keys.astype(np.int32), cells.astype(np.int32).reshape(-1, TILE, TILE))
