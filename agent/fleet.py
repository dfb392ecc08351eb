"""A swarm on one machine: every robot and the observer a process of its own, started, watched and ended together.

Laws kept here: each process is the command that a user would type, with the resolved configuration as its file; the
bodies move when all peers see each other; a run has converged only if every process has applied all that every robot
published and reports the same digest; no process outlives this one.
"""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from agent.config import Config
from agent.errors import UserError
from agent.kernel import Compilation
from agent.member import Member
from agent.outputs import Outputs
from agent.progress import Progress

OBSERVER = "observer"
_MEETING = 10.0
"""Seconds within which all peers should see each other; then the bodies move all the same."""

_STALLED = 60.0
"""Seconds without any news, all bodies done, after which a run counts as not converging."""

_LEAVING = 20.0
"""Seconds in which a process must end that was told to."""


class Fleet:
    """The processes of one run. Use it in a ``with`` statement: leaving ends whatever still runs.

    Args:
        config: the swarm.
        out: a prepared folder for what they write.
        outputs: what else the observer makes of it; where it keeps a state, the robots do too.
    """

    def __init__(self, config: Config, out: Path, outputs: Outputs) -> None:
        self._config = config
        self._out = out
        self._outputs = outputs
        self._news: queue.SimpleQueue[tuple[Member, dict[str, Any] | None]] = queue.SimpleQueue()
        self.members: dict[str, Member] = {}
        self._world: Member | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, UserError):  # nothing came of it: nobody shall write a map
            patience = 0.0
        else:
            self._order("finish")
            patience = _LEAVING if error is None else 2.0
        deadline = time.monotonic() + patience
        for member in self._processes():
            member.end(deadline)

    def start(self, *, simulated: bool) -> None:
        """Start every process.

        Args:
            simulated: the world too, as the robots are not there without it.
        """
        with _held_signals():  # or one that comes now would leave a process of which nobody knows
            file = str(self._out / "orion.toml")
            if simulated:
                self._world = self._start("world", ["simulate", "-c", file, "--truth", str(self._out / "truth.npz")])
            state = [] if self._outputs.state is None else ["--state", str(self._outputs.state.absolute())]
            for robot in self._config.roster:
                self.members[robot] = self._start(robot, ["agent", "-c", file, "--robot", robot, *state])
            observe = ["observe", "-c", file, "--out", str(self._out), *self._outputs.arguments()]
            self.members[OBSERVER] = self._start(OBSERVER, observe)

    def _start(self, name: str, arguments: list[str]) -> Member:
        process = subprocess.Popen(  # noqa: S603 - our own command
            [sys.executable, "-P", "-m", "agent", *arguments, "--supervised"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is ours to pass on, as "finish"
        )
        member = Member(name, process)
        threading.Thread(target=self._listen, args=(member,), name=f"orion-{name}", daemon=True).start()
        return member

    def _processes(self) -> list[Member]:
        """The members, and last the world that their bodies are in."""
        return [*self.members.values(), *([] if self._world is None else [self._world])]

    def _listen(self, member: Member) -> None:
        assert member.process.stdout is not None
        with member.process.stdout as lines:
            for line in lines:
                with contextlib.suppress(ValueError):  # a killed process stops in the middle of a line
                    self._news.put((member, json.loads(line)))
        self._news.put((member, None))

    # --- the run

    def run(self, progress: Progress) -> bool:
        """Let the swarm map until all is done and known to all; gives whether that was reached.

        Raises:
            UserError: a process could not start, in its own words.
        """
        began = news_at = time.monotonic()
        gone = kernel = False
        with Compilation() as compilation:
            while True:
                if self._take_news(0.1):
                    news_at = time.monotonic()
                    progress.show(self.members)
                self._check_failures()
                if not kernel and compilation.ready:
                    kernel = True
                    self._order("kernel")
                if not gone and (self._met() or time.monotonic() - began > _MEETING):
                    gone = True
                    self._order("go")
                if self._settled():
                    return True
                if not any(member.alive for member in self._robots()) or not self.members[OBSERVER].alive:
                    return False
                if self._world is not None and not self._world.alive:
                    return False
                if time.monotonic() - news_at > _STALLED and self._all_done():
                    return False

    def finish(self) -> None:
        """Tell everybody to end and collect what they report.

        Raises:
            UserError: a process could not do its last work, such as write the map, in its own words.
        """
        self._order("finish")
        deadline = time.monotonic() + _LEAVING
        while time.monotonic() < deadline and any(member.alive for member in self._processes()):
            self._take_news(0.1)
        self._check_failures()

    def _order(self, word: str) -> None:
        for member in self._processes():
            member.order(word)

    def _take_news(self, timeout: float) -> bool:
        """Take in one line that a process wrote, if there is one in time."""
        try:
            member, line = self._news.get(timeout=timeout)
        except queue.Empty:
            return False
        if line is None:
            member.alive = False
            return True
        match line.pop("event"):
            case "ready":
                member.ready = True
            case "page":
                sys.stderr.write(f"orion: the map as it grows: {line['url']}\n")
            case "status":
                member.status = line
            case "report":
                member.report = line
            case "error":
                member.error = (line["where"], line["what"], line["remedy"])
        return True

    def _check_failures(self) -> None:
        for member in self._processes():
            if member.error is not None:
                raise UserError(*member.error)

    # --- what is known of it

    def _robots(self) -> list[Member]:
        return [member for name, member in self.members.items() if name != OBSERVER]

    def _living(self) -> list[Member]:
        return [member for member in self.members.values() if member.alive]

    def _met(self) -> bool:
        """Whether every process sees every other."""
        return all(member.status.get("around", 0) >= len(self.members) - 1 for member in self.members.values())

    def _all_done(self) -> bool:
        return all(member.status.get("done", False) for member in self._living())

    def _settled(self) -> bool:
        """Whether all living processes have everything that anybody is known to hold."""
        living = self._living()
        positions = [member.status.get("positions") for member in living]
        return bool(living) and self._all_done() and all(each == positions[0] for each in positions)

    def summary(self, *, settled: bool, seconds: float) -> dict[str, Any]:
        """The run's result as ``--json`` prints it; a process that died is listed with what is known of it."""
        last = self.members.get(OBSERVER)  # not even started, in a run that was interrupted at once
        observer = (last and last.report) or {}
        files = observer.pop("files", {})
        robots = []
        for member in self._robots():
            lost = {"id": member.name, "session": None, "map_digest": None, "lost": True}
            robots.append(member.report or lost)
        digests = {each.get("map_digest") for each in [*robots, observer]}
        world = {} if self._world is None else {"simulation": self._world.report or {"lost": True}}
        return {
            "converged": settled and len(digests) == 1 and None not in digests,
            "seconds": round(seconds, 3),
            "robots": robots,
            "observer": observer,
            "files": files,
            **world,
        }


@contextlib.contextmanager
def _held_signals() -> Iterator[None]:
    """Ctrl-C and a service manager's stop wait until this is over."""
    came: list[int] = []
    endings = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda number, frame: came.append(number)) for number in endings}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
