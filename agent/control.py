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
from agent.news import News, Writer, as_text
from agent.service_manager import NO_SERVICE_MANAGER, ServiceManager


class Stopped(Exception):  # noqa: N818 - it is no error
    """Told to end before the work had begun."""


class Control:
    """The orders so far.

    Args:
        compilation: of the kernel, if this process sees to it.
        write: how a person is told.
        manager: the service manager that started this process.

    Attributes:
        go: the body may move.
        stop: end, cleanly.
    """

    def __init__(
        self,
        compilation: Compilation | None = None,
        write: Writer = as_text,
        manager: ServiceManager = NO_SERVICE_MANAGER,
    ) -> None:
        self.go = True
        self.stop = False
        self._compilation = compilation
        self._news = News()
        self._write = write
        self._manager = manager

    @property
    def kernel(self) -> bool:
        """Whether the compiled kernel lies in the cache."""
        return self._compilation is not None and self._compilation.ready

    def tell(self, event: str, **facts: Any) -> None:
        """Report: on stderr, what is new and matters to a person."""
        for line in self._news.of(event, facts):
            sys.stderr.write(f"{self._write(line)}\n")
        if event == "ready":
            self._manager.say("READY=1")

    def beat(self, now: float) -> None:
        """The loop turns; to be called several times a second."""
        self._manager.beat(now)

    def obey_signals(self) -> None:
        """Ctrl-C and a service manager's stop end the process cleanly; a second Ctrl-C ends it at once."""

        def stop(number: int, frame: FrameType | None) -> None:
            if self.stop:
                raise KeyboardInterrupt
            self.stop = True
            self._manager.say("STOPPING=1")

        signal.signal(signal.SIGINT, stop)
        signal.signal(signal.SIGTERM, stop)


class Quiet(Control):
    """Orders from a terminal on which something else is shown."""

    def tell(self, event: str, **facts: Any) -> None:
        """Nothing."""


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
