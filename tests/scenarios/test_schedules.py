"""Swarms under schedules of faults: whatever happens, all agree in the end, and no law is ever broken.

More of them: ``python -m benchmarks.schedules --seeds 10000``.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pytest

from tests.scenarios.draw import KINDS
from tests.scenarios.events import (
    Corrupt,
    Crash,
    Event,
    Evict,
    Hostile,
    Join,
    Partition,
    Readmit,
    Return,
    Sense,
    SetStart,
    Silence,
    Withdraw,
)
from tests.scenarios.laws import Broken
from tests.scenarios.oracle import SIGHTINGS
from tests.scenarios.schedule import Schedule, run
from tests.scenarios.shrink import shrunk

ALL = tuple(range(len(SIGHTINGS)))


@pytest.mark.parametrize("seed", [*range(12), *(pytest.param(seed, marks=pytest.mark.more) for seed in range(12, 120))])
def test_whatever_happens_all_agree_in_the_end(seed):
    run(KINDS["everything"](seed))


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(120, 1000))
def test_whatever_happens_all_agree_in_the_end_many_times(seed):
    run(KINDS["everything"](seed))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "everything"])
def test_whatever_one_kind_of_thing_happens_all_agree_in_the_end(kind, seed):
    run(KINDS[kind](seed))


# --- by name


def two_robots(**options):
    return Join(0.0, "r1", "r1", start=1, **options), Join(0.0, "r2", "r2", start=2, **options), Join(0.0, "o")


SCENARIOS: dict[str, tuple[Event, ...]] = {
    "a late joiner is served though the writers are dead": (
        *two_robots(),
        Sense(0.0, "r1", ALL[:50]),
        Sense(0.0, "r2", ALL[50:], every=0.0),
        Crash(4.0, "r1"),
        Crash(4.5, "r2"),
        Join(5.0, "late"),
    ),
    "robots that never meet agree through one between them": (
        *two_robots(),
        Silence(0.0, "r1", "r2"),
        Sense(0.0, "r1", ALL[:30]),
        Sense(0.0, "r2", ALL[:30]),
    ),
    "a robot without memory comes back with a new session and keeps what others hold of the old one": (
        *two_robots(),
        Sense(0.0, "r1", ALL[:25]),
        Crash(1.0, "r1"),
        Return(1.5, "r1"),
        Sense(1.6, "r1", ALL[:25]),
    ),
    "a robot with memory comes back alone and brings all that it ever said": (
        Join(0.0, "r1", "r1", remembers=True),
        Sense(0.0, "r1", ALL[:45]),
        Crash(3.0, "r1"),
        Join(3.1, "late"),
        Return(3.5, "r1"),
    ),
    "a start pose is put right while the robot is away": (
        *two_robots(remembers=True),
        Sense(0.0, "r1", ALL[:30]),
        Crash(2.5, "r1"),
        SetStart(3.0, "o", "r1", 3),
        Return(4.0, "r1"),
        Sense(4.1, "r1", ALL[:5]),
    ),
    "a start pose is put right on the way, and a scan taken back": (
        *two_robots(),
        Sense(0.0, "r1", ALL[:40]),
        SetStart(1.0, "o", "r1", 3),
        Withdraw(1.5, "r1", 3),
        SetStart(2.0, "r2", "r1", 0),
    ),
    "a robot that nobody placed is not summed until somebody does": (
        Join(0.0, "r1", "r1", start=None),
        Join(0.0, "o"),
        Sense(0.0, "r1", ALL[:10]),
        SetStart(2.0, "o", "r1", 2),
    ),
    "two robots go by one id": (
        Join(0.0, "r1", "r", start=1),
        Join(0.0, "r2", "r", start=2),
        Sense(0.0, "r1", ALL[:10]),
        Sense(0.0, "r2", ALL[:10]),
        SetStart(1.0, "r2", "r", 3),
    ),
    "a session is evicted on one side of a partition and readmitted on the other": (
        *two_robots(),
        Sense(0.0, "r1", ALL[:20]),
        Sense(0.0, "r2", ALL[:20]),
        Partition(0.8, (("r1",),)),
        Evict(1.0, "r1", 0),
        Evict(1.1, "r1", 1),
        Readmit(1.2, "o", 0),
    ),
    "two operators decide at once": (*two_robots(), Evict(1.0, "r1", 0), Readmit(1.0, "r2", 0), Evict(1.0, "o", 0)),
    "every third payload is damaged on the way": (
        *two_robots(),
        Corrupt(0.0, 0.33),
        Sense(0.0, "r1", ALL[:45]),
        Sense(0.0, "r2", ALL[:45]),
    ),
    "strangers say what they like": (
        *two_robots(),
        Sense(0.0, "r1", ALL[:30]),
        *(Hostile(0.5 + k / 10, how, k, count=20) for k, how in enumerate(["noise", "replay", "mutation"] * 3)),
    ),
    **{
        f"a state file is {damage}": (
            *two_robots(remembers=True),
            Sense(0.0, "r1", ALL[:45]),
            Crash(3.0, "r1", damage, seed=5),
            Return(3.5, "r1"),
        )
        for damage in ("lost", "truncated", "flipped")
    },
}


@pytest.mark.parametrize("mtu", [84, 65536])
@pytest.mark.parametrize("name", SCENARIOS)
def test_it_holds_when(name, mtu):
    run(Schedule(1, SCENARIOS[name], mtu=mtu))


# --- schedules are values


@pytest.mark.parametrize("kind", KINDS)
def test_a_schedule_is_printed_as_what_makes_it_again(kind):
    names = {each.__name__: each for each in {type(event) for seed in range(60) for event in KINDS[kind](seed).events}}
    for seed in range(60):
        schedule = KINDS[kind](seed)
        assert eval(str(schedule), names | {"Schedule": Schedule}) == schedule


def test_a_schedule_runs_the_same_in_every_process():
    """Whatever order Python's sets have there."""
    program = "from tests.scenarios import draw, schedule; print(schedule.run(draw.KINDS['everything'](7)))"
    outcomes = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={"PYTHONPATH": ":".join(filter(None, sys.path)), "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert outcomes == {f"{run(KINDS['everything'](7))}\n"}


def test_of_a_schedule_that_breaks_a_law_the_least_is_left():
    def breaks_if_r1_sees_something_and_r2_crashes(schedule):
        sees = any(isinstance(event, Sense) and event.who == "r1" and 7 in event.sightings for event in schedule.events)
        if sees and any(isinstance(event, Crash) and event.who == "r2" for event in schedule.events):
            raise Broken("the law", "it does")
        return run(replace(schedule, events=()))

    events = (
        *SCENARIOS["a start pose is put right on the way, and a scan taken back"],
        Crash(1.0, "r1"),
        Crash(2.0, "r2"),
    )
    least = shrunk(Schedule(1, events, loss=0.3, mtu=84), run=breaks_if_r1_sees_something_and_r2_crashes)
    assert [type(event) for event in least.events] == [Sense, Crash]
    assert least.events[0].sightings == ALL[:8]
    assert (least.loss, least.mtu) == (0.0, 65536)
