"""A web server beside a loop: it ends when it is told to, however early that is."""

from __future__ import annotations

import socket
import threading

import pytest
from starlette.applications import Starlette
from starlette.types import ASGIApp

from agent import web_server
from agent.web_server import WebServer


def test_one_that_is_stopped_while_it_starts_does_not_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_server, "_ENDING", 0.0)
    listener = socket.create_server(("127.0.0.1", 0))
    address = listener.getsockname()
    starting, go_on = threading.Event(), threading.Event()

    def build(token: str | None) -> ASGIApp:
        starting.set()
        go_on.wait()
        return Starlette()

    server = WebServer(listener, "127.0.0.1", build)
    server.start()
    assert starting.wait(20)
    server.stop()
    go_on.set()
    server._thread.join(5)
    assert not server._thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(address)
