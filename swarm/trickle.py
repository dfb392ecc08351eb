"""When to tell the others what we hold: the Trickle timer (RFC 6206).

Quick while copies differ, ever slower while all is quiet, silent when enough others have just said the same.
"""

from __future__ import annotations

from swarm.jitter import Jitter
from swarm.timers import Timers


class Trickle:
    """One timer. It fires in the second half of each interval; quiet intervals double."""

    def __init__(self, timers: Timers, jitter: Jitter, now: float) -> None:
        self._timers = timers
        self._jitter = jitter
        self._begin(timers.digest_min, now)

    def _begin(self, interval: float, now: float) -> None:
        self._interval = interval
        self._heard = 0
        self._fire_at: float | None = now + interval * self._jitter.between(0.5, 1.0)
        self._end_at = now + interval

    def consistent(self) -> None:
        """Somebody just said what we would have said."""
        self._heard += 1

    def reset(self, now: float) -> None:
        """Copies differ, or there is news: be quick."""
        if self._interval > self._timers.digest_min:
            self._begin(self._timers.digest_min, now)

    def poll(self, now: float) -> bool:
        """Whether to speak now."""
        speak = False
        if self._fire_at is not None and now >= self._fire_at:
            self._fire_at = None
            speak = self._heard < self._timers.digest_redundancy
        if now >= self._end_at:
            self._begin(min(self._interval * 2, self._timers.digest_max), now)
        return speak

    @property
    def wake_at(self) -> float:
        """When ``poll`` wants to be called next."""
        return self._end_at if self._fire_at is None else self._fire_at
