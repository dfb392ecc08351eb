"""Can the harness fail? Each planted fault breaks a law under a schedule that is harmless without it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.scenarios.draw import KINDS
from tests.scenarios.faults import FAULTS
from tests.scenarios.laws import Broken
from tests.scenarios.schedule import run

CAUGHT: dict[str, tuple[str, int]] = {
    "apply-an-update-out-of-order": ("corruption", 4),
    "skip-the-state-check": ("corruption", 9),
    "half-apply-an-update": ("starts", 0),
    "forget-to-drain-what-came-early": ("weather", 0),
    "apply-an-update-twice": ("hostile", 3),
    "trim-the-ring-past-the-checkpoint": ("late", 0),
    "answer-a-want-from-a-newer-state": ("late", 1),
    "forget-a-version-in-a-manifest": ("late", 0),
    "serve-only-what-is-ones-own": ("late", 4),
    "never-trim-the-ring": ("late", 0),
    "accept-a-tile-unchecked": ("late", 8),
    "take-a-state-before-its-root-is-checked": ("late", 8),
    "leave-the-number-out-of-the-root": ("late", 8),
    "leave-the-number-out-of-the-check": ("whole-tiles", 11),
    "say-no-digests": ("weather", 0),
    "ignore-a-digests-session": ("late", 0),
    "count-an-update-twice": ("starts", 0),
    "keep-evicted-evidence": ("decisions", 0),
    "keep-replaced-evidence": ("starts", 0),
    "accept-an-old-decision-said-again": ("decisions", 0),
    "continue-a-session-after-a-restart": ("crashes", 0),
    "lose-the-journals-tail": ("homecoming", 0),
    "say-before-it-is-kept": ("homecoming", 0),
    "keep-decisions-only-now-and-then": ("verdicts", 0),
    "lose-a-scan": ("starts", 0),
    "forget-to-count-what-was-said": ("late", 0),
}
"""The first seed that catches each fault, found by ``python -m benchmarks.schedules --only KIND --fault NAME``."""


def test_every_fault_is_tried():
    assert CAUGHT.keys() == FAULTS.keys()


@pytest.mark.parametrize("fault", CAUGHT)
def test_a_planted_fault_is_caught(fault):
    kind, seed = CAUGHT[fault]
    schedule = replace(KINDS[kind](seed), limit=20.0)  # enough without the fault, as is seen below
    with FAULTS[fault](), pytest.raises(Broken):
        run(schedule)
    run(schedule)
