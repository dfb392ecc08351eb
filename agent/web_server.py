"""A web server in a thread beside the loop that owns the state.

Law kept here: the server's packages are imported in its own thread, so that the swarm does not wait for them.
"""

from __future__ import annotations

import secrets
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from agent.page_options import is_loopback, where_found

if TYPE_CHECKING:
    import uvicorn
    from starlette.types import ASGIApp

_ENDING = 3.0
"""Seconds that it has to end."""


class WebServer:
    """Serves an application.

    Args:
        listener: a socket that listens.
        host: on what address.
        build: makes the application, in the server's thread, for a token (``agent.page_guard``) or None.

    Attributes:
        url: its address, with the token if there is one.
    """

    def __init__(self, listener: socket.socket, host: str, build: Callable[[str | None], ASGIApp]) -> None:
        self._socket = listener
        self._token = None if is_loopback(host) else secrets.token_urlsafe(18)
        self._build = build
        self._server: uvicorn.Server | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._serve, name="orion-web", daemon=True)
        found, port = where_found(listener)
        query = "" if self._token is None else f"?token={self._token}"
        self.url = f"http://{f'[{found}]' if ':' in found else found}:{port}/{query}"

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """End; what is under way has a moment."""
        self._stopped = True
        if self._server is not None:
            self._server.should_exit = True
        self._thread.join(_ENDING)

    def _serve(self) -> None:
        import uvicorn

        self._server = uvicorn.Server(
            uvicorn.Config(
                self._build(self._token),
                ws="websockets-sansio",
                ws_per_message_deflate=False,  # it costs four to twenty times the time of a frame
                ws_max_size=1024,  # browsers have nothing to say there
                log_config=None,
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )
        with self._socket:
            if not self._stopped:  # while we imported
                self._server.run(sockets=[self._socket])
