"""Numbers that look random and are not: BLAKE2b of a seed and a counter, so that a schedule can be repeated."""

from __future__ import annotations

import hashlib


class Jitter:
    """A stream of numbers in [0, 1), the same for the same seed."""

    def __init__(self, seed: bytes) -> None:
        self._seed = seed
        self._counter = 0

    def fraction(self) -> float:
        """The next number in [0, 1)."""
        self._counter += 1
        digest = hashlib.blake2b(self._counter.to_bytes(8, "little"), key=self._seed[:64], digest_size=8).digest()
        return (int.from_bytes(digest, "little") >> 11) / (1 << 53)

    def between(self, low: float, high: float) -> float:
        """The next number in [low, high)."""
        return low + (high - low) * self.fraction()
