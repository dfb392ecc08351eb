"""Tiles and changed cells as messages carry them: one deflated entry a tile, each of which decodes by itself.

An entry is the tile's ty and tx (int32), the length of what follows (uint16), and a raw deflate stream: of a tile's
1024 cells (int32, row-major), or of changed cells' indices (uint16, ascending) followed by their new values (int32).
Everything is little-endian.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import numpy as np

from mapping.lattice import TILE, Cells, TileKey
from mapping.tiles import Tiles, frozen
from swarm.drops import Drop
from swarm.limits import MAX_TILE_COORDINATE, MAX_TILES

_ENTRY = struct.Struct("<iiH")
ENTRY_HEADER = _ENTRY.size
"""Bytes of an entry before its deflate stream."""

_TILE_BYTES = TILE * TILE * 4
_CHANGE_BYTES = 2 + 4
_MAX_CHANGE_BYTES = TILE * TILE * _CHANGE_BYTES


HARDEST = 9
"""zlib's level that takes the longest and gives the fewest bytes."""


def _deflated(key: TileKey, content: bytes, level: int) -> bytes:
    squeezer = zlib.compressobj(level, zlib.DEFLATED, -15)
    data = squeezer.compress(content) + squeezer.flush()
    return _ENTRY.pack(*key, len(data)) + data


def encode_tile(key: TileKey, cells: Cells, level: int = HARDEST) -> bytes:
    """One whole tile as an entry, deflated at one of zlib's levels."""
    return _deflated(key, cells.astype("<i4").tobytes(), level)


def encode_changes(key: TileKey, before: Cells | None, after: Cells) -> bytes:
    """What changed in one tile as an entry: the new values of the cells that differ."""
    old = np.zeros(TILE * TILE, np.int32) if before is None else before.ravel()
    new = after.ravel()
    index = np.flatnonzero(old != new)
    return _deflated(key, index.astype("<u2").tobytes() + new[index].astype("<i4").tobytes(), HARDEST)


def decode_tiles(block: bytes) -> dict[TileKey, Cells]:
    """The tiles of a block of entries, read-only.

    Raises:
        Drop: ``bad_payload``, ``too_many``.
    """
    tiles = {}
    for key, content in _entries(block, _TILE_BYTES):
        if len(content) != _TILE_BYTES or key in tiles:
            raise Drop("bad_payload")
        cells = np.frombuffer(content, "<i4").astype(np.int32).reshape(TILE, TILE)
        tiles[key] = frozen(cells)
    return tiles


def decode_changes(block: bytes, before: Tiles) -> dict[TileKey, Cells]:
    """The tiles after the changes of a block of entries, read-only.

    Raises:
        Drop: ``bad_payload``, ``too_many``.
    """
    tiles = {}
    for key, content in _entries(block, _MAX_CHANGE_BYTES):
        count, odd = divmod(len(content), _CHANGE_BYTES)
        index = np.frombuffer(content, "<u2", count)
        ascending = (np.diff(index.astype(np.int64)) > 0).all()
        if odd or not count or key in tiles or not ascending or index[-1] >= TILE * TILE:
            raise Drop("bad_payload")
        old = before.get(key)
        cells = np.zeros((TILE, TILE), np.int32) if old is None else old.copy()
        cells.ravel()[index] = np.frombuffer(content, "<i4", count, 2 * count)
        tiles[key] = frozen(cells)
    return tiles


def _entries(block: bytes, most: int) -> Iterator[tuple[TileKey, bytes]]:
    """Keys and inflated contents; never inflates more than ``most`` bytes a tile."""
    position = count = 0
    while position < len(block):
        count += 1
        if count > MAX_TILES:
            raise Drop("too_many")
        if len(block) - position < _ENTRY.size:
            raise Drop("bad_payload")
        ty, tx, length = _ENTRY.unpack_from(block, position)
        position += _ENTRY.size
        data = block[position : position + length]
        position += length
        if len(data) < length or max(abs(ty), abs(tx)) > MAX_TILE_COORDINATE:
            raise Drop("bad_payload")
        inflater = zlib.decompressobj(-15)
        try:
            content = inflater.decompress(data, most + 1)
        except zlib.error:
            raise Drop("bad_payload") from None
        if not inflater.eof or inflater.unused_data or len(content) > most:
            raise Drop("bad_payload")
        yield TileKey(ty, tx), content
