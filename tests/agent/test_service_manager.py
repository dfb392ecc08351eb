"""What systemd is told, over a socket of ours."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.control import Control
from agent.service_manager import ServiceManager


class Systemd:
    """Listens as systemd does."""

    def __init__(self, address: str) -> None:
        self.line = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.line.bind(address)
        self.line.setblocking(False)

    def heard(self) -> list[str]:
        words = []
        while True:
            try:
                words.append(self.line.recv(4096).decode())
            except BlockingIOError:
                return words


@pytest.fixture(params=["a file", "abstract"])
def systemd(request, tmp_path: Path) -> Iterator[tuple[Systemd, str]]:
    """The listener, and what it puts into ``NOTIFY_SOCKET``."""
    name = str(tmp_path / "notify") if request.param == "a file" else f"@orion-test-{os.getpid()}"
    listener = Systemd(name.replace("@", "\0"))
    yield listener, name
    listener.line.close()


def test_it_hears_that_we_are_ready(systemd) -> None:
    listener, name = systemd
    control = Control(manager=ServiceManager({"NOTIFY_SOCKET": name}))
    control.tell("page", url="http://127.0.0.1:8750/")
    assert listener.heard() == []
    control.tell("ready", name="r1")
    assert listener.heard() == ["READY=1"]


def test_it_hears_that_we_live_three_times_in_its_patience(systemd) -> None:
    listener, name = systemd
    environment = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}
    manager = ServiceManager(environment)
    for tenth in range(301):
        manager.beat(1000 + tenth / 10)
    assert listener.heard() == ["WATCHDOG=1"] * 4  # the first at once


@pytest.mark.parametrize("watchdog", [{}, {"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "x"}])
def test_where_no_watchdog_waits_for_us_it_is_not_fed(systemd, watchdog: dict[str, str]) -> None:
    listener, name = systemd
    manager = ServiceManager({"NOTIFY_SOCKET": name} | watchdog)
    manager.beat(1000.0)
    manager.beat(2000.0)
    assert listener.heard() == []


def test_without_a_service_manager_nothing_happens() -> None:
    manager = ServiceManager({"WATCHDOG_USEC": "1"})
    manager.say("READY=1")
    manager.beat(1.0)


def test_one_that_is_gone_or_does_not_listen_does_not_hold_us_up(systemd) -> None:
    listener, name = systemd
    manager = ServiceManager({"NOTIFY_SOCKET": name})
    for _ in range(10_000):  # more than its queue holds
        manager.say("WATCHDOG=1")
    assert len(listener.heard()) < 10_000
    listener.line.close()
    manager.say("STOPPING=1")
