"""A robot and an observer as services: what systemd hears, what is in the journal, and what can be asked of them."""

from __future__ import annotations

import http.client
import json
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.processes


class Systemd:
    """Listens as systemd does, with a watchdog of half a second."""

    def __init__(self, path: Path) -> None:
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._line.bind(str(path))
        self._line.settimeout(30)
        self.starts = ["env", f"NOTIFY_SOCKET={path}", "WATCHDOG_USEC=500000"]

    def hears(self, word: str) -> list[str]:
        """Wait for a word; gives what was said before it."""
        before = []
        while (said := self._line.recv(4096).decode()) != word:
            before.append(said)
        return before

    def close(self) -> None:
        self._line.close()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    listener = Systemd(tmp_path / "notify")
    yield listener
    listener.close()


@pytest.fixture
def lab(swarm):
    """The TOML of a robot whose log takes a minute."""
    body = {"kind": "recording", "path": str(swarm.log(scans=600, seconds=60.0)), "speed": 1.0}
    return swarm.toml({"r1": {"start": {}, "body": body}}, cell=0.05)


def journal(command) -> list[dict]:
    """What it wrote, every line of it."""
    return [json.loads(line) for line in [*command._errors.read_text().splitlines(), *command.lines]]


def answers(url: str, path: str) -> Callable[[], str]:
    """What is answered there with 200, else nothing."""

    def ask() -> str:
        connection = http.client.HTTPConnection(url.split("/")[2], timeout=20)
        connection.request("GET", path)
        answer = connection.getresponse()
        text = answer.read().decode()
        connection.close()
        return text if answer.status == 200 else ""

    return ask


def test_a_robot_tells_systemd_that_it_is_ready_lives_and_ends(orion, lab, systemd, processes) -> None:
    words = ("agent", "-c", lab, "--robot", "r1", "--metrics-port", 0)
    robot = orion(*words, inside=systemd.starts)
    assert systemd.hears("READY=1") == []
    for _ in range(3):
        assert systemd.hears("WATCHDOG=1") == []
    url = next(line["url"] for line in journal(robot) if line["event"] == "metrics")
    assert json.loads(processes.until(answers(url, "/healthz")))["alive"]
    assert "orion_live_sessions 1.0" in processes.until(answers(url, "/metrics")).splitlines()
    robot.signal(signal.SIGTERM)
    assert set(systemd.hears("STOPPING=1")) <= {"WATCHDOG=1"}
    assert robot.ends() == 0
    lines = journal(robot)
    assert [line.get("event") for line in lines] == ["metrics", "ready", None]
    assert all({"time", "level", "message"} <= line.keys() for line in lines[:-1])
    assert lines[-1]["id"] == "r1"


def test_a_robot_that_hangs_says_no_more_that_it_lives(orion, lab, systemd, processes) -> None:
    robot = orion("agent", "-c", lab, "--robot", "r1", inside=systemd.starts)
    systemd.hears("READY=1")
    systemd.hears("WATCHDOG=1")
    robot.signal(signal.SIGSTOP)
    systemd._line.settimeout(1.5)  # three times the watchdog's patience
    with pytest.raises(TimeoutError):
        systemd.hears("STOPPING=1")
    robot.signal(signal.SIGCONT)
    systemd._line.settimeout(30)
    assert systemd.hears("WATCHDOG=1") == []


def test_an_observer_does_the_same(orion, lab, systemd) -> None:
    observer = orion("observe", "-c", lab, "--port", 0, inside=systemd.starts)
    assert systemd.hears("READY=1") == []
    systemd.hears("WATCHDOG=1")
    observer.signal(signal.SIGTERM)
    systemd.hears("STOPPING=1")
    assert observer.ends() == 0
    assert [line.get("event") for line in journal(observer)] == ["ready", "page", None]


def test_what_a_user_can_mend_is_in_the_journal_too(orion, lab) -> None:
    robot = orion("agent", "-c", lab, "--robot", "r9")
    assert robot.ends() == 2
    (line,) = journal(robot)
    assert (line["level"], line["where"]) == ("error", "--robot")


@pytest.mark.parametrize("form", ["text", "json"])
def test_the_form_may_be_asked_for(orion, lab, form: str) -> None:
    robot = orion("agent", "-c", lab, "--robot", "r9", "--log", form)
    assert robot.ends() == 2
    text = robot._errors.read_text()
    assert text.startswith("{") == (form == "json")
    assert robot.errors.startswith("orion: --robot: 'r9' is not in the roster")
