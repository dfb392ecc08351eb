"""The map itself as a file: an npz archive that holds the exact evidence and the digest that proves it.

Laws kept here: the same map gives the same bytes; what is read back is the map that was written, or a ValueError.

| entry | what it is |
|---|---|
| ``evidence`` | int32, (rows, columns), units of 0.01 nat; row 0 is south, column 0 is west |
| ``origin`` | float64, (2,): x and y in metres of the lower-left corner of cell [0, 0], on the lattice |
| ``cell`` | float64: the cell size in metres, a whole number of millimetres |
| ``digest`` | text: the map digest, 32 hexadecimal digits |
"""

from __future__ import annotations

import io
import zipfile

import numpy as np
from numpy.typing import NDArray

from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.tiles import frozen

MAX_INFLATED = 1 << 30
"""Bytes that an archive may unpack to (a map of 16,384 x 16,384 cells): a small file must not fill the memory."""

_MAX_INDEX = 1 << 31
"""Cell indices are int32 everywhere."""


def encode_npz(grid: Grid) -> bytes:
    """The map as a compressed npz archive; the same bytes for the same grid (zip entries carry no time)."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        evidence=grid.evidence.astype("<i4"),
        origin=np.array(grid.origin, "<f8"),
        cell=np.array(grid.lattice.cell, "<f8"),
        digest=np.array(grid.digest().hex()),
    )
    return buffer.getvalue()


def decode_npz(data: bytes) -> Grid:
    """The map in an npz archive.

    Raises:
        ValueError: not an archive, an entry is missing or has the wrong shape or type, the origin is off the lattice,
            or the digest is not that of the evidence.
    """
    entries = _entries(data)
    evidence = _entry(entries, "evidence", "int32 (rows, columns)", "i4", 2)
    origin = _entry(entries, "origin", "float64 (2,)", "f8", 1)
    cell = _entry(entries, "cell", "float64 ()", "f8", 0)
    digest = _entry(entries, "digest", "text", "U", 0)
    if origin.shape != (2,):
        raise ValueError(f"origin: expected float64 (2,), got shape {origin.shape}")
    lattice = checked_lattice(float(cell.item()), "cell")
    x, y = origin.tolist()
    i0, j0 = corner_cell(x, y, lattice, evidence.shape)
    grid = Grid(frozen(np.ascontiguousarray(evidence, dtype=np.int32)), i0, j0, lattice)
    found = grid.digest().hex()
    if str(digest) != found:
        raise ValueError(f"digest: the file says {str(digest)[:40]!r}, its evidence has {found}: the file is damaged")
    return grid


def checked_lattice(cell: float, name: str) -> Lattice:
    """The lattice of a file that calls its cell size ``name``, in metres.

    Raises:
        ValueError: not a whole number of millimetres from 1 mm to 10 m.
    """
    if not 0 < cell <= 10:
        raise ValueError(f"{name}: {cell} m, expected 0.001 to 10")
    return Lattice.of(cell)


def corner_cell(x: float, y: float, lattice: Lattice, shape: tuple[int, ...]) -> tuple[int, int]:
    """Cell indices (i0, j0) of a map's lower-left cell from its lower-left corner in metres.

    Args:
        x: metres.
        y: metres.
        lattice: the cell size.
        shape: the map's (rows, columns).

    Raises:
        ValueError: not finite, off the lattice by more than a micrometre (no map is ever shifted or resampled; the
            message names the nearest corner that lies on it), or beyond the range of int32 cell indices.
    """
    if not (abs(x) < 1e9 and abs(y) < 1e9):
        raise ValueError(f"origin: ({x}, {y}) m, expected finite numbers within a million kilometres")
    i0, j0 = round(x * 1000 / lattice.cell_mm), round(y * 1000 / lattice.cell_mm)
    if max(abs(i0), abs(j0)) + max(shape) > _MAX_INDEX:
        raise ValueError(f"origin: ({x}, {y}) m is too far away for cells of {lattice.cell} m")
    on_x, on_y = i0 * lattice.cell_mm / 1000, j0 * lattice.cell_mm / 1000
    if max(abs(x - on_x), abs(y - on_y)) > 1e-6:
        raise ValueError(
            f"origin: ({x}, {y}) m is not a corner of a cell of {lattice.cell} m; the nearest is ({on_x}, {on_y})"
        )
    return i0, j0


def _entries(data: bytes) -> dict[str, NDArray[np.generic]]:
    """All arrays of an archive of bounded size, without pickles."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            inflated = sum(entry.file_size for entry in archive.infolist())
        if inflated > MAX_INFLATED:
            raise ValueError(f"it unpacks to {inflated} bytes, more than {MAX_INFLATED}")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {name: np.asarray(arrays[name]) for name in arrays.files}
    # zipfile, zlib and NumPy's header parser raise a dozen kinds of exception on damaged bytes.
    except Exception as error:
        raise ValueError(f"not a readable npz archive: {error}") from error


def _entry(
    entries: dict[str, NDArray[np.generic]], name: str, expected: str, kind: str, dimensions: int
) -> NDArray[np.generic]:
    if name not in entries:
        raise ValueError(f"{name}: missing, expected {expected}")
    array = entries[name]
    if not array.dtype.str[1:].startswith(kind) or array.ndim != dimensions:
        raise ValueError(f"{name}: expected {expected}, got {array.dtype} {array.shape}")
    return array
