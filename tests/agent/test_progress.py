"""Progress: bars in a terminal, silence elsewhere."""

from __future__ import annotations

import subprocess
import sys
from typing import Any, cast

import pytest

from agent.member import Member
from agent.progress import Bars, Silence, progress


def member(name: str, *, alive: bool = True, **status: Any) -> Member:
    nothing = cast("subprocess.Popen[str]", None)
    return Member(name, nothing, status=status, alive=alive)


def shown(*members: Member, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The words on each bar's line, without the bar and the time."""
    with Bars() as bars:
        bars.show({})
        bars.show({each.name: each for each in members})
        bars.show({each.name: each for each in members})
    lines = [line.split() for line in capsys.readouterr().err.splitlines() if line.strip()]
    return [" ".join(word for word in line[:-1] if not word.startswith(("━", "╸", "╺"))) for line in lines]


def test_nothing_is_shown_where_nobody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    with progress() as nothing:
        assert isinstance(nothing, Silence)
        nothing.show({"r1": member("r1", progress=(3, 10))})
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert isinstance(progress(), Bars)


def test_a_robots_bar_counts_its_scans_and_the_updates_it_knows(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(
        member("r1", progress=[3, 10], positions={"aa": 4, "bb": 1}),
        member("r2", progress=[12, 12], positions={"aa": 4, "bb": 2}),
        capsys=capsys,
    )
    assert lines == ["r1 3/10 5 updates", "r2 12/12 6 updates"]


def test_the_observers_bar_counts_what_it_has_of_the_news(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(
        member("r1", progress=[3, 10], positions={"aa": 6}),
        member("observer", progress=[0, 0], positions={"aa": 4}),
        capsys=capsys,
    )
    assert lines[1] == "observer 4/6 4 updates"


def test_a_member_that_has_said_nothing_yet_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = shown(member("r1"), capsys=capsys)
    assert line.startswith("r1 0/")


def test_a_lost_member_is_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(member("r1", alive=False, progress=[3, 10]), capsys=capsys) == ["r1 3/10 LOST"]
