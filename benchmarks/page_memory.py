"""What the memory of the page's server does in a minute: 20 robots, ten scans a second each, in rooms that they know.

One browser takes all that it is sent, in a process of its own; another has opened the live socket and never reads. The
map does not grow any more, so what grows is the page's or the observer's fault; the trails do, by 12 bytes for every
2 cm. The robots' own peers are in this process too.
"""

from __future__ import annotations

import gc
import resource
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from agent.config import Config
from agent.page import Page
from agent.page_options import PageOptions
from benchmarks.inputs import ORION, orion_walk
from benchmarks.integration import kernels
from benchmarks.table import Row
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import Scans
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor, Rules

ROBOTS = 20
_RATE = 10
_KNOWN = 1300
"""Scans of each robot before the minute begins: once round its room."""

_MARKS = (0, 20, 40, 60)
_BROWSER = """
import sys
from websockets.sync.client import connect
with connect(sys.argv[1], max_size=None) as socket:
    taken = 0
    try:
        for frame in socket:
            taken += len(frame)
    finally:
        print(taken)
"""


class _Swarm:
    """Robots and the observer that hears them."""

    def __init__(self, page: Page) -> None:
        self._kernel = kernels().get("fast") or kernels()["NumPy"]
        self._rules = Rules(Lattice(20), EvidenceModel())
        self.heard: Counter[str] = Counter()
        self.observer = self._peer(Hello.OBSERVER, "observer", page)
        self._robots = {f"r{k}": self._peer(Hello.ROBOT, f"r{k}") for k in range(ROBOTS)}
        start = QuantisedPose(0, 0, 0)
        for k, (name, robot) in enumerate(self._robots.items()):
            robot.open_session(Descriptor(name, bytes([k + 1] * 8), self._rules, ORION, start))
        self._walks = [orion_walk(_KNOWN, k, cells_away=300 * k) for k in range(ROBOTS)]

    def _peer(self, role: int, name: str, page: Page | None = None) -> Peer:
        hello = Hello(role, name.encode(), b"benchmark")
        listener = (lambda descriptor, update: None) if page is None else page
        return Peer(hello, self._rules, seed=name.encode(), mtu=32_768, now=0.0, kernel=self._kernel, listener=listener)

    def sense(self, first: int, count: int, now: float) -> None:
        """Every robot senses, and is heard."""
        for walk, (name, robot) in zip(self._walks, self._robots.items(), strict=True):
            part = walk[first % _KNOWN : first % _KNOWN + count]
            scans = Scans(100 * np.arange(first, first + count), part.poses, part.ranges)
            assert robot.writer is not None
            robot.writer.sense(scans)
            robot.flush(now)
            for out in robot.poll(now):
                if out.to in {None, "observer"}:
                    self.heard[name] += len(out.payload)
                    self.observer.receive(name, out.payload, now)
        self.observer.poll(now)


def measure() -> list[Row]:
    """Memory after 20, 40 and 60 seconds."""
    with Page(Config(), PageOptions(port=0)) as page:
        swarm = _Swarm(page)
        for first in range(0, _KNOWN, 50):
            swarm.sense(first, 50, first / _RATE)
        began, turn = time.monotonic(), page.watch(swarm.observer, swarm.heard)
        turn(began)
        at = urlsplit(page.url)
        browser = subprocess.Popen(
            [sys.executable, "-c", _BROWSER, f"ws://{at.netloc}/live"], stdout=subprocess.PIPE, text=True
        )
        with socket.create_connection((at.hostname, at.port)) as stalled:
            lines = ["GET /live HTTP/1.1", f"Host: {at.netloc}", "Upgrade: websocket", "Connection: Upgrade"]
            lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", "", ""]
            stalled.sendall("\r\n".join(lines).encode())
            rows = _minute(swarm, turn, time.monotonic())
        page.end()
        taken = int(browser.communicate(timeout=30)[0])
        facts = f"{len(swarm.observer.fusion.tiles)} tiles; the browser took {taken / 1e6:.0f} MB"
        return [row._replace(note=row.note or facts) for row in rows]


def _minute(swarm: _Swarm, turn: Callable[[float], None], began: float) -> list[Row]:
    rows: list[Row] = []
    for step in range(_MARKS[-1] * _RATE + 1):
        due = began + step / _RATE
        if step % _RATE == 0 and step // _RATE in _MARKS:
            gc.collect()
            late = time.monotonic() - due
            note = f"{late:.1f} s late" if late > 1 else ""
            rows.append(Row(f"memory after {step // _RATE} s", _resident() / 1e6, "MB", note=note))
        swarm.sense(_KNOWN + step, 1, (_KNOWN + step) / _RATE)
        turn(time.monotonic())
        while (left := due + 1 / _RATE - time.monotonic()) > 0:
            time.sleep(min(left, 0.02))
            turn(time.monotonic())
    return rows


def _resident() -> int:
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
