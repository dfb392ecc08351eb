"""What was known when: a row now and then, over however long a time in however few rows."""

from __future__ import annotations

import numpy as np

from agent.page_snapshot import HistoryRow
from mapping.lattice import Cells, Lattice, TileKey
from mapping.tiles import Tiles

HISTORY_PERIOD = 0.5
"""Seconds between two rows, at first."""

MOST_HISTORY = 1200
"""Rows at most; then every other one goes, and they come half as often."""


class History:
    """The history of one map.

    Attributes:
        known_m2: how many square metres are known now.
        tiles: in how many tiles they lie.
        rows: in order of time; never written again, another list takes its place.
    """

    def __init__(self) -> None:
        self.known_m2 = 0.0
        self.tiles = 0
        self.rows: list[HistoryRow] = []
        self._period = HISTORY_PERIOD
        self._tiles: dict[TileKey, Cells] = {}
        self._cells = 0

    def take(self, tiles: Tiles, lattice: Lattice) -> set[TileKey]:
        """The map as it is now; gives the tiles that are others than before."""
        changed = {key for key, cells in tiles.items() if self._tiles.get(key) is not cells}
        changed |= self._tiles.keys() - tiles.keys()
        for key in changed:
            before, after = self._tiles.pop(key, None), tiles.get(key)
            if before is not None:
                self._count(before, -1)
            if after is not None:
                self._count(after, 1)
                self._tiles[key] = after
        self.known_m2 = round(self._cells * lattice.cell**2, 4)
        return changed

    def _count(self, cells: Cells, sign: int) -> None:
        known = int(np.count_nonzero(cells))
        self._cells += sign * known
        self.tiles += sign * (known > 0)

    def due(self, seconds: float) -> bool:
        """Whether it is time for another row."""
        return not self.rows or seconds - self.rows[-1].seconds >= self._period

    def note(self, seconds: float, bytes_rate: float) -> None:
        """Add a row, in place of one of the same tenth of a second."""
        row = HistoryRow(round(seconds, 1), self.known_m2, round(bytes_rate))
        self.rows = [*(self.rows[:-1] if self.rows and self.rows[-1].seconds == row.seconds else self.rows), row]
        if len(self.rows) > MOST_HISTORY:
            self.rows = self.rows[::2]
            self._period *= 2
