"""Sparse maps: a dictionary of tiles, their sum, and the digest by which peers compare them.

Laws kept here: a tile's array is never written after it was handed out (copy on write), so a state can be kept by
keeping its dictionary; the sum is plain int32 addition, hence the same in any order.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.lattice import TILE, Cells, TileKey

Tiles = Mapping[TileKey, Cells]
"""A sparse map. A tile that is absent is all zero: nothing is known there."""

_KEY = struct.Struct("<ii")


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a batch of scans adds to a map: one array for all tiles that it touches.

    Attributes:
        keys: int32, shape (T, 2): ty, tx; no tile twice, in ascending order.
        cells: int32, shape (T, 32, 32).
    """

    keys: NDArray[np.int32]
    cells: NDArray[np.int32]

    def __iter__(self) -> Iterator[tuple[TileKey, Cells]]:
        return zip(map(TileKey._make, self.keys.tolist()), self.cells, strict=True)


def frozen(cells: Cells) -> Cells:
    """The array, made read-only: it may be shared from now on."""
    cells.setflags(write=False)
    return cells


def merged(parts: list[Evidence]) -> Evidence:
    """The sum of several batches' evidence as one."""
    if not parts:
        return Evidence(np.zeros((0, 2), np.int32), np.zeros((0, TILE, TILE), np.int32))
    if len(parts) == 1:
        return parts[0]
    keys = np.concatenate([part.keys for part in parts])
    unique, slots = np.unique(keys, axis=0, return_inverse=True)
    slots = slots.reshape(-1)  # NumPy 2.0.0 gives a column
    cells = np.zeros((len(unique), TILE, TILE), np.int32)
    first = 0
    for part in parts:
        cells[slots[first : first + len(part.keys)]] += part.cells  # no tile twice within a part
        first += len(part.keys)
    return Evidence(unique, cells)


def added(tiles: Tiles, evidence: Evidence, limit: int = 0) -> dict[TileKey, Cells]:
    """The tiles that evidence touches, with their contents after it is added to a map; ``tiles`` is left alone.

    Args:
        tiles: the map before.
        evidence: of one scan if there is a limit, else of any number.
        limit: 0, or the bound that every cell is held within afterwards (``EvidenceModel.limit``).
    """
    touched: dict[TileKey, Cells] = {}
    for key, delta in evidence:
        before = tiles.get(key)
        after = delta.copy() if before is None else before + delta
        if limit:
            np.maximum(after, -limit, out=after)  # np.clip takes three times as long to begin
            np.minimum(after, limit, out=after)
        touched[key] = frozen(after)
    return touched


def total(tiles: Sequence[Cells]) -> Cells:
    """The sum of some tiles (at least one).

    Tiles lie anywhere in memory, and an addition of two costs less than its call. So they are laid side by side first:
    a copy each, which is cheap, and one call for all. It must be told to stay int32, or it takes four times as long.
    """
    beside = np.frombuffer(b"".join(tiles), np.int32)  # type: ignore[arg-type]  # an array is a buffer
    sums: Cells = np.add.reduce(beside.reshape(len(tiles), TILE * TILE), axis=0, dtype=np.int32)
    return sums.reshape(TILE, TILE)


def summed(maps: Iterable[Tiles]) -> dict[TileKey, Cells]:
    """The sum of maps, tile by tile: made anew, for checks and small maps (``swarm.fusion`` keeps one up to date)."""
    together: dict[TileKey, list[Cells]] = {}
    for tiles in maps:
        for key, cells in tiles.items():
            together.setdefault(key, []).append(cells)
    return {key: total(several) for key, several in together.items()}


def map_digest(tiles: Tiles) -> bytes:
    """BLAKE2b-128 over the tiles that have a non-zero cell, in order of (ty, tx).

    Each contributes ty and tx as little-endian int32, then its 1024 cells as little-endian int32, row-major.
    """
    state = hashlib.blake2b(digest_size=16)
    for key in sorted(tiles):
        cells = tiles[key]
        if cells.any():
            state.update(_KEY.pack(*key))
            state.update(np.ascontiguousarray(cells, dtype="<i4").tobytes())
    return state.digest()
