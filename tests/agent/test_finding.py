"""The gravest of findings."""

from __future__ import annotations

from agent.finding import ok, problem, warning, worst


def test_the_worst_finding_decides() -> None:
    fine, doubtful, broken = ok("a", "b"), warning("a", "b", "c"), problem("a", "b", "c")
    assert worst([]) == worst([fine]) == "ok"
    assert worst([fine, doubtful, fine]) == "warning"
    assert worst([doubtful, broken, fine]) == "problem"
