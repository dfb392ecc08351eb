"""How a message survives a serial line: a checksum behind it, no zero byte in it, and a zero byte after it.

A frame is COBS(content + CRC) + ``00``. Consistent Overhead Byte Stuffing (Cheshire and Baker, IEEE/ACM Transactions on
Networking 7(2), 1999) takes every zero out of the content at the price of one byte in 254, so that a zero can only be
the end of a frame. The checksum is CRC-16/CCITT-FALSE, the CRC catalogue's CRC-16/IBM-3740 (polynomial 0x1021, start
0xFFFF, no reflection; of ``123456789`` it is 0x29B1), little-endian.

Laws kept here: any chunking of a stream gives the same frames; damage costs the frames that it touches and no others;
no input raises, and none takes more memory than the longest frame.
"""

from __future__ import annotations

from collections import Counter

from cobs import cobs
from fastcrc import crc16

DELIMITER = b"\0"
MAX_CONTENT = 512
"""The longest content, in bytes, unless a deframer says otherwise."""

_CRC_BYTES = 2


def wrap(content: bytes) -> bytes:
    """The content as it goes over the line, with its delimiter."""
    frame: bytes = cobs.encode(content + crc16.ibm_3740(content).to_bytes(_CRC_BYTES, "little")) + DELIMITER
    return frame


def longest_frame(content_bytes: int) -> int:
    """The bytes that `wrap` makes of that many bytes of content, at most."""
    stuffed = content_bytes + _CRC_BYTES
    return stuffed + stuffed // 254 + 1 + len(DELIMITER)


class Deframer:
    """Finds the frames in a stream of bytes.

    Args:
        counters: where ``good`` and ``damaged`` frames are counted. Damaged is what lies between two delimiters and is
            no frame: bad COBS, a wrong checksum, too long. Nothing at all between two delimiters is no damage.
        max_content: the longest content in bytes; a longer one is damage.
    """

    def __init__(self, counters: Counter[str] | None = None, *, max_content: int = MAX_CONTENT) -> None:
        self.counters: Counter[str] = Counter() if counters is None else counters
        self._max_content = max_content
        self._max_stuffed = longest_frame(max_content) - len(DELIMITER)
        self._unfinished = b""
        self._overlong = False  # what is unfinished was too long and is thrown away until the next delimiter

    def feed(self, chunk: bytes) -> list[bytes]:
        """The contents of the frames that end in this chunk, oldest first."""
        *pieces, rest = (self._unfinished + chunk).split(DELIMITER)
        contents = [content for content in map(self._content, pieces) if content is not None]
        self._overlong = self._overlong or len(rest) > self._max_stuffed
        self._unfinished = b"" if self._overlong else rest
        return contents

    def forget(self) -> None:
        """Drop an unfinished frame: its end will not come, for the line was cut."""
        self._unfinished = b""
        self._overlong = False

    def _content(self, piece: bytes) -> bytes | None:
        overlong, self._overlong = self._overlong, False
        if not piece and not overlong:
            return None
        content = None if overlong or len(piece) > self._max_stuffed else _checked(piece)
        if content is None or len(content) > self._max_content:
            self.counters["damaged"] += 1
            return None
        self.counters["good"] += 1
        return content


def _checked(piece: bytes) -> bytes | None:
    try:
        stuffed: bytes = cobs.decode(piece)
    except cobs.DecodeError:
        return None
    content, crc = stuffed[:-_CRC_BYTES], stuffed[-_CRC_BYTES:]
    return content if crc16.ibm_3740(content).to_bytes(_CRC_BYTES, "little") == crc else None
