"""A robot's own session: scans in, updates out, in the cheapest form and never longer than the bus allows.

Laws kept here: a robot maps from the quantised scans that it publishes; an update is cut to the bus's MTU, so that each
is worth something by itself; the longer the writer waits, the more one update carries; if it can never publish all that
it senses, what waits is bounded by the map and not by time.
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
from mapping.tiles import frozen
from swarm.drops import Drop
from swarm.limits import MAX_N, MAX_SCANS, MAX_TILES
from swarm.messages import Update, encode
from swarm.replica import Replica
from swarm.scan_block import encode_scans
from swarm.state import Change
from swarm.tile_block import ENTRY_HEADER, encode_changes, encode_tile

Publish = Literal["auto", "scans", "tiles"]
"""How scans are published: as themselves, as the whole tiles they change, or as what is cheaper: scans, unless so many
had to wait that the cells they changed are fewer bytes."""

_FEW = 64
"""Scans of which it is tried first how many fit: encoding all that wait would cost more than it tells."""

_BACKLOG = 32
"""Updates' worth of waiting scans from which on it is worth knowing whether their cells are cheaper."""

_MOST_WAITING = 1 << 15
"""Scans that may wait, nearly an hour's of an Orion. More become cells, which the map bounds."""

_GLIMPSES = 16
"""Poses that go with the cells of many scans, so that viewers see where the robot is."""


def _overhead(mtu: int, n: int = MAX_N) -> int:
    """The most bytes that update n, no longer than this, needs besides its payload and trail."""
    content = bytes(mtu)
    return len(encode(Update(content[:8], n, Update.TILES, content, content, 2**64 - 1))) - 2 * mtu


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
        self._mtu = mtu
        self._publish = publish
        self._form = Update.TILES if publish == "tiles" else Update.CELLS  # of what is no scan
        self._sensed: list[Scans] = []
        self._ahead: dict[TileKey, Cells] = {}  # contents not published yet; what is sensed comes on top
        self._trail: list[Scans] = []  # poses to be published with them
        self._enough = 1  # scans that make a full update, as far as is known
        self._weigh_at = 0

    @property
    def waiting(self) -> bool:
        """Whether there is something to publish."""
        return bool(self._sensed or self._ahead or self._trail)

    @property
    def _room(self) -> int:
        """Bytes of payload and trail that the next update may have."""
        return max(1, self._mtu - _overhead(self._mtu, self.replica.state.n + 1))

    @property
    def full(self) -> bool:
        """Whether there is probably more to publish than one update carries."""
        return bool(self._ahead or self._trail) or sum(map(len, self._sensed)) >= self._enough

    def sense(self, scans: Scans) -> None:
        """Take scans; they are published with the next updates."""
        if len(scans):
            self._sensed.append(scans)

    def updates(self) -> Iterator[tuple[Update, Change]]:
        """Publish all that waits: each update is applied to the own replica as it is given.

        Raises:
            MapFullError: the session would hold more tiles than it may.
        """
        while (made := self.next_update(partial=True)) is not None:
            yield made

    def next_update(self, *, partial: bool) -> tuple[Update, Change] | None:
        """Publish one update's worth, applied to the own replica; None if nothing waits.

        Args:
            partial: also if there is room for more in it.

        Raises:
            MapFullError: the session would hold more tiles than it may.
        """
        try:
            if self._sensed and partial and self._publish == "tiles":
                self._fold(MAX_SCANS)
            if self._ahead or self._trail:
                return self._next_tiles()
            return self._next_scans(partial=partial) if self._sensed else None
        except (Drop, ValueError):  # what everybody else would drop, we do not publish
            raise MapFullError(f"the map of robot {self.replica.descriptor.robot} is full: {MAX_TILES} tiles") from None

    def correct(self, tiles: Mapping[TileKey, Cells]) -> None:
        """Replace the contents of tiles by what the robot has learnt since; they are published with the next updates.

        All that was sensed before must have been published.
        """
        assert not self.waiting
        self._go_ahead(tiles)

    # --- scans

    def _next_scans(self, *, partial: bool) -> tuple[Update, Change] | None:
        scans = Scans.join(self._sensed)
        self._sensed = [scans]
        count, block = self._fitting(scans[: self.replica.descriptor.most_scans])
        rest = scans[count:]
        self._enough = count if len(rest) else max(self._enough, count + 1)
        if not partial and not len(rest):
            return None
        if len(scans) >= max(self._weigh_at, _BACKLOG * count) and self._better_as_cells(scans, count):
            self._fold(_GLIMPSES)
            return self._next_tiles()
        self._sensed = [rest] if len(rest) else []
        return self.replica.write(Update.SCANS, block, self._touched(self.replica.state.cells, scans[:count]))

    def _fitting(self, scans: Scans) -> tuple[int, bytes]:
        """As many of the first scans as fit into one update (one at least), and their block."""
        most = min(len(scans), MAX_SCANS)
        count = min(most, _FEW)
        block = encode_scans(scans[:count])
        while len(block) <= self._room and count < most:
            count = min(most, 2 * count)
            block = encode_scans(scans[:count])
        while len(block) > self._room and count > 1:
            count = max(1, min(count - 1, count * self._room // len(block)))
            block = encode_scans(scans[:count])
        while count < min(most, _FEW) and len(more := encode_scans(scans[: count + 1])) <= self._room:
            count, block = count + 1, more  # a block's head is no part of the proportion
        return count, block

    def _better_as_cells(self, scans: Scans, per_update: int) -> bool:
        self._weigh_at = 2 * len(scans)  # to know it costs as much as to integrate them
        if len(scans) > _MOST_WAITING:
            return True
        changed = self._touched(self.replica.state.cells, scans)
        size = sum(len(self._entry(key, cells)) - ENTRY_HEADER for key, cells in changed.items())
        return self._publish == "auto" and size / max(1, self._room - ENTRY_HEADER) < len(scans) / per_update

    def _touched(self, tiles: Mapping[TileKey, Cells], scans: Scans) -> dict[TileKey, Cells]:
        descriptor = self.replica.descriptor
        rules = descriptor.rules
        return integrated(tiles, scans, descriptor.sensor, rules.model, rules.lattice, self._kernel)

    # --- tiles

    def _fold(self, most_poses: int) -> None:
        """Let the scans that wait become the tiles that they change, with at most so many of their poses."""
        scans = Scans.join(self._sensed)
        self._sensed, self._weigh_at = [], 0
        self._go_ahead(self._touched(ChainMap(self._ahead, self.replica.state.cells), scans))
        poses = Scans(scans.stamps_ms, scans.poses, np.zeros((len(scans), 0), np.uint16))
        poses = Scans.join([*self._trail, poses])
        step = -(-len(poses) // most_poses)
        self._trail = [poses[(len(poses) - 1) % step :: step]]

    def _go_ahead(self, tiles: Mapping[TileKey, Cells]) -> None:
        published = self.replica.state.cells
        for key, cells in tiles.items():
            before = published.get(key)
            if np.array_equal(cells, np.zeros_like(cells) if before is None else before):
                self._ahead.pop(key, None)
            else:
                self._ahead[key] = cells

    def _next_tiles(self) -> tuple[Update, Change]:
        """An update of as many poses as fit, and as many waiting tiles as fit beside them."""
        trail = b""
        if self._trail:
            poses = Scans.join(self._trail)
            count, trail = self._fitting(poses)
            self._trail = [poses[count:]] if count < len(poses) else []
        block = b""
        published: dict[TileKey, Cells] = {}
        for key, cells in self._ahead.items():
            entry = self._entry(key, cells)
            if len(block) + len(trail) + len(entry) > self._room:
                break
            block += entry
            published[key] = cells
        if not published and not trail:
            key, cells = next(iter(self._ahead.items()))
            block, published[key] = self._piece(key, cells)
        for key, cells in published.items():
            if self._ahead[key] is cells:
                del self._ahead[key]
        return self.replica.write(self._form, block, published, trail)

    def _entry(self, key: TileKey, cells: Cells) -> bytes:
        """One tile's new content."""
        if self._form == Update.TILES:
            return encode_tile(key, cells)
        return encode_changes(key, self.replica.state.cells.get(key), cells)

    def _piece(self, key: TileKey, cells: Cells) -> tuple[bytes, Cells]:
        """Of a tile that is too much for one update as many changed cells as fit; or all, if it has to be whole."""
        if self._form == Update.TILES:
            return encode_tile(key, cells), cells
        before = self.replica.state.cells.get(key, np.zeros_like(cells))
        index = np.flatnonzero(before != cells)
        count = len(index)
        while True:
            some = before.copy()
            some.ravel()[index[:count]] = cells.ravel()[index[:count]]
            entry = encode_changes(key, before, some)
            if len(entry) <= self._room or count == 1:
                return entry, cells if count == len(index) else frozen(some)
            count = max(1, min(count - 1, count * self._room // len(entry)))
