"""The global map: the sum over sessions, kept up to date tile by tile.

Nobody ever receives it: every peer adds up the single-writer sessions that it holds. An update costs what its own tiles
cost, whatever the number of robots and the size of the map.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mapping.lattice import TILE, Cells, TileKey
from mapping.tiles import Tiles, frozen, map_digest, total
from swarm.state import Change

_EMPTY = frozen(np.zeros((TILE, TILE), np.int32))


class Fusion:
    """The running sum.

    Attributes:
        tiles: the global map; arrays are replaced, never written. A tile of which nothing is left stays, all zero, so
            that whoever draws the map sees it go.
    """

    def __init__(self) -> None:
        self.tiles: dict[TileKey, Cells] = {}

    def add(self, change: Change) -> None:
        """One session's tiles went from one content to another: so does the sum."""
        for key, (before, after) in change.items():
            delta = after if before is None else after - before
            total = self.tiles.get(key)
            self.tiles[key] = delta if total is None else frozen(total + delta)

    def resum(self, keys: Iterable[TileKey], maps: Sequence[Tiles]) -> None:
        """Sum some tiles anew, because a session is summed that was not, or not any more.

        What went into the sum before does not count: not even a copy that has been damaged since leaves a trace.
        """
        for key in keys:
            parts = [tiles[key] for tiles in maps if key in tiles]
            self.tiles[key] = frozen(total(parts)) if parts else _EMPTY

    def rebuild(self, maps: Sequence[Tiles]) -> None:
        """Sum all sessions anew."""
        self.resum(set(self.tiles).union(*maps), maps)

    def digest(self) -> bytes:
        """The map digest (``mapping.tiles.map_digest``)."""
        return map_digest(self.tiles)
