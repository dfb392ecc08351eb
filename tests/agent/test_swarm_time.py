"""Stamps as swarm time: known or not, wrapped, interrupted, begun anew."""

from hypothesis import given
from hypothesis import strategies as st

from agent.swarm_time import SwarmTime

UNIX = 1_790_000_000_000


class Clock:
    def __init__(self):
        self.seconds = 0.0
        self.time = SwarmTime(lambda: UNIX + round(self.seconds * 1000), lambda: self.seconds)


@given(st.integers(0, 2**32 - 1), st.integers(1, 2**62), st.lists(st.integers(0, 10**6), max_size=10))
def test_a_known_clock_is_believed_and_its_stamps_wrap(stamp, clock_ms, steps):
    it = Clock().time
    assert it.hear(stamp, clock_ms) is None
    for passed in steps:
        assert it.hear((stamp := stamp + passed) % 2**32, clock_ms) == passed
        assert it.now_ms == clock_ms + stamp


def test_an_unknown_clock_counts_from_the_computers_at_the_first_sample():
    clock = Clock()
    clock.time.hear(500, 0)
    clock.seconds = 99.0  # whatever the computer's clock does then
    assert clock.time.hear(600, 0) == 100
    assert clock.time.now_ms == UNIX + 100


def test_stamps_that_go_back_are_a_restart():
    clock = Clock()
    clock.time.hear(60_000, 0)
    clock.seconds = 2.0
    assert clock.time.hear(10, 0) is None
    assert clock.time.now_ms == UNIX + 2000


def test_swarm_time_never_steps_back():
    clock = Clock()
    clock.time.hear(60_000, 0)
    clock.time.hear(90_000, 0)  # a buffer that was held back: the computer's clock has not moved
    clock.time.hear(10, 0)
    assert clock.time.now_ms == UNIX + 30_000


def test_a_restart_during_an_outage_is_noticed_although_the_stamps_went_on():
    """Off after 3 s, on again, back on the line at 5 s of its new life, a minute later."""
    clock = Clock()
    clock.time.hear(3000, 0)
    clock.time.interrupted()
    clock.seconds = 60.0
    assert clock.time.hear(5000, 0) is None


def test_an_outage_without_a_restart_is_only_time_that_passed():
    clock = Clock()
    clock.time.hear(3000, 0)
    clock.time.interrupted()
    clock.seconds = 60.0
    assert clock.time.hear(63_000, 0) == 60_000


def test_simulated_time_that_stands_still_on_a_line_that_holds_is_no_restart():
    clock = Clock()
    clock.time.hear(3000, 0)
    clock.seconds = 60.0
    assert clock.time.hear(3100, 0) == 100


def test_what_the_microcontroller_says_of_its_restart_counts():
    clock = Clock()
    clock.time.hear(3000, 7)
    clock.time.begin_anew()
    assert clock.time.hear(4000, 9000) is None
    assert clock.time.now_ms == 13_000
