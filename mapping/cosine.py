"""The cosine table that every peer shares: 65,536 entries in Q14, the same integers on every machine.

Entry k is cos(2 pi k / 65536) * 16384 rounded to the nearest integer. No entry lies nearer than 8.8e-7 to a
rounding boundary, and the error of a double is some 4e-12, so any sane libm builds the same table; the SHA-256
is checked at import all the same, because a map is only worth sharing if everybody's cells agree.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from mapping.pose import FULL_TURN

Q = 14
"""Fraction bits of the table."""

TABLE_SHA256 = "201381c9a5cc2c47c70ef2c8d4eb59213bc443f363bd1ca3bb6661454cce59fe"
"""SHA-256 of the table as 65,536 little-endian int16."""


def _build() -> NDArray[np.int64]:
    turns = np.arange(FULL_TURN) / FULL_TURN
    table: NDArray[np.int64] = np.rint(np.cos(2 * np.pi * turns) * (1 << Q)).astype(np.int64)
    found = hashlib.sha256(table.astype("<i2").tobytes()).hexdigest()
    if found != TABLE_SHA256:
        raise RuntimeError(
            f"the cosine table has SHA-256 {found}, expected {TABLE_SHA256}: "
            "this machine's cos() would draw other maps than everybody else's"
        )
    table.setflags(write=False)
    return table


COSINE: NDArray[np.int64] = _build()


def cosine(turn16: NDArray[np.int64]) -> NDArray[np.int64]:
    """Q14 cosine of integer angles (any integers; they wrap)."""
    return COSINE.take(turn16 & (FULL_TURN - 1))


def sine(turn16: NDArray[np.int64]) -> NDArray[np.int64]:
    """Q14 sine of integer angles: the cosine a quarter turn earlier."""
    return COSINE.take((turn16 - FULL_TURN // 4) & (FULL_TURN - 1))


DIRECTIONS = np.stack([COSINE, sine(np.arange(FULL_TURN))]).astype(np.float64)
"""Q14 cosine and sine of every angle, shape (2, 65536): whole numbers as doubles, which NumPy multiplies faster."""


def direction(turn16: NDArray[np.int64]) -> NDArray[np.float64]:
    """Q14 cosine and sine of integer angles at once: shape (2, *turn16.shape), whole numbers."""
    return DIRECTIONS.take(turn16 & (FULL_TURN - 1), axis=1)
