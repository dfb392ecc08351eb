"""What the page is sent: of every tile its newest content, to each browser at the pace at which that one takes it.

Laws kept here: a browser has sets of tiles that it lacks, never a queue, so one that stalls costs sets of keys and what
it gets afterwards is the newest; a frame is bounded; whoever comes late is nothing special: he lacks everything. Where
more of the global map is lacking than fits into one frame, all of it comes first, as coarse as fits: that is half as
many cells as a screen has pixels.

A frame is a msgpack map:

* ``state``: all that is no tile: the swarm, its sessions, its peers (``agent.overview``), whether it has
  ended; left out if it is as it was.
* ``tiles``: a list of ``[layer, level, keys, cells]``. The global map's layer is ``""``, a session's its id in hex.
  Keys are int32 (ty, tx); cells are int16, row-major, rows are y; evidence beyond +-32,767 is cut. A tile has 32 x 32
  cells at level 0 and half as many in each direction at the next (``pooled``).
* ``tracks``: a list of ``[layer, first, trail, first_hit, hits]``: poses (int32 x_mm, y_mm, yaw_turn16) from the
  first-th on, in place of all that came after it; and hits (int32 x_mm, y_mm) from the first_hit-th on: where that is
  not the next one, in place of all others.
* ``history``: new rows of ``[seconds, known_m2, bytes_rate]``; times only grow.
* ``ended``: true in the last frame of all.

Numbers in arrays are little-endian. Layers that ``state`` does not name any more are gone. A frame may be empty: it
says that the server is there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from agent.overview import Overview
from agent.page_snapshot import HistoryRow, Snapshot
from mapping.evidence import probability
from mapping.lattice import TILE, TileKey
from mapping.tiles import Tiles

FUSED = ""
"""The layer of the global map."""

FRAME_TILES = 512
"""Tiles in one frame at most, or as many cells of coarser ones: 1 MiB."""

_COARSEST = 5
"""The level at which a tile is one cell."""

_ZERO = np.zeros((TILE, TILE), np.int32)
_INT16 = np.iinfo(np.int16)

Place = tuple[str, TileKey]
"""A layer's tile."""


def pooled(cells: NDArray[np.int16], level: int) -> NDArray[np.int16]:
    """Tiles at a coarser level: of four cells each the most occupied, or if none is occupied the most free.

    Args:
        cells: shape (T, N, N).
        level: how often N is halved.
    """
    for _ in range(level):
        four = [cells[:, row::2, column::2] for row in (0, 1) for column in (0, 1)]
        most = np.maximum(np.maximum(four[0], four[1]), np.maximum(four[2], four[3]))
        least = np.minimum(np.minimum(four[0], four[1]), np.minimum(four[2], four[3]))
        cells = np.where(most > 0, most, least)
    return cells


class Feed:
    """The newest snapshot, and how it differs from the one before.

    Args:
        overview: tells of each how the swarm stands.

    Attributes:
        overview: as given.
        snapshot: the newest, or None before the first.
        ended: whether there will be no other.
        state: how the swarm stands.
        history: of a log the log's; else since the first snapshot.
    """

    def __init__(self, overview: Overview) -> None:
        self.overview = overview
        self._browsers: set[Browser] = set()
        self._layers: dict[str, Tiles] = {}
        self._seen: dict[str, dict[TileKey, NDArray[np.float64]]] = {}
        self._began: float | None = None
        self.snapshot: Snapshot | None = None
        self.ended = False
        self.history: Sequence[HistoryRow] = []
        self.state: dict[str, Any] = {}

    def take(self, snapshot: Snapshot) -> None:
        """A newer snapshot: note what every browser lacks now."""
        self.snapshot = snapshot
        self.state = {**self.overview.of(snapshot, exact=self.ended), "ended": self.ended}
        changed = {FUSED: self.overview.changed}
        layers: dict[str, Tiles] = {FUSED: snapshot.fused}
        for view in snapshot.sessions:
            layer = view.session.hex()
            layers[layer] = view.tiles
            changed[layer] = self._session_changed(layer, view.tiles, snapshot)
        for gone in self._layers.keys() - layers.keys():
            self._seen.pop(gone, None)
            for browser in self._browsers:
                browser.lacks.pop(gone, None)
        self._layers = layers
        for browser in self._browsers:
            browser.note(changed)
        if self._began is None:
            self._began = snapshot.now
        if snapshot.timeline is None:
            seconds = snapshot.now - self._began
            history = self.overview.history
            if history.due(seconds) or self.ended:
                history.note(seconds, snapshot.bytes_rate)
            self.history = history.rows
        else:
            self.history = snapshot.timeline.history

    def end(self, snapshot: Snapshot) -> None:
        """The last snapshot."""
        self.ended = True
        self.take(snapshot)

    def _session_changed(self, layer: str, tiles: Tiles, snapshot: Snapshot) -> set[TileKey]:
        """The tiles of a session that are others than before; remembers when which of their cells changed."""
        before = self._layers.get(layer, {})
        if tiles is before:
            return set()
        changed = {key for key, cells in tiles.items() if before.get(key) is not cells}
        gone = before.keys() - tiles.keys()  # a copy that started over or was replaced, or a time before
        if snapshot.timeline is None:
            when = self._seen.setdefault(layer, {})
            for key in changed:
                seen = when.setdefault(key, np.full((TILE, TILE), -np.inf))
                seen[before.get(key, _ZERO) != tiles[key]] = snapshot.now
            for key in gone:
                del when[key]
        return changed | gone

    # --- what is known

    def cell(self, i: int, j: int) -> dict[str, Any]:
        """Who saw a cell: the evidence of each session that has any, and how long ago that last changed here.

        Of a log it is not told when: that would depend on what was looked at before.
        """
        key, row, column = TileKey(j // TILE, i // TILE), j % TILE, i % TILE

        def evidence(layer: str) -> int:
            return int(self._layers.get(layer, {}).get(key, _ZERO)[row, column])

        witnesses = []
        for view in self.snapshot.sessions if self.snapshot is not None else ():
            layer = view.session.hex()
            units = evidence(layer)
            if units == 0 or self.snapshot is None:
                continue
            seen = self._seen.get(layer, {}).get(key)
            witnesses.append({
                "session": layer,
                "robot": view.contribution.descriptor.robot,
                "summed": view.contribution.summed,
                "evidence": units,
                "seconds": None if seen is None else round(self.snapshot.now - float(seen[row, column]), 1),
            })  # fmt: skip
        fused = evidence(FUSED)
        p = float(probability(np.array([fused], np.int32))[0])
        return {"i": i, "j": j, "evidence": fused, "probability": round(p, 6), "witnesses": witnesses}

    # --- browsers

    def join(self) -> Browser:
        """A browser that has come: it lacks everything."""
        browser = Browser(self)
        browser.note({layer: tiles.keys() for layer, tiles in self._layers.items()})
        self._browsers.add(browser)
        return browser

    def leave(self, browser: Browser) -> None:
        """It has gone."""
        self._browsers.discard(browser)

    def cells(self, layer: str, keys: Collection[TileKey]) -> NDArray[np.int16]:
        """The newest content of some tiles, shape (T, 32, 32)."""
        tiles = self._layers.get(layer, {})
        cells = np.stack([tiles.get(key, _ZERO) for key in keys])
        return np.clip(cells, _INT16.min, _INT16.max, out=cells).astype(np.int16)


class Browser:
    """What one browser has been sent.

    Attributes:
        lacks: by layer, the tiles of which it has not the newest content.
        done: whether the last frame of all has been made.
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._state: dict[str, Any] = {}
        self._poses: dict[str, tuple[int, int]] = {}
        self._hits: dict[str, int] = {}
        self._history = -1.0
        self._overview: set[TileKey] = set()
        self.lacks: dict[str, set[TileKey]] = {}
        self.done = False

    def note(self, changed: Mapping[str, Collection[TileKey]]) -> None:
        """Tiles have changed."""
        for layer, keys in changed.items():
            if keys:
                self.lacks.setdefault(layer, set()).update(keys)
        if len(keys := changed.get(FUSED, ())) > FRAME_TILES:
            self._overview.update(keys)

    def frame(self) -> bytes | None:
        """The next frame, or None if there is no news; it counts as sent."""
        content: dict[str, Any] = {}
        if tiles := [list(each) for each in self._tiles()]:
            content["tiles"] = tiles
        if tracks := [list(each) for each in self._tracks()]:
            content["tracks"] = tracks
        if self._feed.state != self._state:
            content["state"] = self._state = self._feed.state
        if history := [row for row in self._feed.history if row.seconds > self._history]:
            content["history"], self._history = history, history[-1].seconds
        if self._feed.ended and not self.lacks:
            content["ended"] = self.done = True
        return bytes(msgpack.packb(content)) if content else None

    def _tiles(self) -> Iterator[tuple[str, int, bytes, bytes]]:
        """The next tiles that it lacks, the global map's first."""
        if self._overview:
            level = min(_COARSEST, math.ceil(math.log(len(self._overview) / FRAME_TILES, 4)))
            yield self._packed(FUSED, level, list(self._overview))
            self._overview.clear()
            return
        room = FRAME_TILES
        for layer in sorted(self.lacks):
            keys = list(islice(self.lacks[layer], room))
            self.lacks[layer].difference_update(keys)
            if not self.lacks[layer]:
                del self.lacks[layer]
            room -= len(keys)
            yield self._packed(layer, 0, keys)
            if room == 0:
                break

    def _packed(self, layer: str, level: int, keys: list[TileKey]) -> tuple[str, int, bytes, bytes]:
        cells = pooled(self._feed.cells(layer, keys), level)
        return layer, level, np.array(keys, "<i4").tobytes(), cells.astype("<i2", copy=False).tobytes()

    def _tracks(self) -> Iterator[tuple[str, int, bytes, int, bytes]]:
        snapshot = self._feed.snapshot
        views = snapshot.sessions if snapshot is not None else ()
        there = {view.session.hex() for view in views}
        self._poses = {layer: sent for layer, sent in self._poses.items() if layer in there}
        self._hits = {layer: sent for layer, sent in self._hits.items() if layer in there}
        for view in views:
            layer, track = view.session.hex(), view.track
            (stride_mm, poses), hits = self._poses.get(layer, (track.stride_mm, 0)), self._hits.get(layer, 0)
            if (stride_mm, poses, hits) == (track.stride_mm, len(track.trail), track.hits_in_all):
                continue
            self._poses[layer], self._hits[layer] = (track.stride_mm, len(track.trail)), track.hits_in_all
            first = min(poses, len(track.trail)) if stride_mm == track.stride_mm else 0
            oldest = track.hits_in_all - len(track.hits)
            first_hit = hits if oldest <= hits <= track.hits_in_all else oldest
            trail, new = track.trail[first:].astype("<i4"), track.hits[first_hit - oldest :].astype("<i4")
            yield layer, first, trail.tobytes(), first_hit, new.tobytes()
