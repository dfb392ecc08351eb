"""The global map: the sum over sessions, kept up to date tile by tile.

Nobody ever receives it: every peer adds up the single-writer sessions that it holds. An update costs what its own tiles
cost, whatever the number of robots and the size of the map.
"""

from __future__ import annotations

from mapping.lattice import Cells, TileKey
from mapping.tiles import Tiles, frozen, map_digest, summed
from swarm.state import Change


class Fusion:
    """The running sum.

    Attributes:
        tiles: the global map; arrays are replaced, never written.
    """

    def __init__(self) -> None:
        self.tiles: dict[TileKey, Cells] = {}

    def add(self, change: Change) -> None:
        """One session's tiles went from one content to another: so does the sum."""
        for key, (before, after) in change.items():
            delta = after if before is None else after - before
            total = self.tiles.get(key)
            self.tiles[key] = delta if total is None else frozen(total + delta)

    def rebuild(self, maps: list[Tiles]) -> None:
        """Sum all sessions anew."""
        self.tiles = {key: frozen(cells) for key, cells in summed(maps).items()}

    def digest(self) -> bytes:
        """The map digest (``mapping.tiles.map_digest``)."""
        return map_digest(self.tiles)
