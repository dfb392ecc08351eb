"""Scans as an update carries them: differences from what could be expected, in a few bits each.

Poses and stamps are predicted to go on as they went (second differences), a range to equal its neighbour in the scan or
the same beam's last one, whichever makes the block shorter. Five beams at 10 Hz come to about five bytes a scan.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from mapping.pose import FULL_TURN
from mapping.scan import INVALID, NO_RETURN, Scans
from swarm.bits import pack, unpack
from swarm.drops import Drop
from swarm.limits import MAX_COORDINATE_MM, MAX_SCANS

_HEADER = struct.Struct("<BHqiiH")  # predictor, scans, and the first scan's stamp_ms, x_mm, y_mm, yaw_turn16
_ACROSS, _IN_TIME = 0, 1
_FAR = 8  # bytes of an escaped stamp or coordinate
_NEAR = 2  # bytes of an escaped yaw or range, which wrap at 16 bits


def encode_scans(scans: Scans) -> bytes:
    """At least one scan, at most ``MAX_SCANS``, of a sensor with any number of beams (none: poses alone)."""
    stamp, (x, y, yaw) = int(scans.stamps_ms[0]), scans.poses[0].tolist()
    ranges = scans.ranges.astype(np.int64)
    across, in_time = (pack(_range_residuals(ranges, predictor), _NEAR) for predictor in (_ACROSS, _IN_TIME))
    predictor = _IN_TIME if len(in_time) < len(across) else _ACROSS
    yaws = scans.poses[:, 2].astype(np.int64)
    return b"".join([
        _HEADER.pack(predictor, len(scans), stamp, x, y, yaw),
        pack(_second_differences(scans.stamps_ms), _FAR),
        pack(_second_differences(scans.poses[:, 0].astype(np.int64)), _FAR),
        pack(_second_differences(scans.poses[:, 1].astype(np.int64)), _FAR),
        pack(_wrapped(_second_differences(yaws)), _NEAR),
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
        predictor, count, stamp, x, y, yaw = _HEADER.unpack_from(block)
        if predictor not in {_ACROSS, _IN_TIME} or not 1 <= count <= MAX_SCANS:
            raise ValueError("scan block: bad header")
        rest = block[_HEADER.size :]
        stamp_residuals, rest = unpack(rest, count - 1, _FAR)
        x_residuals, rest = unpack(rest, count - 1, _FAR)
        y_residuals, rest = unpack(rest, count - 1, _FAR)
        yaw_residuals, rest = unpack(rest, count - 1, _NEAR)
        range_residuals, rest = unpack(rest, count * beams, _NEAR)
    except (ValueError, struct.error):
        raise Drop("bad_payload") from None
    xs, ys = _integrated(x, x_residuals), _integrated(y, y_residuals)
    ranges = _ranges(range_residuals.reshape(count, beams), predictor)
    bad_range = (ranges != INVALID) & (ranges != NO_RETURN) & (ranges > max_range_mm)
    if rest or max(_largest(xs), _largest(ys)) > MAX_COORDINATE_MM or bad_range.any():
        raise Drop("bad_payload")
    poses = np.stack([xs, ys, _integrated(yaw, yaw_residuals) % FULL_TURN], axis=1).astype(np.int32)
    return Scans(_integrated(stamp, stamp_residuals), poses, ranges.astype(np.uint16))


def _largest(values: NDArray[np.int64]) -> int:
    return max(abs(int(values.min())), abs(int(values.max())))


def _second_differences(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Differences of the N - 1 steps from the step before, the first from a step of zero."""
    return np.diff(np.diff(values), prepend=0)


def _integrated(first: int, residuals: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([[first], first + np.cumsum(np.cumsum(residuals))]).astype(np.int64)


def _wrapped(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Modulo 2^16, as a signed number."""
    return (values + (1 << 15)) % (1 << 16) - (1 << 15)


def _range_residuals(ranges: NDArray[np.int64], predictor: int) -> NDArray[np.int64]:
    """Across: row-major differences from the beam before, the first from the previous scan's first, that from 0."""
    if predictor == _IN_TIME:
        first = np.diff(ranges[0], prepend=0)
        return _wrapped(np.concatenate([first, np.diff(ranges, axis=0).ravel()]))
    residuals = np.diff(ranges, axis=1, prepend=0)
    residuals[:, :1] = np.diff(ranges[:, :1], axis=0, prepend=0)
    return _wrapped(residuals.ravel())


def _ranges(residuals: NDArray[np.int64], predictor: int) -> NDArray[np.int64]:
    residuals = residuals.copy()
    if predictor == _IN_TIME:
        residuals[0] = np.cumsum(residuals[0])
        total = np.cumsum(residuals, axis=0)
    else:
        residuals[:, :1] = np.cumsum(residuals[:, :1], axis=0)
        total = np.cumsum(residuals, axis=1)
    return np.asarray(total % (1 << 16), dtype=np.int64)
