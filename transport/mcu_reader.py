"""What either end of the microcontroller's line makes of the bytes it hears: frames, and counts of all that was none.

Laws kept here: what the wire brings never raises; a frame is whole and within its limits, or it is a number in a
counter.
"""

from __future__ import annotations

from collections import Counter
from typing import Generic, TypeVar

from transport.framing import Deframer
from transport.mcu_frames import MAX_CONTENT, Frame, FrameError, decode

Heard = TypeVar("Heard", bound=Frame)


class FrameReader(Generic[Heard]):
    """Bytes in, frames out.

    Args:
        expected: the kinds of frames that the other end says.
        counters: where ``good`` and ``damaged`` frames are counted, and the good ones that are none of ours under
            ``unknown_<reason>``, for the reasons of `FrameError` and ``direction`` (it is we who say such things).
    """

    def __init__(self, expected: tuple[type[Heard], ...], counters: Counter[str]) -> None:
        self._expected = expected
        self._counters = counters
        self._deframer = Deframer(counters, max_content=MAX_CONTENT)

    def feed(self, chunk: bytes) -> list[Heard]:
        """The frames that end in this chunk, oldest first."""
        frames: list[Heard] = []
        for content in self._deframer.feed(chunk):
            try:
                frame = decode(content)
            except FrameError as error:
                self._counters[f"unknown_{error.reason}"] += 1
                continue
            if isinstance(frame, self._expected):
                frames.append(frame)
            else:
                self._counters["unknown_direction"] += 1
        return frames

    def forget(self) -> None:
        """Drop an unfinished frame: its end will not come."""
        self._deframer.forget()
