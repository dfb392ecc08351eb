"""How simulated time follows real time: so many times as fast, or as fast as the robots' computers answer.

Laws kept here: a machine that is too slow makes time go slower, it never jumps; no robot's computer is waited for
longer than ``PATIENCE``.
"""

from __future__ import annotations

from typing import Protocol

from agent.simulator import STEP, STEP_MS

PERIOD_MS = 100
"""From one sample to the next: ten a second."""

PATIENCE = 2.0
"""Seconds that time stands still, at most, for the answers to a sample: an agent that loads its kernel needs one."""

_LATEST = 0.1
"""Seconds behind real time that are made up for; what is more is forgotten."""


class Pace(Protocol):
    """Tells when simulated time goes on. It is asked from the first sample on."""

    def steps(self, now: float, *, answered: bool) -> int:
        """How many steps of the simulator are due; none at the first call.

        Args:
            now: real time, seconds.
            answered: whether everybody who listens has answered the newest sample.
        """
        ...

    def idle(self, now: float) -> float:
        """Seconds that may pass, if nothing comes in, until steps are due."""
        ...


class RealTime:
    """Simulated time goes ``speed`` times as fast as real time."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._asked: float | None = None
        self._owed = 0.0

    def steps(self, now: float, *, answered: bool) -> int:
        """See ``Pace``."""
        passed = 0.0 if self._asked is None else now - self._asked
        self._asked = now
        self._owed = min(self._owed + passed, max(_LATEST, STEP / self._speed))
        due = int(self._owed * self._speed / STEP + 1e-6)
        self._owed -= due * STEP / self._speed
        return due

    def idle(self, now: float) -> float:
        """See ``Pace``."""
        return STEP / self._speed - self._owed


class LockStep:
    """On to the next sample once all who listen have answered the newest, or some were silent for ``PATIENCE``."""

    def __init__(self) -> None:
        self._sampled: float | None = None

    def steps(self, now: float, *, answered: bool) -> int:
        """See ``Pace``."""
        if self._sampled is None:
            self._sampled = now
        if not answered and now - self._sampled < PATIENCE:
            return 0
        self._sampled = now
        return PERIOD_MS // STEP_MS

    def idle(self, now: float) -> float:
        """See ``Pace``."""
        return PATIENCE if self._sampled is None else self._sampled + PATIENCE - now
