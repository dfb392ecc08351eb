"""How long peers wait: one table of durations for each kind of network."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Timers:
    """Durations in seconds.

    Attributes:
        update_period: a writer collects scans for this long, so that one update carries several.
        digest_min: the shortest interval between digests, while copies differ (Trickle's Imin).
        digest_max: the longest, while all is quiet (Imax).
        digest_redundancy: digests of others in an interval that make the own one needless (Trickle's k).
        settle: news younger than this explains a peer that lags: it is still in flight.
        jitter: shortest and longest wait before a gap is asked about; it usually closes by itself.
        retry: wait for an answer before somebody else is asked; grows by ``backoff`` up to ``retry_max``.
        give_up: unanswered requests after which a peer is not asked again until it speaks.
        window: the most updates that are asked for at once; no more than ``swarm.replica.WINDOW`` are given.
        fetches: the most sessions about which a peer waits for answers at once.
    """

    update_period: float = 0.05
    digest_min: float = 0.05
    digest_max: float = 4.0
    digest_redundancy: int = 2
    settle: float = 0.2
    jitter: tuple[float, float] = (0.005, 0.020)
    retry: float = 0.25
    retry_max: float = 1.0
    backoff: float = 1.2
    give_up: int = 8
    window: int = 32
    fetches: int = 16


LAN = Timers()
"""For Ethernet and Wi-Fi."""

RADIO = Timers(
    update_period=2.0,
    digest_min=2.0,
    digest_max=16.0,
    settle=4.0,
    jitter=(0.1, 0.3),
    retry=3.0,
    retry_max=20.0,
    backoff=1.3,
    window=8,
    fetches=4,
)
"""For a few kbit/s that all share: one packet takes a tenth of a second, and an answer waits its turn for seconds."""
