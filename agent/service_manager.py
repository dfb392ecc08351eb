"""What systemd is told of a process that it has started (sd_notify(3)): that it is ready, that it lives, that it ends.

Laws kept here: it is told without ever waiting for it; where there is no systemd, nothing happens.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
from collections.abc import Mapping


class ServiceManager:
    """Whoever started us, if that wants to be told.

    Args:
        environment: what it told us: ``NOTIFY_SOCKET``, ``WATCHDOG_USEC``, ``WATCHDOG_PID``.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address  # @ is an abstract one
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        patience = environment.get("WATCHDOG_USEC", "")
        self._period = int(patience) / 1e6 / 3 if ours and patience.isdecimal() else math.inf
        self._due = 0.0 if math.isfinite(self._period) else math.inf

    def say(self, word: str) -> None:
        """Tell it, such as ``READY=1`` or ``STOPPING=1``."""
        if not self._address:
            return
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
            line.setblocking(False)
            line.sendto(word.encode(), self._address)

    def beat(self, now: float) -> None:
        """We live; to be called often.

        It is told three times in the time after which we would be taken for dead.

        Args:
            now: seconds, not negative.
        """
        if now >= self._due:
            self._due = now + self._period
            self.say("WATCHDOG=1")


NO_SERVICE_MANAGER = ServiceManager({})
