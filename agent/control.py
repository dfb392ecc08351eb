"""Who tells a process what to do: the terminal it runs in, or the command that started it.

A process started by ``orion demo`` or ``orion replay`` is the command that a user would type, with ``--supervised``: it
reads words from its standard input (``go``, ``kernel``, ``finish``), writes JSON lines to its standard output, and
ends when its standard input does, so that no process outlives the one that started it.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from types import FrameType
from typing import Any

from agent.kernel import Compilation


class Stopped(Exception):  # noqa: N818 - it is no error
    """Told to end before the work had begun."""


class Control:
    """The orders so far.

    Args:
        compilation: of the kernel, if this process sees to it.

    Attributes:
        go: the body may move.
        stop: end, cleanly.
    """

    def __init__(self, compilation: Compilation | None = None) -> None:
        self.go = True
        self.stop = False
        self._compilation = compilation
        self._apart: dict[str, str] = {}
        self._around = 0
        self._trouble: dict[str, str] = {}

    @property
    def kernel(self) -> bool:
        """Whether the compiled kernel lies in the cache."""
        return self._compilation is not None and self._compilation.ready

    def tell(self, event: str, **facts: Any) -> None:
        """Report: to a person, in lines on stderr, what is new and matters to one."""
        lines = []
        if event == "ready":
            lines = [f"{facts['name']} is ready; Ctrl-C ends it"]
        elif event == "page":
            lines = [f"the map as it grows: {facts['url']}"]
        elif event == "trouble":
            lines = [facts["what"]]
        elif event == "status":
            apart = facts.get("apart", self._apart)
            lines = [
                f"session {session} of {reason}"
                for session, reason in sorted(apart.items())
                if self._apart.get(session) != reason
            ]
            lines += [
                f"session {session} of {reason.partition(':')[0]}: all is well again"
                for session, reason in sorted(self._apart.items())
                if session not in apart
            ]
            self._apart = apart
            for source in ("body", "state"):
                trouble = facts.get(source, "")
                if trouble and trouble != self._trouble.get(source):
                    self._trouble[source] = trouble
                    lines.append(trouble)
            around = facts.get("around", self._around)
            if around != self._around:
                self._around = around
                lines.append(f"{around} other peer" + "s" * (around != 1))
        for line in lines:
            sys.stderr.write(f"orion: {line}\n")

    def obey_signals(self) -> None:
        """Ctrl-C and a service manager's stop end the process cleanly; a second Ctrl-C ends it at once."""

        def stop(number: int, frame: FrameType | None) -> None:
            if self.stop:
                raise KeyboardInterrupt
            self.stop = True

        signal.signal(signal.SIGINT, stop)
        signal.signal(signal.SIGTERM, stop)


class Supervised(Control):
    """Orders from the process that started this one."""

    def __init__(self) -> None:
        super().__init__()
        self.go = False
        self._kernel = False
        threading.Thread(target=self._listen, name="orion-control", daemon=True).start()

    @property
    def kernel(self) -> bool:
        """Whether we were told that the compiled kernel lies in the cache."""
        return self._kernel

    def _listen(self) -> None:
        for line in sys.stdin:
            match line.strip():
                case "go":
                    self.go = True
                case "kernel":
                    self._kernel = True
                case "finish":
                    break
        self.stop = True

    def tell(self, event: str, **facts: Any) -> None:
        """Write one JSON line; a starter that has gone away is no error."""
        try:
            sys.stdout.write(json.dumps({"event": event, **facts}) + "\n")
            sys.stdout.flush()
        except (BrokenPipeError, ValueError):
            self.stop = True
