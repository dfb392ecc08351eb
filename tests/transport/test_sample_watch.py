"""What samples tell of their line, under fake time."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from transport.mcu_frames import Sample
from transport.sample_watch import SampleWatch


def sample(number: int, stamp_ms: float) -> Sample:
    return Sample(number % 2**16, round(stamp_ms) % 2**32, 0, 0, 0, 0, ())


def watched(arrivals: list[tuple[int, float, float]]) -> Counter[str]:
    """The counters after samples of these numbers and stamps (s) came at these times (s)."""
    counters: Counter[str] = Counter()
    watch = SampleWatch(counters, late_after=0.1)
    for number, stamp, now in arrivals:
        watch.hear(sample(number, stamp * 1000), now)
    return +counters


@given(st.integers(0, 2**16), st.integers(0, 2**32), st.lists(st.booleans(), min_size=1, max_size=300))
def test_lost_is_what_is_missing_between_the_first_and_the_last(start, boot_ms, came):
    numbers = [number for number, one_came in enumerate(came) if one_came]
    counters = watched([(start + n, boot_ms / 1000 + n * 0.02, n * 0.02) for n in numbers])
    missing = numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0
    assert counters == ({"lost": missing} if missing else {})


@pytest.mark.parametrize("speed", [0.991, 1.0, 1.009])
def test_an_hour_of_a_clock_that_drifts_is_not_late(speed):
    noise = random.Random(1)
    arrivals = [(n, n * 0.02 * speed, n * 0.02 + noise.uniform(0, 0.05)) for n in range(3600 * 50)]
    assert watched(arrivals) == {}


@given(st.floats(0.0, 0.5))
def test_late_is_relative_to_the_fastest(delay):
    arrivals = [(n, n * 0.02, 7.0 + n * 0.02 + (delay if n == 5 else 0.0)) for n in range(5 + 1)]
    late = watched(arrivals)["late"]
    assert late == (delay > 0.101) or 0.1 <= delay <= 0.102  # drift forgiven: a millisecond here


def test_a_buffer_that_held_samples_back_makes_them_late_and_then_is_forgotten():
    held = [(n, n * 0.02, 1.0) for n in range(50)]  # a second's samples, all at once: the last is the fastest
    after = [(n, n * 0.02, 0.02 + n * 0.02) for n in range(50, 100)]
    assert watched([(0, 0.0, 0.0), *held[1:], *after]) == {"late": pytest.approx(45, abs=1)}


def test_stamps_that_go_back_are_a_restart_and_no_loss():
    assert watched([(500, 10.0, 0.0), (0, 0.0, 3.0), (1, 0.02, 3.02)]) == {"restarts": 1}


def test_stamps_that_wrap_are_no_restart():
    wrap = 2**32 / 1000
    assert watched([(1, wrap - 0.01, 0.0), (2, wrap + 0.01, 0.02), (4, wrap + 0.05, 0.06)]) == {"lost": 1}


def test_an_hour_without_the_cable_is_no_restart():
    assert watched([(0, 0.0, 0.0), (3600 * 10, 3600.0, 3600.0)]) == {"lost": 3600 * 10 - 1}


def test_a_restart_that_is_said_is_counted_once():
    counters: Counter[str] = Counter()
    watch = SampleWatch(counters, late_after=0.1)
    watch.restart()  # the first hello, before any sample
    watch.hear(sample(5, 1000), 1.0)
    watch.restart()
    assert not watch.hear(sample(0, 0), 2.0)
    assert +counters == {"restarts": 1}


@given(st.lists(st.tuples(st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1), st.floats(0, 100))))
def test_nonsense_never_raises_and_counts_nothing_negative(arrivals):
    counters: Counter[str] = Counter()
    watch = SampleWatch(counters, late_after=0.1)
    now = 0.0
    for number, stamp_ms, elapsed in arrivals:
        now += elapsed
        watch.hear(sample(number, stamp_ms), now)
    assert all(count >= 0 for count in counters.values())
