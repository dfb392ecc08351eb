"""A robot's own session: scans in, updates out, in the cheapest form and never longer than the bus allows.

Laws kept here: a robot maps from the quantised scans that it publishes; an update is cut to the bus's MTU, so that each
is worth something by itself; the longer the writer waits, the more one update carries.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from mapping.integrate import integrated
from mapping.lattice import Cells, TileKey
from mapping.raster import Raster
from mapping.scan import Scans
from swarm.drops import Drop
from swarm.limits import MAX_N, MAX_SCANS, MAX_TILES
from swarm.messages import Update, encode
from swarm.replica import Replica
from swarm.scan_block import encode_scans
from swarm.state import Change
from swarm.tile_block import encode_changes, encode_tile

Publish = Literal["auto", "scans", "tiles"]
"""How scans are published: as themselves (``auto`` too: nothing is cheaper), or as the whole tiles they change."""


def _overhead(mtu: int) -> int:
    """The most bytes that an update no longer than this needs besides its payload and trail."""
    content = bytes(mtu)
    return len(encode(Update(content[:8], MAX_N, Update.TILES, content, content, 2**64 - 1))) - 2 * mtu


class MapFullError(Exception):
    """A session has all the tiles that it may have."""


class Writer:
    """Turns what the robot senses into its session's updates.

    Attributes:
        replica: the session as everybody may know it by now.
    """

    def __init__(self, replica: Replica, kernel: Raster, *, mtu: int, publish: Publish = "auto") -> None:
        self.replica = replica
        self._kernel = kernel
        self._room = max(1, mtu - _overhead(mtu))
        self._as_tiles = publish == "tiles"
        self._sensed: list[Scans] = []
        self._ahead: dict[TileKey, Cells] = {}  # tiles whose newest content is not published yet

    @property
    def waiting(self) -> bool:
        """Whether there is something to publish."""
        return bool(self._sensed or self._ahead)

    def sense(self, scans: Scans) -> None:
        """Take scans; they are published with the next updates."""
        if len(scans):
            self._sensed.append(scans)

    def updates(self) -> Iterator[tuple[Update, Change]]:
        """Publish all that was sensed: each update is applied to the own replica as it is given.

        Raises:
            MapFullError: the session would hold more tiles than it may.
        """
        if not self._sensed:
            return
        scans = Scans.join(self._sensed)
        self._sensed.clear()
        try:
            yield from self._tile_updates(scans) if self._as_tiles else self._scan_updates(scans)
        except (Drop, ValueError):  # what everybody else would drop, we do not publish
            raise MapFullError(f"the map of robot {self.replica.descriptor.robot} is full: {MAX_TILES} tiles") from None

    def _scan_updates(self, scans: Scans) -> Iterator[tuple[Update, Change]]:
        while len(scans):
            count, block = self._fitting(scans[: self.replica.descriptor.most_scans])
            changed = self._touched(self.replica.state.cells, scans[:count])
            yield self.replica.write(Update.SCANS, block, changed)
            scans = scans[count:]

    def _fitting(self, scans: Scans) -> tuple[int, bytes]:
        """As many of the first scans as fit into one update (one at least), and their block."""
        count = min(len(scans), MAX_SCANS)
        block = encode_scans(scans[:count])
        while len(block) > self._room and count > 1:
            count = max(1, min(count - 1, count * self._room // len(block)))
            block = encode_scans(scans[:count])
        return count, block

    def _tile_updates(self, scans: Scans) -> Iterator[tuple[Update, Change]]:
        self._ahead.update(self._touched(ChainMap(self._ahead, self.replica.state.cells), scans))
        while len(scans):
            count, trail = self._fitting(Scans(scans.stamps_ms, scans.poses, np.zeros((len(scans), 0), np.uint16)))
            scans = scans[count:]
            if len(scans):  # more poses than one update holds: they go with fewer tiles
                yield self._next_tiles(trail)
        yield self._next_tiles(trail)
        while self._ahead:
            yield self._next_tiles(b"")

    def _next_tiles(self, trail: bytes) -> tuple[Update, Change]:
        """An update of as many waiting tiles as fit beside the trail (one at least)."""
        block = b""
        published: dict[TileKey, Cells] = {}
        for key, cells in self._ahead.items():
            entry = encode_tile(key, cells)
            if published and len(block) + len(trail) + len(entry) > self._room:
                break
            block += entry
            published[key] = cells
        for key in published:
            del self._ahead[key]
        return self.replica.write(Update.TILES, block, published, trail)

    def _touched(self, tiles: Mapping[TileKey, Cells], scans: Scans) -> dict[TileKey, Cells]:
        descriptor = self.replica.descriptor
        rules = descriptor.rules
        return integrated(tiles, scans, descriptor.sensor, rules.model, rules.lattice, self._kernel)

    def correct(self, tiles: Mapping[TileKey, Cells]) -> Iterator[tuple[Update, Change]]:
        """Replace the contents of tiles by what the robot has learnt since, as changed cells.

        All that was sensed before must have been published.
        """
        assert not self.waiting
        block = b""
        changed: dict[TileKey, Cells] = {}
        for key, cells in tiles.items():
            before = self.replica.state.cells.get(key)
            if np.array_equal(cells, 0 if before is None else before):
                continue
            entry = encode_changes(key, before, cells)
            if changed and len(block) + len(entry) > self._room:
                yield self.replica.write(Update.CELLS, block, changed)
                block, changed = b"", {}
            block += entry
            changed[key] = cells
        if changed:
            yield self.replica.write(Update.CELLS, block, changed)
