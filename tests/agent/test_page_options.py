"""Where the page listens."""

from __future__ import annotations

import socket

import pytest

from agent.errors import UserError
from agent.page_options import PageOptions, can_open, is_loopback, where_found


def test_a_port_that_was_asked_for_and_is_taken_is_the_users_to_mend() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"--port: 127.0.0.1:{port}: address already in use; give another"):
            PageOptions(port=port).listen()


def test_without_a_port_any_will_do() -> None:
    with PageOptions().listen() as one, PageOptions().listen() as other:
        assert one.getsockname() != other.getsockname()


def test_an_address_of_somebody_else_is_refused() -> None:
    with pytest.raises(UserError, match=r"--port: 192\.0\.2\.1:0: .*; give another one, or another --host"):
        PageOptions(host="192.0.2.1", port=0).listen()


def test_what_listens_on_every_address_is_told_with_one_that_can_be_asked() -> None:
    with PageOptions().listen() as here, PageOptions("0.0.0.0").listen() as everywhere:
        assert where_found(here) == here.getsockname()
        host, port = where_found(everywhere)
        assert port == everywhere.getsockname()[1]
        assert host not in {"0.0.0.0", ""}


def test_a_machine_without_a_way_out_is_found_by_its_name(monkeypatch) -> None:
    def no_way(self: socket.socket, address: object) -> None:
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(socket.socket, "connect", no_way)
    with PageOptions("0.0.0.0").listen() as everywhere:
        assert where_found(everywhere)[0] == socket.gethostname()


def test_options_are_passed_on() -> None:
    assert PageOptions("::1", 9000, open=True).arguments() == ["--page", "--host", "::1", "--port", "9000", "--open"]
    assert PageOptions().arguments() == ["--page", "--host", "127.0.0.1", "--no-open"]


def test_what_is_this_machine_alone() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "127.9.9.9", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "192.168.1.5", "::", "evil.example", "localhost.evil.example", "")))


def test_a_browser_is_started_only_where_there_is_a_screen(monkeypatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not can_open()
    monkeypatch.setenv("DISPLAY", ":0")
    assert can_open()
