"""PGM pictures, 8 bit: bytes to an array of brightness and back (netpbm's ``pgm(5)``).

P5 (binary) and P2 (ASCII) are read, with comments and any maximum from 1 to 255; P5 is written. Row 0 is the top.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

_GAP = rb"(?:\s|#[^\n\r]*[\n\r])"
_HEADER = re.compile(
    rb"P(?P<kind>[25])"
    + _GAP
    + rb"+(?P<width>\d{1,9})"
    + _GAP
    + rb"+(?P<height>\d{1,9})"
    + _GAP
    # Exactly one blank after the maximum: the next byte is already a pixel of a P5.
    + rb"+(?P<maximum>\d{1,9})(?:#[^\n\r]*[\n\r]|\s|$)"
)
_COMMENT = re.compile(rb"#[^\n\r]*")
_NO_NUMBER = re.compile(rb"[^\s\d]")


def encode_pgm(pixels: NDArray[np.uint8]) -> bytes:
    """A P5 picture with maximum 255.

    Args:
        pixels: shape (height, width), at least 1 x 1.
    """
    height, width = pixels.shape
    return b"P5\n%d %d\n255\n" % (width, height) + np.ascontiguousarray(pixels).tobytes()


def decode_pgm(data: bytes) -> tuple[NDArray[np.uint8], int]:
    """The pixels, shape (height, width), and the maximum, which stands for white. What follows them is ignored.

    Raises:
        ValueError: not a P2 or P5 picture of 8 bit, truncated, or a pixel exceeds the maximum.
    """
    header = _HEADER.match(data)
    if header is None:
        raise ValueError(f"not a PGM picture: expected P2 or P5, width, height, maximum, got {data[:16]!r}")
    width, height, maximum = (int(header[name]) for name in ("width", "height", "maximum"))
    if width == 0 or height == 0:
        raise ValueError(f"picture: {width} x {height} pixels, expected at least 1 x 1")
    if not 1 <= maximum <= 255:
        raise ValueError(f"picture: the maximum is {maximum}, expected 1 to 255 (8 bit)")
    read = _plain if header["kind"] == b"2" else _raw
    pixels = read(data, header.end(), width * height).reshape(height, width)
    if pixels.max() > maximum:
        row, column = np.argwhere(pixels > maximum)[0].tolist()
        raise ValueError(
            f"picture: pixel {pixels[row, column]} in row {row}, column {column} exceeds the maximum {maximum}"
        )
    return pixels, maximum


def _raw(data: bytes, start: int, count: int) -> NDArray[np.uint8]:
    if len(data) - start < count:
        raise ValueError(f"picture: expected {count} pixels from byte {start}, got {len(data) - start}: truncated")
    return np.frombuffer(data, np.uint8, count, start)


def _plain(data: bytes, start: int, count: int) -> NDArray[np.uint8]:
    body = _COMMENT.sub(b"", data[start:])
    bad = _NO_NUMBER.search(body)
    if bad is not None:
        at = len(body[: bad.start()].split())
        raise ValueError(f"picture: expected numbers from byte {start}, found {bad[0]!r} after pixel number {at}")
    words = body.split(maxsplit=count)[:count]
    if len(words) < count:
        raise ValueError(f"picture: expected {count} pixels from byte {start}, got {len(words)}: truncated")
    # Whatever exceeds a byte exceeds the maximum too.
    values = [int(word) if len(word) <= 9 else 256 for word in words]
    if max(values) > 255:
        at = next(k for k, value in enumerate(values) if value > 255)
        raise ValueError(f"picture: pixel number {at} is {words[at][:12].decode()}, expected at most 255")
    return np.array(values, np.uint8)
