"""What the samples' own numbers betray about the line they came over: how many got lost, which are late, who restarted.

Laws kept here: time is an argument, in seconds of any one clock; nothing is assumed of when the microcontroller
started, nor that its clock is a good one.
"""

from __future__ import annotations

from collections import Counter

from transport.mcu_frames import Sample

DRIFT = 0.01
"""How wrong the microcontroller's clock may run before its samples seem late: an STM32F411 without a crystal keeps
1 % (data sheet DS10314, HSI accuracy at 25 degrees)."""

HASTE = 10.0
"""Seconds that stamps may run ahead of our clock from one sample to the next, for what a buffer held back for a while.
Stamps that jump further ahead have gone back instead, for they wrap (after 49.7 days)."""


class SampleWatch:
    """Counts ``lost``, ``late`` and ``restarts``.

    Lost are the numbers missing between two samples of one run of the microcontroller, modulo 65536: 22 minutes of
    silence at 50 Hz go uncounted. Late is a sample whose delay exceeds that of the fastest one by ``late_after``, the
    clocks' drift forgiven. It is kept as a queue's waiting time is (Lindley 1952): it grows by what passed here,
    shrinks by what passed there, and is never negative.

    Args:
        counters: where it counts.
        late_after: seconds.
    """

    def __init__(self, counters: Counter[str], *, late_after: float) -> None:
        self._counters = counters
        self._late_after = late_after
        self._last: Sample | None = None
        self._heard_at = 0.0
        self._delay = 0.0

    def hear(self, sample: Sample, now: float) -> bool:
        """Count what this sample tells; whether it tells that the microcontroller restarted since the last one."""
        last, elapsed = self._last, now - self._heard_at
        self._last, self._heard_at = sample, now
        if last is None:
            return False
        advance = (sample.stamp_ms - last.stamp_ms) % 2**32 / 1000
        if advance > elapsed + HASTE:
            self._delay = 0.0
            self._counters["restarts"] += 1
            return True
        self._counters["lost"] += (sample.sequence - last.sequence - 1) % 2**16
        self._delay = max(0.0, self._delay + elapsed * (1 - DRIFT) - advance)
        self._counters["late"] += self._delay > self._late_after
        return False

    def restart(self) -> None:
        """The microcontroller said that it restarted: the next sample is a first one."""
        if self._last is not None:
            self._counters["restarts"] += 1
        self._last = None
        self._delay = 0.0
