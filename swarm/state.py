"""The state of one session after n updates: its tiles, which update last changed each, and a check of them all.

Laws kept here: update n is applied only to state n - 1; it is applied whole or not at all; a tile's array is never
written, so that a kept state costs only its dictionaries.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mapping.integrate import integrated
from mapping.lattice import Cells, TileKey
from mapping.raster import Raster
from swarm.drops import Drop
from swarm.limits import MAX_TILES
from swarm.messages import Mark, Update
from swarm.scan_block import decode_scans
from swarm.session import Descriptor
from swarm.tile_block import decode_changes, decode_tiles

_KEY = struct.Struct("<ii")
_ROOT_ENTRY = struct.Struct("<iiIQ")

Change = dict[TileKey, tuple[Cells | None, Cells]]
"""Tiles before (None: there was none) and after."""


def tile_hash(key: TileKey, cells: Cells) -> int:
    """BLAKE2b-64 of ty, tx (int32) and the 1024 cells (int32, row-major), all little-endian, as a number."""
    data = _KEY.pack(*key) + np.ascontiguousarray(cells, dtype="<i4").tobytes()
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "little")


def state_check(n: int, marks: Mapping[TileKey, Mark]) -> int:
    """The sum modulo 2^64 of n and all tiles' hashes: n too, for an update of whole tiles fits at other numbers."""
    return (n + sum(mark.hash for mark in marks.values())) % 2**64


@dataclass(slots=True)
class State:
    """A session's tiles after update ``n``.

    Attributes:
        n: updates applied.
        cells: evidence by tile.
        marks: version and hash by tile; the same keys as ``cells``.
        check: ``state_check`` of them.
    """

    n: int = 0
    cells: dict[TileKey, Cells] = field(default_factory=dict)
    marks: dict[TileKey, Mark] = field(default_factory=dict)
    check: int = 0

    def copy(self) -> State:
        """The same state, which stays when this one moves on. Shares the arrays."""
        return State(self.n, self.cells.copy(), self.marks.copy(), self.check)

    def follow(self, later: State, keys: Iterable[TileKey]) -> None:
        """Become a later state of the same session, given the tiles in which it may differ."""
        for key in keys:
            self.cells[key], self.marks[key] = later.cells[key], later.marks[key]
        self.n, self.check = later.n, later.check

    def root(self) -> bytes:
        """BLAKE2b-128 over n (uint32) and all tiles in order of (ty, tx): ty, tx, version (uint32), hash (uint64).

        All little-endian. It covers n, so that nobody takes a state for an earlier or a later one.
        """
        digest = hashlib.blake2b(self.n.to_bytes(4, "little"), digest_size=16)
        for key in sorted(self.marks):
            digest.update(_ROOT_ENTRY.pack(*key, *self.marks[key]))
        return digest.digest()

    def sound_tiles(self) -> dict[tuple[TileKey, int], Cells]:
        """The tiles by what they really contain: (key, hash made anew)."""
        return {(key, tile_hash(key, cells)): cells for key, cells in self.cells.items()}

    def sound(self) -> bool:
        """Whether every tile is what its mark says, and the check their sum."""
        hashes = {(key, mark.hash) for key, mark in self.marks.items()}
        return self.sound_tiles().keys() == hashes and self.check == state_check(self.n, self.marks)

    @classmethod
    def verified(cls, n: int, marks: dict[TileKey, Mark], cells: dict[TileKey, Cells], root: bytes) -> State:
        """A state put together from a manifest and tiles whose hashes were checked as they came.

        Raises:
            Drop: ``bad_root``.
        """
        state = cls(n, cells, marks, state_check(n, marks))
        if state.root() != root:
            raise Drop("bad_root")
        return state

    def step(self, changed: Mapping[TileKey, Cells]) -> Step:
        """What the next update does to this state if it changes these tiles. Nothing is applied yet.

        Raises:
            Drop: ``too_many`` tiles.
        """
        new = {key: cells for key, cells in changed.items() if self._differs(key, cells)}
        marks = {key: Mark(self.n + 1, tile_hash(key, cells)) for key, cells in new.items()}
        check = self.check + 1
        for key, mark in marks.items():
            check += mark.hash - (self.marks[key].hash if key in self.marks else 0)
        if len(self.cells) + sum(key not in self.cells for key in new) > MAX_TILES:
            raise Drop("too_many")
        return Step(self.n + 1, new, marks, check % 2**64)

    def _differs(self, key: TileKey, cells: Cells) -> bool:
        before = self.cells.get(key)
        return bool(cells.any() if before is None else (before != cells).any())  # np.array_equal takes twice as long

    def apply(self, step: Step) -> Change:
        """Become the state after ``step``, which was made from this one."""
        assert step.n == self.n + 1
        change: Change = {key: (self.cells.get(key), cells) for key, cells in step.cells.items()}
        self.cells.update(step.cells)
        self.marks.update(step.marks)
        self.n, self.check = step.n, step.check
        return change


@dataclass(frozen=True, slots=True)
class Step:
    """One update's effect: the tiles that differ afterwards, their marks, and the check then."""

    n: int
    cells: dict[TileKey, Cells]
    marks: dict[TileKey, Mark]
    check: int


def changed_tiles(state: State, update: Update, descriptor: Descriptor, kernel: Raster) -> Mapping[TileKey, Cells]:
    """The tiles that an update leaves behind, whatever form it has.

    Raises:
        Drop: ``bad_payload``, ``too_many``.
    """
    if update.trail:
        decode_scans(update.trail, 0, 0)  # nobody who reads it later shall be surprised
    if update.form == Update.TILES:
        return decode_tiles(update.payload)
    if update.form == Update.CELLS:
        return decode_changes(update.payload, state.cells)
    sensor, rules = descriptor.sensor, descriptor.rules
    scans = decode_scans(update.payload, len(sensor.beams), sensor.max_range_mm)
    if len(scans) > descriptor.most_scans:
        raise Drop("too_many")
    try:
        return integrated(state.cells, scans, sensor, rules.model, rules.lattice, kernel)
    except ValueError:  # they touch more tiles than there may be
        raise Drop("too_many") from None
