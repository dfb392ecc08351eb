"""Scans as an update carries them: differences from what could be expected, in a few bits each.

Poses and stamps are predicted to go on as they went (second differences), a range to equal its neighbour in the scan or
the same beam's last one, whichever makes the block shorter. Five beams at 10 Hz come to about five bytes a scan.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from mapping.pose import FULL_TURN
from mapping.scan import NO_RETURN, Scans
from swarm.bits import pack, unpack
from swarm.drops import Drop
from swarm.limits import MAX_COORDINATE_MM, MAX_SCANS

_HEADER = struct.Struct("<BHqiiH")  # predictor, scans, and the first scan's stamp_ms, x_mm, y_mm, yaw_turn16
_ACROSS, _IN_TIME = 0, 1
_FAR = 8  # bytes of an escaped stamp or coordinate
_NEAR = 2  # bytes of an escaped yaw or range, which wrap at 16 bits


def encode_scans(scans: Scans) -> bytes:
    """At least one scan, at most ``MAX_SCANS``, of a sensor with any number of beams (none: poses alone)."""
    ranges = scans.ranges.astype(np.int64)
    across = pack(_range_residuals(ranges, _ACROSS), _NEAR)
    in_time = pack(_range_residuals(ranges, _IN_TIME), _NEAR) if len(scans) > 1 else across
    predictor = _IN_TIME if len(in_time) < len(across) else _ACROSS
    ways = np.empty((4, len(scans)), np.int64)
    ways[0], ways[1:] = scans.stamps_ms, scans.poses.T
    stamps, xs, ys, yaws = _second_differences(ways)
    return b"".join([
        _HEADER.pack(predictor, len(scans), *ways[:, 0].tolist()),
        pack(stamps, _FAR),
        pack(xs, _FAR),
        pack(ys, _FAR),
        pack(_wrapped(yaws), _NEAR),
        in_time if predictor == _IN_TIME else across,
    ])  # fmt: skip


def decode_scans(block: bytes, beams: int, max_range_mm: int) -> Scans:
    """The scans of a block.

    Args:
        block: what ``encode_scans`` made.
        beams: readings a scan.
        max_range_mm: no reading may exceed it.

    Raises:
        Drop: ``bad_payload``.
    """
    try:
        predictor, count, *first = _HEADER.unpack_from(block)
        if predictor not in {_ACROSS, _IN_TIME} or not 1 <= count <= MAX_SCANS:
            raise ValueError("scan block: bad header")
        rest = block[_HEADER.size :]
        ways = np.empty((4, count), np.int64)
        ways[:, 0] = first
        for row, width in enumerate((_FAR, _FAR, _FAR, _NEAR)):
            ways[row, 1:], rest = unpack(rest, count - 1, width)
        range_residuals, rest = unpack(rest, count * beams, _NEAR)
    except (ValueError, struct.error):
        raise Drop("bad_payload") from None
    _integrate(ways)
    ranges = _ranges(range_residuals.reshape(count, beams), predictor)
    bad_range = (ranges > max_range_mm) & (ranges != NO_RETURN)
    if rest or ways[1:3].min() < -MAX_COORDINATE_MM or ways[1:3].max() > MAX_COORDINATE_MM or bad_range.any():
        raise Drop("bad_payload")
    ways[3] %= FULL_TURN
    return Scans(ways[0].copy(), ways[1:].T.astype(np.int32, order="C"), ranges.astype(np.uint16))


def _second_differences(ways: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each row of N, the differences of the N - 1 steps from the step before, the first from a step of zero."""
    steps = ways[:, 1:] - ways[:, :-1]
    steps[:, 1:] -= steps[:, :-1].copy()
    return steps


def _integrate(ways: NDArray[np.int64]) -> None:
    """In each row, first values followed by second differences become values."""
    if ways.shape[1] > 1:  # a lone scan is the usual case, and has none
        ways[:, 1:] = ways[:, 1:].cumsum(axis=1).cumsum(axis=1)
        ways[:, 1:] += ways[:, :1]


def _wrapped(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Modulo 2^16, as a signed number."""
    return ((values + (1 << 15)) & 0xFFFF) - (1 << 15)


def _range_residuals(ranges: NDArray[np.int64], predictor: int) -> NDArray[np.int64]:
    """Across: row-major differences from the beam before, the first from the previous scan's first, that from 0."""
    residuals = ranges.copy()
    if predictor == _IN_TIME:
        residuals[1:] -= ranges[:-1]
        residuals[0, 1:] -= ranges[0, :-1]
    else:
        residuals[:, 1:] -= ranges[:, :-1]
        residuals[1:, :1] -= ranges[:-1, :1]
    return _wrapped(residuals.ravel())


def _ranges(residuals: NDArray[np.int64], predictor: int) -> NDArray[np.int64]:
    if predictor == _IN_TIME:
        residuals[0] = residuals[0].cumsum()
        total = residuals.cumsum(axis=0)
    else:
        residuals[:, :1] = residuals[:, :1].cumsum(axis=0)
        total = residuals.cumsum(axis=1)
    return np.asarray(total & 0xFFFF, dtype=np.int64)
