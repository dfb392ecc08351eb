"""What is asked of the page on the command line, and the socket that comes of it."""

from __future__ import annotations

import ipaddress
import os
import socket
import sys
from dataclasses import dataclass
from typing import Annotated

import typer

from agent.errors import UserError

PORT = 8750
"""Where the page is if that is free."""

PagePort = Annotated[
    int | None, typer.Option("--port", metavar="P", min=0, max=65535, help="Where the page is (default 8750).")
]
PageHost = Annotated[
    str, typer.Option("--host", metavar="H", help="Where the page listens; not only here: then it wants a token.")
]
OpenOption = Annotated[
    bool | None, typer.Option("--open/--no-open", help="Start a browser; by default in a terminal on a screen.")
]


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
        return listen(self.host, ports, "--port", "give another one, or another --host")


def listen(host: str, ports: list[int], option: str, remedy: str) -> socket.socket:
    """A socket that listens on the first port of some that is free.

    Args:
        host: a name or an address.
        ports: 0 is any.
        option: what of the command line is wrong if it cannot.
        remedy: what to do then.

    Raises:
        UserError: it cannot.
    """
    for port in ports:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
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
                raise UserError(f"{option}: {host}:{port}", reason[:1].lower() + reason[1:], remedy) from None
        else:
            return listener
    raise AssertionError


def where_found(listener: socket.socket) -> tuple[str, int]:
    """The address and the port at which others find what listens.

    If that is every address of this machine: the one that it has towards everybody else, or its name if it has none.
    """
    address, port = listener.getsockname()[:2]
    if not ipaddress.ip_address(address).is_unspecified:
        return address, port
    far = "2001:db8::1" if listener.family == socket.AF_INET6 else "192.0.2.1"  # of RFC 3849 and 5737; nothing is sent
    with socket.socket(listener.family, socket.SOCK_DGRAM) as outwards:
        try:
            outwards.connect((far, 9))
        except OSError:
            return socket.gethostname(), port
        return outwards.getsockname()[0], port


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's own, for itself alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def can_open() -> bool:
    """Whether there is a screen; without one a browser for terminals might come up and take ours."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def page_options(port: int | None, host: str, open_page: bool | None) -> PageOptions:
    """What was asked for, as the command line has it."""
    return PageOptions(host, port, open=can_open() and (sys.stderr.isatty() if open_page is None else open_page))
