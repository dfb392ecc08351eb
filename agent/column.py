"""An array that grows at its end, for what a process gathers over hours; it is copied only when it doubles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_FIRST = 64


class Column:
    """Rows of one shape and type.

    Args:
        dtype: of every number.
        width: shape of a row; () for single numbers.
    """

    def __init__(self, dtype: DTypeLike, width: tuple[int, ...] = ()) -> None:
        self._store: NDArray[Any] = np.empty((_FIRST, *width), dtype)
        self._count = 0

    @classmethod
    def of(cls, rows: NDArray[Any]) -> Column:
        """A column that begins with these rows, which it never writes: whatever is appended makes it a copy first."""
        column = cls(rows.dtype, rows.shape[1:])
        column._store, column._count = rows, len(rows)
        return column

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[Any]:
        """All rows, shape (N, *width), to read and to write; good until the next ``append``."""
        return self._store[: self._count]

    def append(self, rows: NDArray[Any]) -> None:
        """Put rows at the end."""
        count = self._count + len(rows)
        if count > len(self._store):
            grown = np.empty((max(count, 2 * len(self._store)), *self._store.shape[1:]), self._store.dtype)
            grown[: self._count] = self.rows
            self._store = grown
        if len(rows):
            self._store[self._count : count] = rows
            self._count = count

    def clear(self) -> None:
        """Hold nothing."""
        self._count = 0

    def replace(self, rows: NDArray[Any]) -> None:
        """Hold these rows instead of all others."""
        self.clear()
        self.append(rows)
