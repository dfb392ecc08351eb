"""What is asked of the page on the command line, and the socket that comes of it."""

from __future__ import annotations

import ipaddress
import os
import socket
import sys
from dataclasses import dataclass

from agent.errors import UserError

PORT = 8750
"""Where the page is if that is free."""


@dataclass(frozen=True, slots=True)
class PageOptions:
    """What was asked for.

    Attributes:
        host: where to listen; an address that is not this machine's alone wants a token, which is made and told.
        port: None for ``PORT``, or any other if that is taken.
        open: whether to start a browser.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    open: bool = False

    def arguments(self) -> list[str]:
        """The options of ``orion observe`` that say the same."""
        port = [] if self.port is None else ["--port", str(self.port)]
        return ["--page", "--host", self.host, *port, "--open" if self.open else "--no-open"]

    def listen(self) -> socket.socket:
        """A socket that listens there.

        Raises:
            UserError: it cannot.
        """
        ports = [PORT, 0] if self.port is None else [self.port]
        for port in ports:
            try:
                family, kind, protocol, _, address = socket.getaddrinfo(self.host, port, type=socket.SOCK_STREAM)[0]
                listener = socket.socket(family, kind, protocol)
                try:
                    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    listener.bind(address)
                    listener.listen()
                except OSError:
                    listener.close()
                    raise
            except (OSError, UnicodeError) as error:  # UnicodeError: no name that a resolver is asked for
                if port == ports[-1]:
                    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
                    where = f"--port: {self.host}:{port}"
                    raise UserError(where, reason[:1].lower() + reason[1:], "give another one, or --no-page") from None
            else:
                return listener
        raise AssertionError


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's own, for itself alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def can_open() -> bool:
    """Whether there is a screen; without one a browser for terminals might come up and take ours."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
