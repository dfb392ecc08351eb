"""When simulated time goes on."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.pace import PATIENCE, LockStep, RealTime


@pytest.mark.parametrize("speed", [0.3, 1.0, 12.5])
def test_real_time_passes_so_many_times_as_fast(speed: float) -> None:
    pace = RealTime(speed)
    steps = sum(pace.steps(k * 0.013, answered=False) for k in range(1001))
    assert steps == pytest.approx(13.0 * speed / 0.01, abs=1)


@given(pauses=st.lists(st.floats(0, 0.09), min_size=1, max_size=50))
def test_no_time_is_lost_by_asking_at_odd_moments(pauses: list[float]) -> None:
    pace, now = RealTime(1.0), 100.0
    steps = pace.steps(now, answered=True)
    for pause in pauses:
        now += pause
        steps += pace.steps(now, answered=True)
    assert steps * 0.01 == pytest.approx(now - 100.0, abs=0.0101)


def test_a_process_that_slept_does_not_make_time_jump() -> None:
    pace = RealTime(2.0)
    pace.steps(0.0, answered=True)
    assert pace.steps(60.0, answered=True) == 20


def test_real_time_can_wait_until_a_step_is_due() -> None:
    pace = RealTime(1.0)
    pace.steps(0.0, answered=True)
    pace.steps(0.004, answered=True)
    assert pace.idle(0.004) == pytest.approx(0.006)


def test_lock_step_goes_on_with_the_last_answer() -> None:
    pace = LockStep()
    assert pace.steps(0.0, answered=False) == 0  # the first sample is said now
    assert pace.steps(0.05, answered=False) == 0
    assert pace.steps(0.06, answered=True) == 10
    assert pace.steps(0.06, answered=False) == 0


def test_lock_step_has_some_patience() -> None:
    pace = LockStep()
    pace.steps(0.0, answered=False)
    assert pace.idle(0.05) == pytest.approx(PATIENCE - 0.05)
    assert pace.steps(PATIENCE - 0.001, answered=False) == 0
    assert pace.steps(PATIENCE, answered=False) == 10
    assert pace.steps(PATIENCE + 0.001, answered=False) == 0
