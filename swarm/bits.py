"""Small whole numbers as few bits: Rice codes in two streams, so that both ways are array operations.

A signed value v becomes u = 2 v or -2 v - 1 (zigzag), u its quotient u >> k and k low bits. First come all quotients in
unary (q ones and a zero), then all low bits, each stream padded with zeros to whole bytes, most significant bit first.
A quotient of 15 or more is written as 15, and u itself follows whole after both streams.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ESCAPE = 15
_MAX_K = 31


def _best_k(u: NDArray[np.uint64], width: int) -> int:
    """The shorter of the parameters around the median's length; any parameter decodes."""
    middle = min(int(np.median(u)).bit_length(), _MAX_K) if len(u) else 0

    def size(k: int) -> int:
        q = u >> np.uint64(k)
        return int(np.minimum(q, _ESCAPE).sum()) + len(u) * (1 + k) + int((q >= _ESCAPE).sum()) * width * 8

    return min((k for k in (middle - 1, middle, middle + 1) if 0 <= k <= _MAX_K), key=size)


def pack(values: NDArray[np.int64], width: int) -> bytes:
    """Encode signed values.

    Args:
        values: int64, shape (N,); each fits in ``width`` bytes.
        width: bytes of an escaped value: 2 or 8.
    """
    u = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    k = _best_k(u, width)
    q = np.minimum(u >> np.uint64(k), _ESCAPE).astype(np.int64)
    zeros = np.cumsum(q + 1) - 1
    unary = np.ones(int(zeros[-1]) + 1 if len(u) else 0, np.uint8)
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
    k, data = data[0], data[1:]
    longest = (count * (_ESCAPE + 1) + 7) // 8
    unary = np.unpackbits(np.frombuffer(data[:longest], np.uint8))
    zeros = np.flatnonzero(unary == 0)[:count]
    if len(zeros) < count:
        raise ValueError("bits: the quotients end too soon")
    q = np.diff(zeros, prepend=-1) - 1
    if (q > _ESCAPE).any():
        raise ValueError("bits: a quotient is too large")
    data = data[(int(zeros[-1]) + 8) // 8 if count else 0 :]
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
