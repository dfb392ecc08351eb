"""One process of a fleet, and what it last said."""

from __future__ import annotations

import contextlib
import subprocess
import time
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Member:
    """One process of the fleet, and what it last said.

    Attributes:
        name: the robot's id, or ``observer``.
        process: the running command.
        status: its last status, see ``Node``.
        report: its summary, once it has ended.
        error: what it could not do, in its own words.
        alive: whether more may come from it: False once its output has ended and all of it was taken in.
    """

    name: str
    process: subprocess.Popen[str]
    ready: bool = False
    status: dict[str, Any] = field(default_factory=dict)
    report: dict[str, Any] | None = None
    error: tuple[str, str, str] | None = None
    alive: bool = True

    def order(self, word: str) -> None:
        """Tell the process something; one that is gone does not hear it."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(word + "\n")
            self.process.stdin.flush()
        except (BrokenPipeError, ValueError):
            pass

    def end(self, deadline: float) -> None:
        """See the process out; one that still runs at the deadline (``time.monotonic``) is killed."""
        try:
            self.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
