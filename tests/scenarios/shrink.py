"""The least of a schedule that still breaks a law: delta debugging (Zeller and Hildebrandt, 2002) over its events."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from tests.scenarios.events import Event, Sense
from tests.scenarios.laws import Broken
from tests.scenarios.schedule import Outcome, Schedule, run

CALM: tuple[dict[str, Any], ...] = (
    {"loss": 0.0},
    {"duplicate": 0.0},
    {"delay": (0.0002, 0.001)},
    {"lease": 0.0},
    {"mtu": 65536},
)
"""Settings of a network in which little happens."""

Run = Callable[[Schedule], Outcome]


def broken_law(schedule: Schedule, run: Run = run) -> str | None:
    """The law that a schedule breaks, or None."""
    try:
        run(schedule)
    except Broken as broken:
        return broken.law
    return None


def shrunk(schedule: Schedule, *, run: Run = run, most: int = 400) -> Schedule:
    """A schedule that breaks the same law and of which nothing can be left out.

    Args:
        schedule: one that breaks a law.
        run: how it is run.
        most: the most runs that this is worth.
    """
    law = broken_law(schedule, run)
    assert law is not None
    left = most

    def fails(smaller: Schedule) -> bool:
        nonlocal left
        left -= 1
        return left >= 0 and broken_law(smaller, run) == law

    before = None
    while schedule != before and left > 0:
        before = schedule
        schedule = _fewer_events(schedule, fails)
        for simpler in _simpler(schedule):
            if fails(simpler(schedule)):
                schedule = simpler(schedule)
    return schedule


def _fewer_events(schedule: Schedule, fails: Callable[[Schedule], bool]) -> Schedule:
    events, parts = schedule.events, 2
    while len(events) >= 2:
        size = -(-len(events) // parts)
        for first in range(0, len(events), size):
            rest = events[:first] + events[first + size :]
            if fails(replace(schedule, events=rest)):
                events, parts = rest, max(parts - 1, 2)
                break
        else:
            if size == 1:
                break
            parts = min(2 * parts, len(events))
    return replace(schedule, events=events)


def _simpler(schedule: Schedule) -> Iterator[Callable[[Schedule], Schedule]]:
    """Ways to make a network calmer or a robot see less."""
    for setting in CALM:
        if replace(schedule, **setting) != schedule:
            yield lambda schedule, setting=setting: replace(schedule, **setting)
    for k, event in enumerate(schedule.events):
        if isinstance(event, Sense) and len(event.sightings) > 1:
            for keep in (len(event.sightings) // 2, len(event.sightings) - 1):
                yield lambda schedule, k=k, keep=keep: _seeing_less(schedule, k, keep)


def _seeing_less(schedule: Schedule, k: int, keep: int) -> Schedule:
    events: Sequence[Event] = schedule.events
    event = events[k]
    assert isinstance(event, Sense)
    return replace(schedule, events=(*events[:k], replace(event, sightings=event.sightings[:keep]), *events[k + 1 :]))
