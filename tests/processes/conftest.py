"""Real processes on this machine, over 127.0.0.1: the commands that a user types, and what can be asked of them."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import queue
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from agent.map_files import load_map
from agent.page_server import BUNDLE
from agent.playback import RecordedBody
from agent.recording import Recording
from agent.world import World
from mapping.evidence import EvidenceModel
from mapping.grid import Grid
from mapping.integrate import integrated
from mapping.lattice import Cells, Lattice, TileKey
from mapping.pose import Pose, QuantisedPose
from mapping.tiles import Tiles, map_digest

PATIENCE = 30.0 * float(os.environ.get("ORION_TIME_UNIT", "1"))
"""Seconds to wait for what should take a few: machines are shared."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Whoever started the tests in the background made them ignore Ctrl-C, and with them all processes that they start.
    signal.signal(signal.SIGINT, signal.default_int_handler)


# --- commands


class Command:
    """One running ``orion ...``.

    Attributes:
        pid: its process.
        lines: what it has written to standard output, as far as it was looked at.
        status: the last status of a ``--supervised`` one.
    """

    def __init__(self, words: list[str], errors: Path, inside: Sequence[str] = ()) -> None:
        environment = {key: value for key, value in os.environ.items() if not key.startswith("ORION_")}
        with errors.open("wb") as file:
            self._process = subprocess.Popen(
                [*inside, sys.executable, "-P", "-m", "agent", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                text=True,
                env=environment,
            )
        self.pid = self._process.pid
        self.lines: list[str] = []
        self.status: dict[str, Any] = {}
        self._errors = errors
        self._news: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._news.put(line)
        self._news.put(None)

    def _take(self, timeout: float) -> dict[str, Any] | None:
        """The next thing that a ``--supervised`` command says; None if its output has ended."""
        line = self._news.get(timeout=timeout)
        if line is None:
            self._news.put(None)
            return None
        self.lines.append(line)
        event: dict[str, Any] = json.loads(line) if line.startswith("{") else {}
        if event.get("event") == "status":
            self.status = event
        return event

    def says(self, condition: Callable[[dict[str, Any]], bool], within: float = PATIENCE) -> dict[str, Any]:
        """Wait until a ``--supervised`` command says something that fulfils the condition."""
        deadline = time.monotonic() + within
        while (event := self._take(max(0.0, deadline - time.monotonic()))) is not None:
            if condition(event):
                return event
        pytest.fail(f"it ended without saying so: {self.errors}")

    def is_ready(self) -> None:
        """Wait until a ``--supervised`` command has joined its swarm."""
        self.says(lambda event: event["event"] == "ready")

    def knows(self, condition: Callable[[dict[str, int]], bool], within: float = PATIENCE) -> dict[str, int]:
        """Wait until a ``--supervised`` command's positions (update by session) fulfil the condition."""
        if not condition(self.status.get("positions", {})):
            self.says(lambda event: event["event"] == "status" and condition(event["positions"]), within)
        positions: dict[str, int] = self.status["positions"]
        return positions

    def shows(self, key: str, value: object, within: float = PATIENCE) -> None:
        """Wait until a ``--supervised`` command's status has that value."""
        if self.status.get(key) != value:
            self.says(lambda event: event["event"] == "status" and event[key] == value, within)

    def hears_no_more(self, quiet: float = 1.5) -> dict[str, int]:
        """Wait until a ``--supervised`` command has had no news for that many seconds; gives its positions."""
        deadline = time.monotonic() + PATIENCE
        with contextlib.suppress(queue.Empty):
            while self._take(quiet) is not None:
                assert time.monotonic() < deadline
        positions: dict[str, int] = self.status["positions"]
        return positions

    def idle(self, seconds: float) -> None:
        """Look on for so long."""
        deadline = time.monotonic() + seconds
        with contextlib.suppress(queue.Empty):
            while (left := deadline - time.monotonic()) > 0 and self._take(left) is not None:
                pass

    def order(self, word: str) -> None:
        """Tell a ``--supervised`` command something."""
        assert self._process.stdin is not None
        self._process.stdin.write(word + "\n")
        self._process.stdin.flush()

    def hang_up(self) -> None:
        """Close its standard input, as the end of whoever started it does."""
        assert self._process.stdin is not None
        self._process.stdin.close()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def ends(self, within: float = PATIENCE) -> int:
        """Wait for its end; gives the exit status."""
        status = self._process.wait(within)
        while self._take(within) is not None:
            pass
        return status

    @property
    def result(self) -> dict[str, Any]:
        """The JSON object on the last line of the output of one that has ended."""
        result: dict[str, Any] = json.loads(self.lines[-1])
        return result

    def report(self, within: float = PATIENCE) -> dict[str, Any]:
        """Wait for its good end; gives its result."""
        assert self.ends(within) == 0, self.errors
        return self.result

    def finish(self) -> dict[str, Any]:
        """Tell a ``--supervised`` command to end; gives its report."""
        self.order("finish")
        return self.report()

    @property
    def errors(self) -> str:
        """What it has written to standard error, news as a person would have it in a terminal."""
        return "".join(
            f"orion: {json.loads(line)['message']}\n" if line.startswith("{") and line.endswith("}\n") else line
            for line in self._errors.read_text().splitlines(keepends=True)
        )

    def close(self) -> None:
        """Make sure that it is gone."""
        self._process.kill()
        self._process.wait()
        self._reader.join()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()


Orion = Callable[..., Command]


@pytest.fixture
def orion(tmp_path: Path) -> Iterator[Orion]:
    """Starts commands: ``orion("demo", "--json")``, also ``inside`` another. They are gone when the test is over."""
    commands: list[Command] = []

    def start(*words: object, inside: Sequence[str] = ()) -> Command:
        command = Command([str(word) for word in words], tmp_path / f"stderr-{len(commands)}", inside)
        commands.append(command)
        return command

    yield start
    for command in commands:
        command.close()


class Processes:
    """What runs on this machine."""

    def __init__(self, orion: Orion) -> None:
        self._orion = orion

    @staticmethod
    def until(condition: Callable[[], Any], within: float = PATIENCE) -> Any:
        """Look again and again; gives what the condition gave when it was first true."""
        deadline = time.monotonic() + within
        while not (result := condition()):
            assert time.monotonic() < deadline, f"not so within {within} s"
            time.sleep(0.02)
        return result

    def children(self, pid: int) -> list[int]:
        """The processes that a process has started, and those that they have."""
        parents = {}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):  # it has just ended
                parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        family = [pid]
        for elder in family:
            family += [child for child, parent in parents.items() if parent == elder]
        return family[1:]

    def members(self, pid: int) -> dict[str, int]:
        """The processes that a ``demo`` or ``replay`` has started: the robots' by id, ``observer`` and ``world``."""
        found = {}
        for child in self.children(pid):
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{child}/cmdline").read_text().split("\0")
                if "--robot" in words:
                    found[words[words.index("--robot") + 1]] = child
                elif "observe" in words:
                    found["observer"] = child
                elif "simulate" in words:
                    found["world"] = child
        return found

    def eyes_on(self, launcher: Command, toml: Path) -> Command:
        """A ``--supervised`` observer of our own that joins a ``demo`` or ``replay`` as soon as all have started."""
        self.until(lambda: "observer" in self.members(launcher.pid))
        return self._orion("observe", "-c", toml, "--supervised")

    def run(self, pid: int) -> bool:
        """Whether a process runs; one that has ended and that nobody asked after (a zombie) does not."""
        try:
            return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
        except OSError:
            return False

    def kill(self, pid: int) -> None:
        """End one at once (one that the test has started)."""
        os.kill(pid, signal.SIGKILL)

    def all_end(self, pids: list[int], within: float = 10.0) -> None:
        """Wait until none of them runs."""
        self.until(lambda: not any(map(self.run, pids)), within)


@pytest.fixture
def processes(orion: Orion) -> Processes:
    """What runs on this machine."""
    return Processes(orion)


# --- swarms

ROOM = World(
    "room", np.array([[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 1.5]], np.float64), (), ()
)


class Swarm:
    """A folder, a free block of ports, and what can be made of them.

    Attributes:
        folder: the test's own.
        base_port: the first of eight free ports, below those that the system gives to clients.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.base_port = self._free_ports()

    @staticmethod
    def _free_ports() -> int:
        chance = random.Random(os.getpid() + time.monotonic_ns())
        while True:
            first = chance.randrange(12_000, 32_000, 8)
            with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
                for port in range(first, first + 8):
                    stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
                return first

    def toml(self, robots: dict[str, Any], *, name: str = "swarm.toml", **keys: Any) -> Path:
        """Write the swarm's TOML."""
        path = self.folder / name
        path.write_bytes(tomli_w.dumps({"base_port": self.base_port, **keys, "robots": robots}).encode())
        return path

    def log(self, name: str = "run.log", *, scans: int = 60, beams: int = 19, seconds: float = 6.0) -> Path:
        """Write the CARMEN log of a robot that drives once round a room of 6 x 4 m with a wall in it."""
        lines = []
        for k in range(scans):
            turn = k / scans * math.tau
            x, y, yaw = 3 + 1.9 * math.cos(turn), 2.3 + 1.2 * math.sin(turn), turn + math.pi / 2
            bearings = yaw - math.pi / 2 + np.arange(beams) * math.pi / (beams - 1)
            ranges = ROOM.cast(np.tile([x, y], (beams, 1)), bearings)
            readings = " ".join(f"{distance:.3f}" for distance in ranges)
            pose = f"{x:.4f} {y:.4f} {yaw:.5f}"
            stamp = f"{k * seconds / scans:.3f}"
            lines.append(f"FLASER {beams} {readings} {pose} {pose} {stamp} test {stamp}\n")
        path = self.folder / name
        path.write_text("".join(lines))
        return path


@pytest.fixture
def swarm(tmp_path: Path) -> Swarm:
    """A folder and free ports."""
    return Swarm(tmp_path)


# --- the truth, without any network


class Truth:
    """Maps made in this process, of all scans in their order; digests in hex."""

    def map_of(self, recordings: list[Recording], cell: float, starts: list[Pose] | None = None) -> Grid:
        """One grid made of all that was recorded."""
        tiles: dict[TileKey, Cells] = {}
        for recording, start in zip(recordings, starts or [Pose()] * len(recordings), strict=True):
            body = RecordedBody(recording)
            while len(readings := body.read(math.inf)):
                scans = readings.scans(QuantisedPose.of(start), body.sensor)
                tiles |= integrated(tiles, scans, body.sensor, EvidenceModel(), Lattice.of(cell))
        return Grid.of(tiles, Lattice.of(cell))

    def digest_of(self, recordings: list[Recording], cell: float, starts: list[Pose] | None = None) -> str:
        """The digest of that grid."""
        return self.map_of(recordings, cell, starts).digest().hex()

    def after_each_scan(
        self,
        recording: Recording,
        cell: float,
        start: Pose = Pose(),  # noqa: B008 - a constant
    ) -> list[Tiles]:
        """One robot's tiles after its first 0, 1, 2 ... scans."""
        body = RecordedBody(recording)
        lattice = Lattice.of(cell)
        tiles: Tiles = {}
        after = [tiles]
        while len(readings := body.read(math.inf)):
            scans = readings.scans(QuantisedPose.of(start), body.sensor)
            for k in range(len(scans)):
                changed = integrated(tiles, scans[k : k + 1], body.sensor, EvidenceModel(), lattice)
                tiles = {**tiles, **changed}
                after.append(tiles)
        return after

    def digests_after_each_scan(self, recording: Recording, cell: float) -> list[str]:
        """The digests of those maps."""
        return [map_digest(tiles).hex() for tiles in self.after_each_scan(recording, cell)]

    def in_file(self, path: object) -> str:
        """The digest of the map in a file, verified."""
        return load_map(Path(str(path))).digest().hex()


@pytest.fixture
def truth() -> Truth:
    """The truth, without any network."""
    return Truth()


# --- a person at the page


@pytest.fixture
def hands():
    """The module beside this one, which wants selenium."""
    path = Path(__file__).with_name("page_browser.py")
    spec = importlib.util.spec_from_file_location("page_browser", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not (module.CHROMIUM and module.DRIVER):
        pytest.skip("there is no browser: apt-get install chromium chromium-driver")
    if not (BUNDLE / "index.html").is_file():
        pytest.skip("the page is not built: cd web && npm ci --ignore-scripts && npm run build")
    return module


@pytest.fixture
def viewer(hands, tmp_path):
    """A browser."""
    viewer = hands.Viewer(tmp_path / "browser", hands.shots_folder())
    yield viewer
    viewer.close()
