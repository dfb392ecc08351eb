"""A robot's computer talks to its microcontroller: samples and events in, wheel speeds and heartbeats out.

Laws kept here: what the wire brings, or the cable's end, never raises; wheels turn only on fresh knowledge, so the last
thing said to a microcontroller that fell silent is to stop. That is half of the safety: the other half is the
microcontroller's, which stops by itself when ``valid_ms`` passed without another drive, for we cannot say anything over
a cable that is pulled.

The line's thread only puts decoded frames into a bounded queue; all else happens in the calls of the thread that owns
the robot. If that thread hangs, so do the drives and the heartbeats, as they should.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from transport.frame_queue import FrameQueue
from transport.framing import DELIMITER, wrap
from transport.mcu_frames import FROM_MCU, Drive, Heartbeat, Hello, Sample, encode
from transport.mcu_reader import FrameReader
from transport.sample_watch import SampleWatch
from transport.serial_line import SerialLine

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class LinkBack:
    """The port is open: for the first time, or again."""


@dataclass(frozen=True, slots=True)
class LinkLost:
    """The port is gone, or is not there yet; it is tried again until it is. Told once until `LinkBack`."""

    reason: str


@dataclass(frozen=True, slots=True)
class Stalled:
    """The port is open and no sample comes, for so many seconds. Told once until a sample comes."""

    seconds: float


Heard = Hello | Sample | Heartbeat
Event = Heard | LinkBack | LinkLost | Stalled

_ANSWER_TIME = 2.0
"""Seconds in which a hello is an answer to our asking; one that comes unasked is that of a restart."""


class McuLink:
    """The computer's end of the microcontroller's line. Belongs to one thread.

    Args:
        port: a device or pyserial URL, see `SerialLine`; it need not be there yet.
        baudrate: bits a second; USB, pseudo-terminals and sockets ignore it.
        stall: seconds without a sample after which wheels are stopped.
        late_after: seconds by which a sample's delay may exceed the fastest one's.
        heartbeat: seconds between two of ours.
        write_timeout: seconds that a write may take if the microcontroller does not read.
        retry: seconds until a lost port is tried again: at first, and at most; it doubles in between.
        max_frames: how many frames and events wait for `receive` at most; the oldest go first.
        clock: seconds, monotonic; called on two threads.

    Attributes:
        counters: frames ``good``, ``damaged`` and ``unknown_<reason>`` (see `FrameReader`); samples ``lost`` and
            ``late``, and ``restarts`` of the microcontroller (see `SampleWatch`); ``dropped_queue_full``; of ours
            ``sent``, ``unsent`` (the port did not take it) and ``refused`` drives; ``outages`` of the port, ``stalls``.

    Raises:
        ValueError: nothing could ever be opened under that port's name.
    """

    def __init__(
        self,
        port: str,
        *,
        baudrate: int = 115_200,
        stall: float = 0.5,
        late_after: float = 0.1,
        heartbeat: float = 1.0,
        write_timeout: float = 0.1,
        retry: tuple[float, float] = (0.1, 2.0),
        max_frames: int = 1024,
        clock: Clock = time.monotonic,
    ) -> None:
        self.port = port
        self.counters: Counter[str] = Counter()
        self._stall = stall
        self._heartbeat = heartbeat
        self._clock = clock
        self._answers = 0
        self._beats = 0
        self._next_beat = clock()
        self._stall_told_of: float | None = None
        self._is_clean = False  # whether the microcontroller has seen the end of what we said before
        self._closed = False
        self._ears = _Ears(self.counters, late_after=late_after, max_frames=max_frames, clock=clock)
        self._line = SerialLine(port, self._ears, baudrate=baudrate, write_timeout=write_timeout, retry=retry)

    @property
    def hello(self) -> Hello | None:
        """What the microcontroller is made of, if it said so since the port was opened and it started."""
        return self._ears.hello

    @property
    def is_flowing(self) -> bool:
        """Whether the port is open and the newest sample is younger than ``stall``: whether a drive is sent."""
        heard_at = self._ears.heard_at
        return self._ears.has_sample and heard_at is not None and self._clock() - heard_at <= self._stall

    def receive(self, timeout: float = 0.0) -> list[Event]:
        """Everything that came in, oldest first; waits up to ``timeout`` (real) seconds if there is nothing yet.

        It is also what sends heartbeats and finds stalls, so call it several times a second. After `close` it gives
        nothing.
        """
        deadline = time.monotonic() + timeout
        wait = 0.0
        while not self._closed:
            events = self._ears.queue.take(wait)
            for event in events:
                self._note(event)
            events += self._attend()
            wait = min(deadline - time.monotonic(), self._until_due())
            if events or wait <= 0.0:
                return events
        return []

    def drive(self, left_mm_s: int, right_mm_s: int, *, valid_ms: int = 300, answers: int | None = None) -> bool:
        """Turn the wheels, for a while.

        Unless samples are flowing, the wheels are told to stop instead.

        Args:
            left_mm_s: the left wheel's speed.
            right_mm_s: the right wheel's speed.
            valid_ms: when the microcontroller stops by itself.
            answers: the newest sample that it takes into account; the newest that `receive` gave, unless told.

        Returns:
            Whether it was sent.

        Raises:
            ValueError: a value does not fit into its field.
        """
        self._check_open()
        drive = Drive(self._answers if answers is None else answers, left_mm_s, right_mm_s, valid_ms)
        content = encode(drive)
        if not self.is_flowing:
            self.counters["refused"] += 1
            self.stop()
            return False
        return self._say(content)

    def stop(self) -> bool:
        """Stop the wheels, whatever is known; whether it was sent."""
        self._check_open()
        return self._say(encode(Drive(self._answers, 0, 0, 0)))

    def close(self) -> None:
        """Stop the wheels and let go of the port. Safe to call twice; afterwards `drive` raises ``RuntimeError``."""
        if self._closed:
            return
        self.stop()
        self._closed = True
        self._line.close()
        self._ears.queue.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._closed:
            raise RuntimeError(f"{self.port}: the link is closed")

    def _note(self, event: Event) -> None:
        if isinstance(event, Sample):
            self._answers = event.sequence
        elif isinstance(event, LinkBack):
            self._is_clean = False
            self._next_beat = self._clock()
            self.stop()

    def _attend(self) -> list[Event]:
        """What the clock asks for."""
        now, heard_at = self._clock(), self._ears.heard_at
        if heard_at is None:
            return []
        if now >= self._next_beat:
            self._next_beat = now + self._heartbeat
            self._beat(now)
        if now - heard_at <= self._stall or heard_at == self._stall_told_of:
            return []
        self._stall_told_of = heard_at
        self.counters["stalls"] += 1
        self.stop()
        return [Stalled(now - heard_at)]

    def _until_due(self) -> float:
        """Seconds until `_attend` has something to do; a millisecond at least, for a clock that stands still."""
        heard_at = self._ears.heard_at
        if heard_at is None:
            return self._heartbeat
        dues = [self._next_beat] if heard_at == self._stall_told_of else [self._next_beat, heard_at + self._stall]
        return max(0.001, min(dues) - self._clock())

    def _beat(self, now: float) -> None:
        asks = self._ears.hello is None
        if asks:
            self._ears.asked_at = now
        good, damaged = self.counters["good"] % 2**32, self.counters["damaged"] % 2**32
        self._say(encode(Heartbeat(self._beats, int(asks), good, damaged)))
        self._beats = (self._beats + 1) % 2**16

    def _say(self, content: bytes) -> bool:
        frame = wrap(content)
        self._is_clean = self._line.write(frame if self._is_clean else DELIMITER + frame)
        self.counters["sent" if self._is_clean else "unsent"] += 1
        return self._is_clean


class _Ears:
    """What happens on the line's thread: bytes become frames, and their moment is noted.

    Attributes:
        heard_at: when the port was opened or the newest sample came, whichever is later; None while there is no port.
        has_sample: whether a sample came since the port was opened.
        asked_at: when a heartbeat last asked for a hello; the owner's thread says.
        hello: the newest since the port was opened and the microcontroller started.
    """

    def __init__(self, counters: Counter[str], *, late_after: float, max_frames: int, clock: Clock) -> None:
        self.queue: FrameQueue[Event] = FrameQueue(counters, max_items=max_frames)
        self.heard_at: float | None = None
        self.has_sample = False
        self.asked_at = float("-inf")
        self.hello: Hello | None = None
        self._clock = clock
        self._counters = counters
        self._reader = FrameReader[Heard](FROM_MCU, counters)
        self._watch = SampleWatch(counters, late_after=late_after)

    def line_opened(self) -> None:
        self._reader.forget()
        self.hello = None
        self.has_sample = False
        self.heard_at = self._clock()
        self.queue.put(LinkBack())

    def line_read(self, chunk: bytes) -> None:
        frames, now = self._reader.feed(chunk), self._clock()
        for frame in frames:
            if isinstance(frame, Sample):
                if self._watch.hear(frame, now):
                    self.hello = None  # what started anew may be made of other things
                self.heard_at = now
                self.has_sample = True
            elif isinstance(frame, Hello):
                if now - self.asked_at > _ANSWER_TIME:
                    self._watch.restart()
                self.hello = frame
            self.queue.put(frame)

    def line_lost(self, reason: str) -> None:
        self.heard_at = None
        self._counters["outages"] += 1
        self.queue.put(LinkLost(reason))
