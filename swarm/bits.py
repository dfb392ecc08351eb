"""Small whole numbers as few bits: Rice codes in two streams, so that both ways can be array operations.

A signed value v becomes u = 2 v or -2 v - 1 (zigzag), u its quotient u >> k and k low bits. First come all quotients in
unary (q ones and a zero), then all low bits, each stream padded with zeros to whole bytes, most significant bit first.
A quotient of 15 or more is written as 15, and u itself follows whole after both streams.

Few values, such as one scan's of a small robot, are coded in plain Python: an array operation takes a microsecond to
begin, and each way needs dozens.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ESCAPE = 15
_MAX_K = 31
_FEW = 64


def _best_k(u: NDArray[np.uint64], width: int) -> int:
    """The shorter of the parameters around the median's length; any parameter decodes."""
    around = ((len(u) - 1) // 2, len(u) // 2)
    low, high = np.partition(u, around)[list(around)].tolist()

    def size(k: int) -> int:
        q = u >> np.uint64(k)
        return int(np.minimum(q, _ESCAPE).sum()) + len(u) * (1 + k) + int((q >= _ESCAPE).sum()) * width * 8

    return min(_candidates(low, high), key=size)


def _candidates(low: int, high: int) -> list[int]:
    """Parameters around the length of a median that lies between these two."""
    middle = min(((low + high) // 2).bit_length(), _MAX_K)
    return [k for k in (middle - 1, middle, middle + 1) if 0 <= k <= _MAX_K]


def pack(values: NDArray[np.int64], width: int) -> bytes:
    """Encode signed values.

    Args:
        values: int64, shape (N,); each fits in ``width`` bytes.
        width: bytes of an escaped value: 2 or 8.
    """
    if len(values) <= _FEW:
        return _pack_few(values.tolist(), width)
    u = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    k = _best_k(u, width)
    q = np.minimum(u >> np.uint64(k), _ESCAPE).astype(np.int64)
    zeros = np.cumsum(q + 1) - 1
    unary = np.ones(int(zeros[-1]) + 1, np.uint8)
    unary[zeros] = 0
    shifts = np.arange(k - 1, -1, -1, dtype=np.uint64)
    low = ((u[:, None] >> shifts) & np.uint64(1)).astype(np.uint8)
    escaped = u[q == _ESCAPE].astype(f"<u{width}")
    return b"".join([bytes([k]), np.packbits(unary).tobytes(), np.packbits(low).tobytes(), escaped.tobytes()])


def unpack(data: bytes, count: int, width: int) -> tuple[NDArray[np.int64], bytes]:
    """Decode ``count`` values; also gives what follows them.

    Raises:
        ValueError: the data ends too soon.
    """
    if not data or data[0] > _MAX_K:
        raise ValueError("bits: no parameter")
    if count <= _FEW:
        few, rest = _unpack_few(data, count, width)
        return np.array(few, np.int64), rest
    k, data = data[0], data[1:]
    longest = (count * (_ESCAPE + 1) + 7) // 8
    unary = np.unpackbits(np.frombuffer(data[:longest], np.uint8))
    zeros = np.flatnonzero(unary == 0)[:count]
    if len(zeros) < count:
        raise ValueError("bits: the quotients end too soon")
    q = np.diff(zeros, prepend=-1) - 1
    if (q > _ESCAPE).any():
        raise ValueError("bits: a quotient is too large")
    data = data[(int(zeros[-1]) + 8) // 8 :]
    length = (count * k + 7) // 8
    if len(data) < length:
        raise ValueError("bits: the low bits end too soon")
    low = np.unpackbits(np.frombuffer(data[:length], np.uint8))[: count * k].reshape(count, k).astype(np.int64)
    u = ((q << k) + low @ (1 << np.arange(k - 1, -1, -1, dtype=np.int64))).astype(np.uint64)
    data = data[length:]
    escapes = np.flatnonzero(q == _ESCAPE)
    if len(data) < len(escapes) * width:
        raise ValueError("bits: the escaped values end too soon")
    u[escapes] = np.frombuffer(data[: len(escapes) * width], f"<u{width}")
    values = (u >> np.uint64(1)).astype(np.int64) ^ -(u & np.uint64(1)).astype(np.int64)
    return values, data[len(escapes) * width :]


def _pack_few(values: list[int], width: int) -> bytes:
    """The same bytes as of many."""
    if not values:
        return b"\0"
    u = [2 * v if v >= 0 else -2 * v - 1 for v in values]
    ordered = sorted(u)

    def size(k: int) -> int:
        q = [each >> k for each in u]
        return sum(each if each < _ESCAPE else _ESCAPE + width * 8 for each in q) + len(u) * (1 + k)

    k = min(_candidates(ordered[(len(u) - 1) // 2], ordered[len(u) // 2]), key=size)
    unary, bits, low, escaped = 0, 0, 0, b""
    for each in u:
        q = each >> k
        if q >= _ESCAPE:
            q = _ESCAPE
            escaped += each.to_bytes(width, "little")
        unary = (unary << q + 1) | ((1 << q + 1) - 2)
        low = (low << k) | (each & ((1 << k) - 1))
        bits += q + 1
    return bytes([k]) + _left(unary, bits) + _left(low, len(u) * k) + escaped


def _left(number: int, bits: int) -> bytes:
    """So many bits, padded with zeros to whole bytes."""
    length = (bits + 7) // 8
    return (number << 8 * length - bits).to_bytes(length)


def _unpack_few(data: bytes, count: int, width: int) -> tuple[list[int], bytes]:
    """The same values as of many."""
    if not count:
        return [], data[1:]
    k, unary = data[0], data[1 : 1 + 2 * count]  # sixteen bits a quotient at most
    digits = f"{int.from_bytes(unary):0{8 * len(unary)}b}" if unary else ""
    runs = digits.split("0", count)
    if len(runs) <= count:
        raise ValueError("bits: the quotients end too soon")
    quotients = [len(run) for run in runs[:count]]
    if max(quotients) > _ESCAPE:
        raise ValueError("bits: a quotient is too large")
    at = 1 + (sum(quotients) + count + 7) // 8
    length = (count * k + 7) // 8
    if len(data) < at + length:
        raise ValueError("bits: the low bits end too soon")
    low, shift = int.from_bytes(data[at : at + length]), 8 * length
    at += length
    values = []
    for q in quotients:
        shift -= k
        u = (q << k) | (low >> shift & ((1 << k) - 1))
        if q == _ESCAPE:
            if len(data) < at + width:
                raise ValueError("bits: the escaped values end too soon")
            u = int.from_bytes(data[at : at + width], "little")
            at += width
        values.append(u >> 1 ^ -(u & 1))
    return values, data[at:]
