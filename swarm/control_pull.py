"""Getting control records that others have: whom to ask for theirs, and when.

Pull only. A digest with another check than ours tells of a difference, not of who is ahead; so whoever hears one waits
a little (a record that has just been published closes it), asks one peer for its records, and merges them. Each digest
is worth one request; while copies differ digests are quick, so what is lost is asked for again.
"""

from __future__ import annotations

from swarm.jitter import Jitter
from swarm.limits import MAX_SESSIONS
from swarm.timers import Timers

_NEVER = float("inf")


class ControlPull:
    """The pursuit of other peers' control records.

    Attributes:
        wake_at: when ``poll`` wants to be called next.
    """

    def __init__(self, timers: Timers, jitter: Jitter) -> None:
        self._timers = timers
        self._jitter = jitter
        self._told: dict[str, int] = {}  # peer -> the check it said it has, if it was not asked since
        self._tries = 0
        self.wake_at = _NEVER

    def heard(self, peer: str, check: int, now: float) -> None:
        """A peer's records have this check, which is not that of ours."""
        if len(self._told) < MAX_SESSIONS or peer in self._told:
            self._told[peer] = check
        if self.wake_at == _NEVER:
            self.wake_at = now + self._jitter.between(*self._timers.jitter)

    def gone(self, peer: str) -> None:
        """A peer has left: do not ask it."""
        self._told.pop(peer, None)

    def poll(self, mine: int, now: float) -> str | None:
        """Whom to ask, if it is time to; ``mine`` is our check."""
        if now < self.wake_at:
            return None
        self._told = {peer: check for peer, check in self._told.items() if check != mine}
        if not self._told:
            self._tries = 0
            self.wake_at = _NEVER
            return None
        peer = sorted(self._told)[int(self._jitter.fraction() * len(self._told))]
        del self._told[peer]
        self.wake_at = now + min(self._timers.retry * self._timers.backoff**self._tries, self._timers.retry_max)
        self._tries += 1
        return peer
