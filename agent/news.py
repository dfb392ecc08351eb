"""What a process tells a person, or a service's journal: a line for whatever is new and matters.

Laws kept here: nothing is told twice; a line is plain text for a terminal or one JSON object for a journal, and says
the same either way.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import datetime
from enum import StrEnum
from typing import Any, NamedTuple

from agent.errors import UserError


class Form(StrEnum):
    """How lines are written."""

    TEXT = "text"
    JSON = "json"


class Line(NamedTuple):
    """One piece of news.

    Attributes:
        level: ``info``, ``warning`` or ``error``.
        event: what kind of news, a word.
        message: for a person.
        facts: what it is about, for programs.
    """

    level: str
    event: str
    message: str
    facts: dict[str, Any]


class News:
    """Finds what is new in what a process tells (``Control.tell``)."""

    def __init__(self) -> None:
        self._apart: dict[str, str] = {}
        self._around = 0
        self._done = True
        self._trouble: dict[str, str] = {}

    def of(self, event: str, facts: dict[str, Any]) -> Iterator[Line]:
        """The lines that an event is worth."""
        match event:
            case "ready":
                yield Line("info", event, f"{facts['name']} is ready; Ctrl-C ends it", facts)
            case "page":
                yield Line("info", event, f"the map as it grows: {facts['url']}", facts)
            case "metrics":
                yield Line("info", event, f"/healthz and /metrics are at {facts['url']}", facts)
            case "trouble":
                yield Line("warning", event, facts["what"], facts)
            case "status":
                yield from self._of_sessions(facts.get("apart", self._apart))
                yield from self._of_work(facts.get("done", self._done))
                for source in ("body", "state"):
                    yield from self._of_trouble(source, facts.get(source, ""))
                yield from self._of_peers(facts.get("around", self._around))

    def _of_sessions(self, apart: dict[str, str]) -> Iterator[Line]:
        before, self._apart = self._apart, apart
        for session, reason in sorted(apart.items()):
            if before.get(session) != reason:
                facts = {"session": session, "reason": reason}
                yield Line("warning", "apart", f"session {session} of {reason}", facts)
        for session, reason in sorted(before.items()):
            if session not in apart:
                message = f"session {session} of {reason.partition(':')[0]}: all is well again"
                yield Line("info", "well", message, {"session": session})

    def _of_work(self, done: bool) -> Iterator[Line]:
        if done and not self._done:
            yield Line("info", "done", "it is done, and all of it is published; it stays in the swarm until Ctrl-C", {})
        self._done = done

    def _of_trouble(self, source: str, trouble: str) -> Iterator[Line]:
        if trouble and trouble != self._trouble.get(source):
            self._trouble[source] = trouble
            yield Line("warning", "trouble", trouble, {"source": source})

    def _of_peers(self, around: int) -> Iterator[Line]:
        if around != self._around:
            self._around = around
            yield Line("info", "peers", f"{around} other peer" + "s" * (around != 1), {"around": around})


def of_error(error: UserError) -> Line:
    """What a user can mend."""
    facts = {"where": error.where, "what": error.what, "remedy": error.remedy}
    return Line("error", "error", str(error), facts)


Writer = Callable[[Line], str]
"""Makes a line of text, without its end."""


def as_text(line: Line) -> str:
    """For a terminal."""
    return f"orion: {line.message}"


def as_json(line: Line, now: Callable[[], datetime] = lambda: datetime.now().astimezone()) -> str:
    """For a journal: the time, the level, the event, the message, and the facts."""
    time = now().isoformat(timespec="milliseconds")
    return json.dumps({"time": time, "level": line.level, "event": line.event, "message": line.message, **line.facts})


WRITERS: dict[Form, Writer] = {Form.TEXT: as_text, Form.JSON: as_json}
