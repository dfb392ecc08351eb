"""The tutorial, read as a person would: its commands in their order, in the terminals that it names."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.processes

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial.md"
INSTALLATION = "## 1 Install\n"
"""The one section that is not carried out: whoever runs this test has done so."""

STEP = re.compile(
    r"^```sh\n(?P<commands>.*?)^```$"
    r"|^\*\*Terminal (?P<terminal>\d)\*\*"
    r"|[Ww]ait until terminals? (?P<speakers>[\d, and]+) says? `(?P<words>.*?)`"
    r"|press Ctrl-C in\s+terminals? (?P<stopped>[\d, and]+)",
    re.DOTALL | re.MULTILINE,
)

ORION = f"""#!/bin/sh
exec {sys.executable} -P -m agent "$@"
"""


class Terminal:
    """A shell that runs one script, by itself in its session, as in a window of its own."""

    def __init__(self, script: str, folder: Path, environment: dict[str, str]) -> None:
        self._master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (40, 160))
        self.process = subprocess.Popen(
            ["bash", "-euc", script],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
        )
        os.close(slave)
        self.text = ""
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # the other end has gone
            while data := os.read(self._master, 65536):
                self.text += data.decode(errors="replace")

    def press(self, number: signal.Signals) -> None:
        """Send a key's signal to all that runs there."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, number)

    def ends(self, within: float) -> None:
        """Wait for its good end."""
        status = self.process.wait(within)
        self._reader.join(within)
        assert status == 0, self.text

    def close(self) -> None:
        """Nothing runs in it any more, and it is gone."""
        self.press(signal.SIGKILL)
        self.process.wait()
        self._reader.join()
        os.close(self._master)


class Reader:
    """Somebody who follows the tutorial in a folder of his own."""

    def __init__(self, folder: Path, base_port: int, patience: float) -> None:
        self.folder = folder / "lab"
        self._patience = patience
        for each in ("lab", "bin", "home"):
            (folder / each).mkdir()
        (folder / "bin" / "orion").write_text(ORION)
        (folder / "bin" / "orion").chmod(0o755)
        own = {key: value for key, value in os.environ.items() if not key.startswith(("ORION_", "DISPLAY"))}
        self._environment = own | {
            "PATH": f"{folder / 'bin'}:{Path(sys.executable).parent}:{own['PATH']}",
            "HOME": str(folder / "home"),
            "MPLBACKEND": "agg",
            "ORION_BASE_PORT": str(base_port),
        }
        self.terminals: dict[int, Terminal] = {}
        self.said: list[str] = []

    def run(self, script: str) -> None:
        """In the first terminal, to its end."""
        terminal = Terminal(script, self.folder, self._environment)
        try:
            terminal.ends(self._patience)
        finally:
            terminal.close()
            self.said.append(terminal.text)

    def open(self, number: int, script: str) -> None:
        """In another terminal."""
        assert number not in self.terminals
        self.terminals[number] = Terminal(script, self.folder, self._environment)

    def wait(self, number: int, words: str) -> None:
        """Look at a terminal until it says so."""
        terminal = self.terminals[number]
        deadline = time.monotonic() + self._patience
        while True:
            ended = terminal.process.poll() is not None
            if words in terminal.text:
                return
            assert not ended, terminal.text
            assert time.monotonic() < deadline, f"terminal {number} does not say {words!r}: {terminal.text}"
            time.sleep(0.05)

    def stop(self, number: int) -> None:
        """Press Ctrl-C there and wait for the good end of what runs."""
        self.terminals[number].press(signal.SIGINT)
        self.terminals[number].ends(self._patience)

    def close(self) -> None:
        """Make sure that nothing is left."""
        for terminal in self.terminals.values():
            terminal.close()


@pytest.fixture
def reader(swarm) -> Iterator[Reader]:
    reader = Reader(swarm.folder, swarm.base_port, 120.0 * float(os.environ.get("ORION_TIME_UNIT", "1")))
    yield reader
    reader.close()


def numbers(listed: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d", listed)]


def follow(reader: Reader, text: str) -> list[str]:
    """Do what the text says; gives the packages that it wants to be installed."""
    terminal, packages = 1, []
    for step in STEP.finditer(text):
        match step.lastgroup:
            case "commands" if step["commands"].startswith("pip install "):
                packages += step["commands"].split()[2:]
            case "commands" if terminal == 1:
                reader.run(step["commands"])
            case "commands":
                reader.open(terminal, step["commands"])
                terminal = 1
            case "terminal":
                terminal = int(step["terminal"])
            case "words":
                for number in numbers(step["speakers"]):
                    reader.wait(number, step["words"])
            case "stopped":
                for number in numbers(step["stopped"]):
                    reader.stop(number)
    return packages


def digest(text: str) -> str:
    (found,) = re.findall(r"map_digest  ([0-9a-f]{32})", text)
    return found


def test_the_tutorial_works_as_it_is_written(reader: Reader) -> None:
    before, installation, after = TUTORIAL.read_text().partition(INSTALLATION)
    install, heading, rest = after.partition("\n## 2 ")
    assert "```sh" not in before
    assert installation
    assert "pip install" in install
    assert heading
    (package,) = follow(reader, rest)
    assert importlib.util.find_spec(package) is not None

    assert sorted(reader.terminals) == [2, 3, 4, 5]
    (observer,) = {digest(reader.terminals[number].text) for number in (3, 4, 5)}
    demo = next(text for text in reader.said if "all agree after" in text)
    assert len(set(re.findall(r"[0-9a-f]{32}", demo))) == 1
    assert any(f"equal, digest {observer}" in text for text in reader.said)
    assert "/r1/pose" in reader.said[-1]
    assert "/r2/pose" in reader.said[-1]

    with Image.open(reader.folder / "evo_trajectories.png") as picture:
        assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 10
    with Image.open(reader.folder / "map" / "map.pgm") as picture:
        assert set(np.unique(np.asarray(picture))) == {0, 205, 254}


@pytest.mark.parametrize(
    "text",
    [
        "```sh\nfalse\n```\n",
        "**Terminal 2**: it ends.\n\n```sh\ntrue\n```\n\nWait until terminal 2 says `never`.",
    ],
)
def test_a_tutorial_that_does_not_work_is_found_out(reader: Reader, text: str) -> None:
    with pytest.raises(AssertionError):
        follow(reader, text)
