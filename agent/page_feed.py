"""What the page is sent: of every tile its newest content, to each browser at the pace at which that one takes it.

Laws kept here: a browser has a set of tiles that it lacks, never a queue, so one that stalls costs a set of keys and
what it gets afterwards is the newest; a frame is bounded; whoever comes late is nothing special: he lacks everything.

A frame is a msgpack map:

* ``state``: all that is no tile: the swarm, its sessions, its peers (``Feed.state``); left out if it is as it was.
* ``tiles``: a list of ``[layer, keys, cells]``. The global map's layer is ``""``, a session's its id in hex. Keys are
  int32 (ty, tx); cells are int16, 1024 a tile, row-major, rows are y; evidence beyond +-32,767 is cut.
* ``tracks``: a list of ``[layer, first, trail, hits]``: poses (int32 x_mm, y_mm, yaw_turn16) from the first-th on, and
  the hits that are new (int32 x_mm, y_mm).
* ``history``: new rows of ``[seconds, known_m2, bytes_rate]``; times only grow.
* ``ended``: true in the last frame of a swarm that has ended.

Numbers in arrays are little-endian. Layers that ``state`` does not name any more are gone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from agent.page_snapshot import SessionView, Snapshot
from mapping.evidence import probability
from mapping.lattice import TILE, Cells, TileKey
from mapping.map_picture import Colour, robot_colour
from mapping.tiles import Tiles, map_digest

FUSED = ""
"""The layer of the global map."""

FRAME_TILES = 512
"""Tiles in one frame at most: 1 MiB."""

HISTORY_PERIOD = 0.5
"""Seconds between two entries of the history, at first."""

MOST_HISTORY = 1200
"""Entries of the history at most; then every other one goes, and they come half as often."""

_DIGEST_PERIOD = 1.0
"""Seconds between two map digests: of a large map they cost something."""

_ZERO = np.zeros((TILE, TILE), np.int32)
_INT16 = np.iinfo(np.int16)

Place = tuple[str, TileKey]
"""A layer's tile."""


class Feed:
    """The newest snapshot, and how it differs from the one before.

    Args:
        swarm: its name.
        roster: robot ids, whose order decides their colours.
        budget: payload bytes a second that the network can carry in all, or None if it does not matter.

    Attributes:
        snapshot: the newest, or None before the first.
        ended: whether there will be no other.
        state: see ``agent.page_feed``.
        history: seconds since the first snapshot, square metres known then, bytes a second heard then.
    """

    def __init__(self, swarm: str, roster: list[str], budget: float | None = None) -> None:
        self._swarm = swarm
        self._roster = roster
        self._budget = budget
        self._browsers: set[Browser] = set()
        self._layers: dict[str, Tiles] = {}
        self._seen: dict[Place, NDArray[np.float64]] = {}
        self._known: dict[TileKey, int] = {}
        self._digest = ""
        self._digest_at = -math.inf
        self._digest_due = True
        self._known_m2 = 0.0
        self._began: float | None = None
        self._history_period = HISTORY_PERIOD
        self.snapshot: Snapshot | None = None
        self.ended = False
        self.history: list[tuple[float, float, int]] = []
        self.state: dict[str, Any] = {}

    def take(self, snapshot: Snapshot) -> None:
        """A newer snapshot: note what every browser lacks now."""
        self.snapshot = snapshot
        layers = {FUSED: snapshot.fused} | {view.session.hex(): view.tiles for view in snapshot.sessions}
        for gone in self._layers.keys() - layers.keys():
            self._layers.pop(gone)
            self._seen = {place: seen for place, seen in self._seen.items() if place[0] != gone}
        changed: set[Place] = set()
        for layer, tiles in layers.items():
            before = self._layers.get(layer, {})
            if tiles is before:
                continue
            for key, cells in tiles.items():
                if before.get(key) is not cells:
                    changed.add((layer, key))
                    self._note(layer, key, before.get(key, _ZERO), cells, snapshot.now)
            changed |= {(layer, key) for key in before.keys() - tiles.keys()}  # a copy that started over
        self._layers = layers
        for browser in self._browsers:
            browser.lacks |= changed
        if not self._digest_due:
            self._digest_due = any(layer == FUSED for layer, _ in changed)
        if self._digest_due and (snapshot.now - self._digest_at >= _DIGEST_PERIOD or self.ended):
            self._digest, self._digest_at, self._digest_due = map_digest(snapshot.fused).hex(), snapshot.now, False
        self._known_m2 = round(sum(self._known.values()) * snapshot.rules.lattice.cell**2, 4)
        self._remember(snapshot)
        self.state = self._state(snapshot)

    def end(self, snapshot: Snapshot) -> None:
        """The last snapshot."""
        self.ended = True
        self.take(snapshot)

    def _note(self, layer: str, key: TileKey, before: Cells, after: Cells, now: float) -> None:
        """Remember what of a tile is known, or when which of its cells changed."""
        if layer == FUSED:
            self._known[key] = int(np.count_nonzero(after))
            return
        seen = self._seen.setdefault((layer, key), np.full((TILE, TILE), -np.inf))
        seen[before != after] = now

    def _remember(self, snapshot: Snapshot) -> None:
        """Add to the history, once in a while."""
        if self._began is None:
            self._began = snapshot.now
        seconds = snapshot.now - self._began
        if not self.history or self.ended or seconds - self.history[-1][0] >= self._history_period:
            self.history.append((round(seconds, 1), self._known_m2, round(snapshot.bytes_rate)))
        if len(self.history) > MOST_HISTORY:
            self.history = self.history[::2]
            self._history_period *= 2

    # --- what is known

    def cell(self, i: int, j: int) -> dict[str, Any]:
        """Who saw a cell: the evidence of each session that has any, and how long ago that last changed here."""
        key, row, column = TileKey(j // TILE, i // TILE), j % TILE, i % TILE

        def evidence(layer: str) -> int:
            return int(self._layers.get(layer, {}).get(key, _ZERO)[row, column])

        witnesses = []
        for view in self.snapshot.sessions if self.snapshot is not None else ():
            layer = view.session.hex()
            units = evidence(layer)
            seen = self._seen.get((layer, key))
            if units == 0 or seen is None or self.snapshot is None:
                continue
            witnesses.append({
                "session": layer,
                "robot": view.contribution.descriptor.robot,
                "summed": view.contribution.summed,
                "evidence": units,
                "seconds": round(self.snapshot.now - float(seen[row, column]), 1),
            })  # fmt: skip
        fused = evidence(FUSED)
        p = float(probability(np.array([fused], np.int32))[0])
        return {"i": i, "j": j, "evidence": fused, "probability": round(p, 6), "witnesses": witnesses}

    def colour(self, robot: str) -> str:
        """A robot's colour as #rrggbb."""
        return "#{:02x}{:02x}{:02x}".format(*self.rgb(robot))

    def rgb(self, robot: str) -> Colour:
        """A robot's colour, the same as in the map's picture."""
        return robot_colour(self._roster.index(robot) if robot in self._roster else len(self._roster))

    def _state(self, snapshot: Snapshot) -> dict[str, Any]:
        return {
            "swarm": self._swarm,
            "cell_mm": snapshot.rules.lattice.cell_mm,
            "clear_hit": snapshot.rules.model.occupied,
            "digest": self._digest,
            "tiles": len(snapshot.fused),
            "known_m2": self._known_m2,
            "bytes_rate": round(snapshot.bytes_rate),
            "budget": self._budget,
            "ended": self.ended,
            "peers": [{"name": peer.name, "robot": peer.robot, "same": peer.same} for peer in snapshot.peers],
            "sessions": [self._session(view) for view in snapshot.sessions],
        }

    def _session(self, view: SessionView) -> dict[str, Any]:
        standing = view.contribution
        descriptor, pose = standing.descriptor, view.track.pose
        return {
            "session": view.session.hex(),
            "robot": descriptor.robot,
            "colour": self.colour(descriptor.robot),
            "n": standing.n,
            "known_n": view.known_n,
            "summed": standing.summed,
            "live": standing.live,
            "reason": standing.reason,
            "replaced": view.tiles == {} and standing.reason.startswith("replaced by"),
            "evicted": standing.reason.startswith("evicted"),
            "age": None if view.age is None else round(view.age),
            "updates_rate": round(view.updates_rate, 2),
            "bytes_rate": None if view.bytes_rate is None else round(view.bytes_rate),
            "tiles": len(view.tiles),
            "pose": None if pose is None else pose.tolist(),
            "sensed_from": None if descriptor.start is None else list(descriptor.start),
            "start": None if view.start is None else list(view.start),
        }

    # --- browsers

    def join(self) -> Browser:
        """A browser that has come: it lacks everything."""
        browser = Browser(self)
        browser.lacks = {(layer, key) for layer, tiles in self._layers.items() for key in tiles}
        self._browsers.add(browser)
        return browser

    def leave(self, browser: Browser) -> None:
        """It has gone."""
        self._browsers.discard(browser)

    def tile(self, place: Place) -> Cells:
        """A tile's newest content."""
        layer, key = place
        return self._layers.get(layer, {}).get(key, _ZERO)


class Browser:
    """What one browser has been sent.

    Attributes:
        lacks: the tiles of which it has not the newest content.
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._state: dict[str, Any] = {}
        self._poses: dict[str, int] = {}
        self._hits: dict[str, int] = {}
        self._history = -1.0
        self.lacks: set[Place] = set()

    def frame(self) -> bytes | None:
        """The next frame, or None if there is no news; it counts as sent."""
        content: dict[str, Any] = {}
        if tiles := [list(each) for each in self._tiles()]:
            content["tiles"] = tiles
        if tracks := [list(each) for each in self._tracks()]:
            content["tracks"] = tracks
        if self._feed.state != self._state:
            content["state"] = self._state = self._feed.state
        if history := [row for row in self._feed.history if row[0] > self._history]:
            content["history"], self._history = history, history[-1][0]
        if self._feed.ended and not self.lacks:
            content["ended"] = True
        return bytes(msgpack.packb(content)) if content else None

    def _tiles(self) -> Iterator[tuple[str, bytes, bytes]]:
        """The next tiles that it lacks, the global map's first."""
        batch = sorted(self.lacks)[:FRAME_TILES] if len(self.lacks) > FRAME_TILES else sorted(self.lacks)
        self.lacks -= set(batch)
        for layer in dict.fromkeys(layer for layer, _ in batch):
            keys = [key for each, key in batch if each == layer]
            cells = np.stack([self._feed.tile((layer, key)) for key in keys])
            cut = np.clip(cells, _INT16.min, _INT16.max).astype("<i2")
            yield layer, np.array(keys, "<i4").tobytes(), cut.tobytes()

    def _tracks(self) -> Iterator[tuple[str, int, bytes, bytes]]:
        snapshot = self._feed.snapshot
        for view in snapshot.sessions if snapshot is not None else ():
            layer, track = view.session.hex(), view.track
            first, hits = self._poses.get(layer, 0), self._hits.get(layer, 0)
            if first == len(track.trail) and hits == track.hits_in_all:
                continue
            self._poses[layer], self._hits[layer] = len(track.trail), track.hits_in_all
            new = track.hits[max(0, len(track.hits) - (track.hits_in_all - hits)) :]
            yield layer, first, track.trail[first:].astype("<i4").tobytes(), new.astype("<i4").tobytes()
