"""What the map must be, worked out from what robots saw in plain integers, with nothing of the code that is tested.

Robots of schedules see nothing but the ``SIGHTINGS``: a few scans, each known by its number. What one is worth at a
start pose is worked out once, slowly; a robot's map is then the sum over the numbers in its journal.
"""

from __future__ import annotations

import hashlib
import math
import random
import struct
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CELL_MM = 100
OCCUPIED, FREE = 85, -40
MAX_RANGE_MM = 800
BEARINGS = (0, 16384)
"""Forward and left: two beams are enough to tell one yaw from another."""

_NO_RETURN = 65535
_COSINE = tuple(round(math.cos(2 * math.pi * k / 65536) * 16384) for k in range(65536))

Tile = tuple[int, int]
Tiles = dict[Tile, NDArray[np.int32]]


class Sighting(NamedTuple):
    """One scan in the robot's own frame, from where it started."""

    x_mm: int
    y_mm: int
    yaw_turn16: int
    ranges_mm: tuple[int, ...]


class Start(NamedTuple):
    """A start pose. Robots start at quarter turns, so that a pose in the common frame is a whole number exactly."""

    x_mm: int
    y_mm: int
    quarters: int

    @classmethod
    def at(cls, x_mm: int, y_mm: int, yaw_turn16: int) -> Start:
        """The start pose of these numbers."""
        return cls(x_mm, y_mm, yaw_turn16 // 16384)

    @property
    def pose(self) -> tuple[int, int, int]:
        """x_mm, y_mm, yaw_turn16."""
        return self.x_mm, self.y_mm, 16384 * self.quarters

    def place(self, sighting: Sighting) -> tuple[int, int, int]:
        """Where the robot was, in the common frame: x_mm, y_mm, yaw_turn16."""
        x, y = sighting.x_mm, sighting.y_mm
        for _ in range(self.quarters):
            x, y = -y, x
        return self.x_mm + x, self.y_mm + y, (sighting.yaw_turn16 + 16384 * self.quarters) % 65536


def _sightings(count: int) -> tuple[Sighting, ...]:
    chance = random.Random(0)
    return tuple(
        Sighting(
            chance.randrange(-4500, 4500),
            chance.randrange(-4500, 4500),
            chance.randrange(65536),
            tuple(chance.choice([_NO_RETURN, 0, *[chance.randint(1, MAX_RANGE_MM)] * 8]) for _ in BEARINGS),
        )
        for _ in range(count)
    )


SIGHTINGS = _sightings(64)
ORIGIN = Start(0, 0, 0)
STARTS = tuple(Start(x, y, turn) for turn, (x, y) in enumerate([(0, 0), (2150, 1450), (-3000, 700), (40, -2890)]))


def _cos(turn16: int) -> int:
    return _COSINE[turn16 % 65536]


def _sin(turn16: int) -> int:
    return _COSINE[(turn16 - 16384) % 65536]


def _nearest(k: int, d: int, n: int) -> int:
    """k * d / n rounded to the nearest integer, halves away from zero."""
    size = (2 * k * abs(d) + n) // (2 * n)
    return -size if d < 0 else size


def _ray(i0: int, j0: int, i1: int, j1: int) -> list[tuple[int, int]]:
    n = max(abs(i1 - i0), abs(j1 - j0))
    if n == 0:
        return [(i0, j0)]
    return [(i0 + _nearest(k, i1 - i0, n), j0 + _nearest(k, j1 - j0, n)) for k in range(n + 1)]


@cache
def evidence(number: int, start: Start) -> tuple[tuple[Tile, NDArray[np.int32]], ...]:
    """What one sighting adds to a map."""
    sighting = SIGHTINGS[number]
    x, y, yaw = start.place(sighting)
    side = CELL_MM * 16384
    tiles: Tiles = {}
    for bearing, reading in zip(BEARINGS, sighting.ranges_mm, strict=True):
        if reading == 0:
            continue
        reach = MAX_RANGE_MM if reading == _NO_RETURN else reading
        x1, y1 = x * 16384 + reach * _cos(yaw + bearing), y * 16384 + reach * _sin(yaw + bearing)
        cells = _ray(x * 16384 // side, y * 16384 // side, x1 // side, y1 // side)
        for number_, (i, j) in enumerate(cells, start=1):
            hit = number_ == len(cells) and reading != _NO_RETURN
            tile = tiles.setdefault((j // 32, i // 32), np.zeros((32, 32), np.int32))
            tile[j % 32, i % 32] += OCCUPIED if hit else FREE
    return tuple(tiles.items())


class Entry(NamedTuple):
    """What a journal holds of one scan.

    Attributes:
        stamp_ms: when it was sensed; no two scans of a robot have the same.
        number: which sighting it was.
    """

    stamp_ms: int
    number: int


def integrate(journal: Iterable[Entry], start: Start, withdrawn: Collection[int] = ()) -> Tiles:
    """The map of what a robot saw, but for the scans (by stamp) that it knows to be wrong."""
    return total(dict(evidence(entry.number, start)) for entry in journal if entry.stamp_ms not in withdrawn)


def total(maps: Iterable[Mapping[Tile, NDArray[np.int32]]]) -> Tiles:
    """The sum of some maps."""
    sum_: Tiles = {}
    for tiles in maps:
        for key, cells in tiles.items():
            if key in sum_:
                sum_[key] += cells
            else:
                sum_[key] = cells.copy()
    return sum_


def equal(one: Mapping[Tile, NDArray[np.int32]], other: Mapping[Tile, NDArray[np.int32]]) -> bool:
    """Whether two maps say the same; a tile that says nothing counts as none."""
    return all(
        np.array_equal(one[key], other[key])
        if key in one and key in other
        else not (one.get(key, other.get(key))).any()
        for key in {**one, **other}
    )


def digest(tiles: Mapping[Tile, NDArray[np.int32]]) -> bytes:
    """The map digest, as docs/protocol.md defines it."""
    known = sorted(key for key, cells in tiles.items() if cells.any())
    content = b"".join(struct.pack("<ii", *key) + tiles[key].astype("<i4").tobytes() for key in known)
    return hashlib.blake2b(content, digest_size=16).digest()
