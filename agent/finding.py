"""What ``orion doctor`` finds: one thing that is well, or is not, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

Verdict = Literal["ok", "warning", "problem"]


class Finding(NamedTuple):
    """One finding.

    Attributes:
        verdict: ``problem`` if something will not work, ``warning`` if it may, or may not as well as it could.
        subject: what was looked at.
        found: what was seen.
        remedy: what to do, in one line; empty if nothing is to be done.
    """

    verdict: Verdict
    subject: str
    found: str
    remedy: str = ""


def ok(subject: str, found: str) -> Finding:
    """All is well."""
    return Finding("ok", subject, found)


def warning(subject: str, found: str, remedy: str) -> Finding:
    """It works, perhaps not as it should."""
    return Finding("warning", subject, found, remedy)


def problem(subject: str, found: str, remedy: str) -> Finding:
    """It will not work."""
    return Finding("problem", subject, found, remedy)


def worst(findings: Iterable[Finding]) -> Verdict:
    """The gravest verdict among the findings; ``ok`` if there is none."""
    verdicts = {finding.verdict for finding in findings}
    for verdict in ("problem", "warning"):
        if verdict in verdicts:
            return verdict
    return "ok"
