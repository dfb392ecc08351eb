"""The microcontroller's end of the line, for simulated robots and tests: a pseudo-terminal that speaks its frames.

Laws kept here: nothing here ever waits. What nobody listens to, or what does not fit into the terminal's buffer, is
dropped whole and counted, as a real microcontroller does with a full buffer; a frame that was begun is finished before
the next one. The other side may close and open its end as often as it likes.
"""

from __future__ import annotations

import os
import select
import tty
from collections import Counter
from typing import Self

from transport.framing import wrap
from transport.mcu_frames import TO_MCU, Drive, Frame, Heartbeat, encode
from transport.mcu_reader import FrameReader

_CHUNK = 4096


class McuPort:
    """A serial port as the microcontroller sees it.

    Args:
        fd: a file descriptor for both directions, from now on ours. It is made non-blocking.
        path: where the computer finds the other end.

    Attributes:
        path: what to give to `transport.mcu_link.McuLink` as its port.
        counters: ``sent`` (frames), ``good``, ``damaged``, ``unknown_<reason>``, and ``dropped_unheard`` (frames said
            while nobody had the port open), ``dropped_full`` (somebody has, and does not read).
    """

    def __init__(self, fd: int, path: str) -> None:
        os.set_blocking(fd, False)
        self.path = path
        self.counters: Counter[str] = Counter()
        self._fd = fd
        self._unwritten = b""
        self._reader = FrameReader[Drive | Heartbeat](TO_MCU, self.counters)

    @classmethod
    def open_pty(cls) -> Self:
        """A new pseudo-terminal; ``path`` is the end that stands for ``/dev/ttyACM0``."""
        ours, theirs = os.openpty()
        tty.setraw(theirs)  # no echo, no line editing, no translation, before anybody opens it by its path
        path = os.ttyname(theirs)
        os.close(theirs)
        return cls(ours, path)

    def fileno(self) -> int:
        """For `select`: readable when there is something to receive (or nobody at the other end)."""
        return self._fd

    def send(self, frame: Frame) -> bool:
        """Say the frame, if somebody listens and it fits; whether it did."""
        return self.write(wrap(encode(frame)))

    def write(self, data: bytes) -> bool:
        """Give the bytes to the line as they are: all of them, or none; whether it did."""
        self._check_open()
        if not self.is_heard:
            self._unwritten = b""
            self.counters["dropped_unheard"] += 1
            return False
        self._unwritten = self._put(self._unwritten)
        if self._unwritten:
            self.counters["dropped_full"] += 1
            return False
        rest = self._put(data)
        if len(rest) == len(data):
            self.counters["dropped_full"] += 1
            return False
        self._unwritten = rest
        self.counters["sent"] += 1
        return True

    def receive(self) -> list[Drive | Heartbeat]:
        """What the computer said since the last time, oldest first."""
        self._check_open()
        frames: list[Drive | Heartbeat] = []
        while chunk := self._get():
            frames += self._reader.feed(chunk)
        return frames

    @property
    def is_heard(self) -> bool:
        """Whether somebody has the other end open."""
        poll = select.poll()
        poll.register(self._fd, 0)  # asks for nothing; that the other end hung up is told anyway
        return not poll.poll(0)

    def close(self) -> None:
        """Pull the cable: the other end reads an error, and ``path`` is gone. Safe to call twice."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._fd < 0:
            raise RuntimeError("the port is closed")

    def _put(self, data: bytes) -> bytes:
        try:
            return data[os.write(self._fd, data) :] if data else b""
        except OSError:  # full, or hung up since we looked
            return data

    def _get(self) -> bytes:
        try:
            return os.read(self._fd, _CHUNK)
        except OSError:  # nothing there (EAGAIN), or nobody (EIO, until the other end is opened again)
            return b""
