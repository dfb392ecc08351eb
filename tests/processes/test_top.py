"""``orion top`` beside real processes: once for a pipe, and live in a terminal."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator

import pytest

pytestmark = pytest.mark.processes


@pytest.fixture
def lab(orion, swarm):
    """The TOML of two robots that have sensed all there is for them, and still are there."""
    robots = {
        name: {
            "start": {},
            "body": {"kind": "recording", "path": str(swarm.log(f"{name}.log", scans=20)), "speed": "max"},
        }
        for name in ("r1", "r2")
    }
    toml = swarm.toml(robots, cell=0.05, swarm="lab")
    agents = [orion("agent", "-c", toml, "--robot", name, "--supervised") for name in robots]
    for agent in agents:
        agent.is_ready()
        agent.order("go")
    for agent in agents:
        agent.knows(lambda positions: len(positions) == 2)
        agent.shows("done", True)
    assert agents[0].hears_no_more() == agents[1].hears_no_more()
    return toml


def test_once_it_tells_what_the_robots_have(orion, lab) -> None:
    told = orion("top", "-c", lab, "--json").report()
    assert (told["swarm"], told["caught_up"]) == ("lab", True)
    assert sorted(peer["name"] for peer in told["peers"]) == ["r1", "r2"]
    assert [(it["robot"], it["summed"], it["reason"], it["n"] == it["known_n"]) for it in told["sessions"]] == [
        ("r1", True, "", True),
        ("r2", True, "", True),
    ]
    observer = orion("observe", "-c", lab, "--no-page", "--supervised")
    observer.knows(lambda positions: len(positions) == 2)
    assert told["digest"] == observer.finish()["map_digest"]
    piped = orion("top", "-c", lab)  # no terminal: once
    assert piped.ends() == 0
    text = "".join(piped.lines)
    assert told["digest"][:16] in text
    assert text.count("in the map") == 2
    assert "\x1b" not in text


def test_where_nobody_is_it_says_so(orion, swarm) -> None:
    command = orion("top", "-c", swarm.toml({"r1": {}}), "--json")
    assert command.ends() == 1
    assert command.lines == []
    assert command.errors.startswith("orion: nobody of swarm orion is there")


class Terminal:
    """What a process draws on a terminal of 100 x 30 characters."""

    def __init__(self, words: list[str]) -> None:
        self._master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (30, 100))
        environment = {**os.environ, "TERM": "xterm-256color"}
        self.process = subprocess.Popen(words, stdin=slave, stdout=slave, stderr=slave, env=environment)
        os.close(slave)
        self.drawn = ""
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # the other end has gone
            while data := os.read(self._master, 65536):
                self.drawn += data.decode(errors="replace")

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()
        os.close(self._master)


@pytest.fixture
def terminal(lab) -> Iterator[Terminal]:
    """``orion top`` on a terminal."""
    terminal = Terminal([sys.executable, "-P", "-m", "agent", "top", "-c", str(lab)])
    yield terminal
    terminal.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_on_a_terminal_it_draws_until_it_is_told_to_end(processes, terminal: Terminal, number: int) -> None:
    processes.until(lambda: "all agree" in terminal.drawn and terminal.drawn.count("in the map") >= 2)
    assert any(half in terminal.drawn for half in "▀▄█")
    assert "\x1b[?1049h" in terminal.drawn  # a screen of its own,
    terminal.process.send_signal(number)
    assert terminal.process.wait(30) == 0
    processes.until(lambda: "\x1b[?1049l" in terminal.drawn)  # which it leaves
    assert "Traceback" not in terminal.drawn
