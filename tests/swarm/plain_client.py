"""A follower's arithmetic in plain Python: from messages to states and digests, written from docs/protocol.md alone.

No NumPy, nothing of ours: slow, short, and wrong in other places than the code that ships. A start for a client in
another language. It follows an honest log in order, so it checks little and asks nobody.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import msgpack

Tile = list[int]
Map = dict[tuple[int, int], Tile]
Scan = tuple[int, int, int, int, list[int]]  # stamp_ms, x_mm, y_mm, yaw, ranges_mm

SCANS, CELLS, TILES = 1, 2, 3
EVICT = 1

# --- section 4

C = [math.floor(math.cos(2 * math.pi * k / 65536) * 16384 + 0.5) for k in range(65536)]


def table_sha256() -> str:
    return hashlib.sha256(struct.pack("<65536h", *C)).hexdigest()


def cosine(a: int) -> int:
    return C[a % 65536]


def sine(a: int) -> int:
    return C[(a - 16384) % 65536]


# --- section 10


@dataclass
class Descriptor:
    robot: str
    session: bytes
    cell_mm: int
    occupied: int
    free: int
    limit: int
    max_range_mm: int
    beams: list[tuple[int, int, int, int]]
    start: tuple[int, int, int] | None
    replaces: bytes | None = None


def decode_descriptor(data: bytes) -> Descriptor:
    robot, session, cell, occupied, free, limit, rule, far, beams, start, replaces = msgpack.unpackb(data, raw=True)
    assert rule == 0
    table = list(struct.iter_unpack("<hhHH", beams))
    pose = struct.unpack("<iiH", start) if start else None
    return Descriptor(robot.decode(), session, cell, occupied, free, limit, far, table, pose, replaces or None)


# --- section 11


class Bits:
    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def bit(self) -> int:
        byte, place = divmod(self.at, 8)
        self.at += 1
        return self.data[byte] >> (7 - place) & 1

    def number(self, bits: int) -> int:
        value = 0
        for _ in range(bits):
            value = 2 * value + self.bit()
        return value

    def align(self) -> None:
        self.at = -(-self.at // 8) * 8


def decode_rice(data: bytes, count: int, width: int) -> tuple[list[int], bytes]:
    k, bits = data[0], Bits(data[1:])
    quotients = []
    for _ in range(count):
        q = 0
        while bits.bit():
            q += 1
        quotients.append(q)
    bits.align()
    low = [bits.number(k) for _ in range(count)]
    bits.align()
    rest = data[1 + bits.at // 8 :]
    values = []
    for q, remainder in zip(quotients, low, strict=True):
        u = (q << k) + remainder
        if q == 15:
            u, rest = int.from_bytes(rest[:width], "little"), rest[width:]
        values.append(-(u + 1) // 2 if u % 2 else u // 2)
    return values, rest


def summed_twice(first: int, residuals: list[int]) -> list[int]:
    values, step = [first], 0
    for residual in residuals:
        step += residual
        values.append(values[-1] + step)
    return values


def signed64(value: int) -> int:
    return (value + 2**63) % 2**64 - 2**63


def decode_block(block: bytes, beams: int) -> list[Scan]:
    predictor, count, stamp, x, y, yaw = struct.unpack_from("<BHqiiH", block)
    rest = block[21:]
    columns = []
    for first, width in ((stamp, 8), (x, 8), (y, 8), (yaw, 2)):
        residuals, rest = decode_rice(rest, count - 1, width)
        columns.append(summed_twice(first, residuals))
    residuals, rest = decode_rice(rest, count * beams, 2)
    assert not rest
    rows: list[list[int]] = []
    for m in range(count):
        row: list[int] = []
        for b in range(beams):
            expected = rows[m - 1][b] if m and (b == 0 or predictor == 1) else row[b - 1] if b else 0
            row.append((expected + residuals[m * beams + b]) % 65536)
        rows.append(row)
    stamps, xs, ys, yaws = columns
    return [(signed64(stamps[m]), signed64(xs[m]), signed64(ys[m]), yaws[m] % 65536, rows[m]) for m in range(count)]


# --- section 5


def ray(start: tuple[int, int], end: tuple[int, int]) -> list[tuple[int, int]]:
    dx, dy = end[0] - start[0], end[1] - start[1]
    n = max(abs(dx), abs(dy))

    def q(k: int, d: int) -> int:
        if n == 0:
            return 0
        steps = (2 * k * abs(d) + n) // (2 * n)
        return steps if d >= 0 else -steps

    return [(start[0] + q(k, dx), start[1] + q(k, dy)) for k in range(n + 1)]


def fan(half_width: int, of: Descriptor) -> list[int]:
    if half_width == 0:
        return [0]
    largest = (65536 * 113 * of.cell_mm) // (710 * of.max_range_mm)
    m = (half_width + largest - 1) // largest
    return [k * (half_width // m) for k in range(-m, m + 1)]


def rays(scan: Scan, of: Descriptor) -> Iterator[tuple[list[tuple[int, int]], bool]]:
    """Each ray's cells that it says something of, and whether the last of them is a hit."""
    _, x, y, yaw, ranges = scan
    unit = 16384 * of.cell_mm
    for (bx, by, bearing, half_width), reading in zip(of.beams, ranges, strict=True):
        if reading == 0:
            continue
        reach = of.max_range_mm if reading == 65535 else reading
        x0 = 16384 * x + bx * cosine(yaw) - by * sine(yaw)
        y0 = 16384 * y + bx * sine(yaw) + by * cosine(yaw)
        offsets = fan(half_width, of)
        for k, offset in enumerate(offsets, start=-(len(offsets) // 2)):
            x1 = x0 + reach * cosine(yaw + bearing + offset)
            y1 = y0 + reach * sine(yaw + bearing + offset)
            cells = ray((x0 // unit, y0 // unit), (x1 // unit, y1 // unit))
            if reading != 65535 and 2 * abs(k) > len(offsets) // 2:
                yield cells[:-1], False  # something may be there
            else:
                yield cells, reading != 65535


# --- section 6


def add_scan(tiles: Map, scan: Scan, of: Descriptor) -> None:
    visited = set()
    for cells, hit in rays(scan, of):
        for k, (i, j) in enumerate(cells):
            key = (j // 32, i // 32)
            visited.add(key)
            tile = tiles.setdefault(key, [0] * 1024)
            value = of.occupied if hit and k == len(cells) - 1 else of.free
            tile[32 * (j % 32) + i % 32] += value
    if of.limit:
        for key in visited:
            tiles[key] = [max(-of.limit, min(of.limit, cell)) for cell in tiles[key]]


# --- section 7


def packed(key: tuple[int, int], tile: Tile) -> bytes:
    return struct.pack("<ii", *key) + struct.pack("<1024i", *tile)


def tile_hash(key: tuple[int, int], tile: Tile) -> int:
    return int.from_bytes(hashlib.blake2b(packed(key, tile), digest_size=8).digest(), "little")


def control_hash(*fields: int | bytes) -> int:
    message = msgpack.packb([1, 10, *fields])
    return int.from_bytes(hashlib.blake2b(message, digest_size=8).digest(), "little")


def map_digest(tiles: Map) -> str:
    whole = b"".join(packed(key, tiles[key]) for key in sorted(tiles) if any(tiles[key]))
    return hashlib.blake2b(whole, digest_size=16).hexdigest()


# --- section 12


def entries(payload: bytes) -> Iterator[tuple[tuple[int, int], bytes]]:
    while payload:
        ty, tx, length = struct.unpack_from("<iiH", payload)
        yield (ty, tx), zlib.decompress(payload[10 : 10 + length], -15)
        payload = payload[10 + length :]


# --- section 13


@dataclass
class State:
    descriptor: Descriptor
    n: int = 0
    tiles: Map = field(default_factory=dict)
    versions: dict[tuple[int, int], int] = field(default_factory=dict)

    def update(self, n: int, form: int, payload: bytes, check: int) -> None:
        assert n == self.n + 1
        after: Map = {key: list(tile) for key, tile in self.tiles.items()}
        if form == SCANS:
            for scan in decode_block(payload, len(self.descriptor.beams)):
                add_scan(after, scan, self.descriptor)
        elif form == TILES:
            for key, content in entries(payload):
                after[key] = list(struct.unpack("<1024i", content))
        else:
            for key, content in entries(payload):
                m = len(content) // 6
                tile = after.setdefault(key, [0] * 1024)
                for index, value in zip(
                    struct.unpack(f"<{m}H", content[: 2 * m]), struct.unpack(f"<{m}i", content[2 * m :]), strict=True
                ):
                    tile[index] = value
        for key, tile in after.items():
            if tile != self.tiles.get(key, [0] * 1024):
                self.tiles[key], self.versions[key] = tile, n
        self.n = n
        assert self.check() == check

    def check(self) -> int:
        return (self.n + sum(tile_hash(key, tile) for key, tile in self.tiles.items())) % 2**64

    def root(self) -> str:
        whole = struct.pack("<I", self.n) + b"".join(
            struct.pack("<iiIQ", *key, self.versions[key], tile_hash(key, self.tiles[key]))
            for key in sorted(self.tiles)
        )
        return hashlib.blake2b(whole, digest_size=16).hexdigest()


class Client:
    """Takes messages in order; knows the sessions, the control records and the sum."""

    def __init__(self) -> None:
        self.states: dict[bytes, State] = {}
        self.controls: dict[tuple[int, bytes], tuple[int, bytes, bytes]] = {}
        self.controls_check = 0

    def take(self, message: bytes) -> None:
        version, kind, *fields = msgpack.unpackb(message, raw=True)
        assert version == 1
        if kind == 1:
            descriptor = decode_descriptor(fields[0])
            self.states[descriptor.session] = State(descriptor)
        elif kind == 2:
            session, n, form, payload, _, check = fields
            self.states[session].update(n, form, payload, check)
        elif kind == 10:
            setting, subject, *rank = fields
            known = self.controls.get((setting, subject))
            if known is None or tuple(rank) > known:
                self.controls[setting, subject] = tuple(rank)
                self.controls_check += control_hash(setting, subject, *rank)
                self.controls_check -= control_hash(setting, subject, *known) if known else 0
                self.controls_check %= 2**64

    def summed(self, session: bytes) -> bool:
        _, _, evicted = self.controls.get((EVICT, session), (0, b"", b"\0"))
        replaced = any(state.descriptor.replaces == session for state in self.states.values())
        return self.states[session].descriptor.start is not None and not replaced and evicted == b"\0"

    def map(self) -> Map:
        total: Map = {}
        for session, state in self.states.items():
            if self.summed(session):
                for key, tile in state.tiles.items():
                    total[key] = [a + b for a, b in zip(total.get(key, [0] * 1024), tile, strict=True)]
        return total
