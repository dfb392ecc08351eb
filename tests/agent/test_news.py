"""What is new: for a person in a terminal, and for a service's journal."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from agent.control import Control
from agent.errors import UserError
from agent.news import WRITERS, Form, Line, News, as_json, as_text, of_error

NOON = datetime(2026, 3, 1, 12, 0, 0, 123456, tzinfo=UTC)


def test_a_line_says_the_same_in_both_forms() -> None:
    line = Line("warning", "apart", "session a1 of r2: no start pose", {"session": "a1", "reason": "r2: no start pose"})
    assert as_text(line) == "orion: session a1 of r2: no start pose"
    assert json.loads(as_json(line, lambda: NOON)) == {
        "time": "2026-03-01T12:00:00.123+00:00",
        "level": "warning",
        "event": "apart",
        "message": "session a1 of r2: no start pose",
        "session": "a1",
        "reason": "r2: no start pose",
    }


def test_a_journals_line_is_one_line_with_a_time_that_has_a_zone() -> None:
    text = as_json(Line("warning", "trouble", "two\nlines: räume", {"what": "two\nlines: räume"}))
    assert "\n" not in text
    told = json.loads(text)
    assert told["message"] == "two\nlines: räume"
    assert datetime.fromisoformat(told["time"]).utcoffset() is not None


@pytest.mark.parametrize(
    ("event", "facts", "told"),
    [
        ("ready", {"name": "r1"}, [("info", "ready")]),
        ("metrics", {"url": "http://127.0.0.1:8751/"}, [("info", "metrics")]),
        ("trouble", {"what": "the disk is full"}, [("warning", "trouble")]),
        ("status", {"around": 2, "apart": {"a1": "r2: no start pose"}}, [("warning", "apart"), ("info", "peers")]),
        ("status", {"body": "it is not connected", "state": "the disk is full"}, [("warning", "trouble")] * 2),
        ("status", {"around": 0, "apart": {}, "positions": {"a1": 3}}, []),
        ("report", {"map_digest": "00"}, []),
    ],
)
def test_only_what_matters_is_worth_a_line(event: str, facts: dict, told: list) -> None:
    news = News()
    assert [line[:2] for line in news.of(event, facts)] == told
    if event == "status":
        assert list(news.of(event, facts)) == []  # it is not new any more


def test_what_a_user_can_mend_is_told_with_its_parts() -> None:
    told = json.loads(as_json(of_error(UserError("lab.toml", "is no TOML", "mend it"))))
    assert (told["level"], told["where"], told["what"], told["remedy"]) == (
        "error",
        "lab.toml",
        "is no TOML",
        "mend it",
    )
    assert told["message"] == str(UserError("lab.toml", "is no TOML", "mend it"))


def test_a_process_tells_its_journal_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    control = Control(write=WRITERS[Form.JSON])
    control.tell("ready", name="r1")
    control.tell("status", around=1, apart={})
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [(line["event"], line["message"]) for line in lines] == [
        ("ready", "r1 is ready; Ctrl-C ends it"),
        ("peers", "1 other peer"),
    ]
