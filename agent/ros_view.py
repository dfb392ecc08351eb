"""What a peer knows as a stream of ROS 2 messages: of each update at once, of the map at a modest rate."""

from __future__ import annotations

import math
from collections.abc import Iterator

from agent.ros_messages import RosMessage, map_message, update_messages
from mapping.grid import Grid
from mapping.lattice import Cells, TileKey
from swarm.messages import Update
from swarm.peer import Peer
from swarm.session import Descriptor

_PERIOD = 1.0
"""Seconds between two maps."""

_CELLS_A_SECOND = 1e6
"""A larger map comes less often."""


class RosView:
    """Follows one peer.

    Args:
        peer: whose map is shown.
    """

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._drawn: dict[TileKey, Cells] = {}
        self._due_at = -math.inf
        self._stamp_ms = 0

    def update(self, descriptor: Descriptor, update: Update) -> list[RosMessage]:
        """The messages of an update that the peer has applied."""
        found = update_messages(descriptor, update)
        self._stamp_ms = max([self._stamp_ms, *(message.stamp_ms for message in found)])
        return found

    def map(self, now: float) -> Iterator[RosMessage]:
        """The map, if it has changed and it is time; infinity is time for all that has changed."""
        tiles = self._peer.fusion.tiles
        if now < self._due_at or not tiles or not self._has_changed():
            return
        self._drawn = tiles.copy()
        grid = Grid.of(tiles, self._peer.rules.lattice)
        self._due_at = now + max(_PERIOD, grid.evidence.size / _CELLS_A_SECOND)
        if grid.evidence.size:
            yield map_message(grid, self._stamp_ms)

    def _has_changed(self) -> bool:
        tiles = self._peer.fusion.tiles
        return len(tiles) != len(self._drawn) or any(self._drawn.get(key) is not tiles[key] for key in tiles)
