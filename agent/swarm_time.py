"""A microcontroller's stamps as swarm time: milliseconds that all robots count alike.

Laws kept here: a microcontroller that knows swarm time is believed; for one that does not, the computer's Unix clock at
its first sample gives the origin, and its own stamps the rest, so that a clock that is set on the way moves nothing;
swarm time never steps back.
"""

from __future__ import annotations

from collections.abc import Callable

_BEHIND = 1.0
"""Seconds that stamps may lag behind the computer's clock over an outage of the line. More, and the microcontroller was
off meanwhile: its stamps begin at 0 again, and may be higher than the last one all the same."""


class SwarmTime:
    """The time of the newest sample.

    Args:
        unix_ms: the computer's clock.
        monotonic: seconds, the computer's steady clock.

    Attributes:
        now_ms: swarm time at the newest sample.
    """

    def __init__(self, unix_ms: Callable[[], int], monotonic: Callable[[], float]) -> None:
        self.now_ms = 0
        self._unix_ms = unix_ms
        self._monotonic = monotonic
        self._stamp_ms: int | None = None
        self._heard_at = 0.0
        self._was_interrupted = False
        self._anew = False

    def interrupted(self) -> None:
        """The line was cut: the next sample may be that of a microcontroller that restarted."""
        self._was_interrupted = True

    def begin_anew(self) -> None:
        """The microcontroller restarted: the next sample is its first."""
        self._anew = True

    def hear(self, stamp_ms: int, clock_ms: int) -> int | None:
        """Advance to a sample.

        Args:
            stamp_ms: its stamp, uint32; wraps.
            clock_ms: swarm time at the microcontroller's stamp 0, or 0 if it does not know.

        Returns:
            Milliseconds since the last sample; None if there was none or the microcontroller restarted since.
        """
        before, self._stamp_ms = self._stamp_ms, stamp_ms
        heard_at, self._heard_at = self._heard_at, self._monotonic()
        passed_ms = 0 if before is None else (stamp_ms - before) % 2**32
        away = self._was_interrupted and self._heard_at - heard_at - passed_ms / 1000 > _BEHIND
        if before is None or self._anew or away or passed_ms >= 2**31:
            self.now_ms = max(self.now_ms, clock_ms + stamp_ms if clock_ms else self._unix_ms())
            passed = None
        else:
            self.now_ms += passed_ms
            passed = passed_ms
        self._was_interrupted = self._anew = False
        return passed
