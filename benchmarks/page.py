"""The observer's page: how soon a large map is seen in a browser, how smoothly it moves, and what the server costs.

The map of 6,400 tiles (51 m square at 2 cm) is that of four robots which go on mapping meanwhile. Marks are the page's
own (``performance.mark`` in ``web/src``), counted from the moment at which the browser began to load it. A long task is
one that keeps the browser from drawing for more than 50 ms.
"""

from __future__ import annotations

import importlib.util
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from agent.config import Config
from agent.overview import Overview
from agent.page import Page
from agent.page_feed import Feed
from agent.page_options import PageOptions
from agent.page_orders import Order
from agent.page_server import BUNDLE
from agent.page_snapshot import SessionView, Snapshot, Traffic
from agent.page_tracks import Track
from benchmarks.inputs import ORION
from benchmarks.table import Row, compared, cpu_seconds
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Cells, Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.tiles import frozen
from swarm.contributions import Contribution
from swarm.session import Descriptor, Rules

SIDE = 80
"""Tiles from west to east, and from south to north."""

_ROBOTS = 4
_A_TURN = 12
"""Tiles of each robot's map that change from one snapshot to the next."""

_OPENINGS = 5
_PATIENCE = 30.0
_RULES = Rules(Lattice(20), EvidenceModel())
_HANDS = Path(__file__).parents[1] / "tests" / "processes" / "page_browser.py"

_MARKS = """
const at = (name) => performance.getEntriesByName(name)[0]?.startTime;
return [at("orion-first"), at("orion-whole")];
"""
_WATCH = """
window.longTasks = []; window.frames_ = [];
new PerformanceObserver((list) => window.longTasks.push(...list.getEntries().map((each) => each.duration)))
  .observe({type: "longtask"});
const tick = (at) => { window.frames_.push(at); requestAnimationFrame(tick); }; requestAnimationFrame(tick);
"""
_WATCHED = """
const gaps = window.frames_.slice(1).map((at, k) => at - window.frames_[k]);
const found = [Math.max(0, ...window.longTasks), gaps.length, Math.max(...gaps)];
window.longTasks = []; window.frames_ = []; return found;
"""


class LargeMap:
    """Four robots that each have a quarter of a large map, and go on (``agent.page_source.Source``)."""

    def __init__(self, side: int = SIDE) -> None:
        self._chance = np.random.default_rng(1)
        half = side // 2
        self._maps: list[dict[TileKey, Cells]] = [
            {TileKey(y, x): self._cells() for y in range(y0, y0 + half) for x in range(x0, x0 + half)}
            for y0 in (-half, 0)
            for x0 in (-half, 0)
        ]
        self._fused = {key: cells for tiles in self._maps for key, cells in tiles.items()}

    def _cells(self) -> Cells:
        """A room's corner: free, with walls, and something that nobody has seen."""
        cells = np.full((TILE, TILE), -300, np.int32) + self._chance.integers(0, 200, (TILE, TILE), dtype=np.int32)
        wall, door = self._chance.integers(0, TILE, 2)
        cells[wall], cells[:, wall] = 400, 400
        cells[door : door + 8, door : door + 8] = 0
        return frozen(cells)

    def take(self, now: float) -> Snapshot:
        """See ``Source``."""
        for number, tiles in enumerate(self._maps):
            keys = list(tiles)
            changed = {keys[k]: self._cells() for k in self._chance.integers(0, len(keys), _A_TURN)}
            self._maps[number] = tiles | changed
            self._fused |= changed
        views = tuple(self._view(number) for number in range(_ROBOTS))
        return Snapshot(
            now=now,
            rules=_RULES,
            fused=self._fused.copy(),
            sessions=views,
            peers=(),
            bytes_rate=0.0,
            traffic=Traffic({}, {}, {}),
        )

    def _view(self, number: int) -> SessionView:
        session = bytes([number + 1] * 8)
        descriptor = Descriptor(f"r{number + 1}", session, _RULES, ORION, QuantisedPose(0, 0, 0))
        way = np.arange(0, 20_000, 20, dtype=np.int32)
        trail = np.column_stack([way * (1 if number % 2 else -1), np.full_like(way, 3000 * number - 4500), way * 0])
        return SessionView(
            contribution=Contribution(descriptor, n=1, summed=True, live=True, duplicate=False, reason=""),
            known_n=1,
            age=0.0,
            tiles=self._maps[number],
            track=Track(trail, 20, trail[-1], np.zeros((0, 2), np.int32), 0),
            updates_rate=10.0,
            bytes_rate=1000.0,
            start=descriptor.start,
        )

    def obey(self, order: Order, now: float) -> None:
        """See ``Source``."""
        raise ValueError("nobody is there")


@contextmanager
def _served() -> Iterator[str]:
    """The page of a large map; gives its address."""
    with Page(Config(), PageOptions(port=0)) as page:
        turn, over = page.show(LargeMap()), threading.Event()

        def loop() -> None:
            while not over.wait(0.02):
                turn(time.monotonic())

        thread = threading.Thread(target=loop)
        thread.start()
        try:
            yield page.url
        finally:
            over.set()
            thread.join()


def measure() -> list[Row]:
    """Rows of the server alone, and of the browser if there is one."""
    rows = _server()
    spec = importlib.util.spec_from_file_location("page_browser", _HANDS)
    assert spec is not None
    assert spec.loader is not None
    hands = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hands)
    if not (hands.CHROMIUM and hands.DRIVER):
        return [*rows, Row("in a browser: NOT MEASURED", 0, "", note="apt-get install chromium chromium-driver")]
    if not (BUNDLE / "index.html").is_file():
        return [
            *rows,
            Row("in a browser: NOT MEASURED", 0, "", note="cd web && npm ci --ignore-scripts && npm run build"),
        ]
    with tempfile.TemporaryDirectory() as folder, _served() as url:
        viewer = hands.Viewer(Path(folder), None, note_hosts=False)
        try:
            return rows + _browser(viewer, url)
        finally:
            viewer.close()


def _server() -> list[Row]:
    """What it computes for a browser that has come."""
    feed, source = Feed(Overview("lab", ["r1", "r2", "r3", "r4"])), LargeMap()
    taken = cpu_seconds(lambda: feed.take(source.take(0.0)))
    browser = feed.join()
    sizes: list[int] = []
    first = cpu_seconds(lambda: sizes.append(len(browser.frame() or b"")))

    def rest() -> None:
        while (frame := browser.frame()) is not None:
            sizes.append(len(frame))

    others = cpu_seconds(rest)
    return [
        Row("server: a snapshot in which all is new", 1000 * taken, "ms"),
        Row("server: the first frame", 1000 * first, "ms", note=f"{sizes[0] / 1e6:.2f} MB"),
        Row("server: all others", 1000 * others, "ms", note=f"{len(sizes) - 1} frames, {sum(sizes[1:]) / 1e6:.1f} MB"),
    ]


def _browser(viewer: Any, url: str) -> list[Row]:
    """What a person sees."""
    viewer.open(url)
    viewer.until(lambda: viewer.driver.execute_script(_MARKS)[1], _PATIENCE)  # the browser's own caches are warm
    viewer.driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
    names = ("the map is seen", "every cell of it is there", "computing for that, the page's thread")
    marks: dict[str, list[float]] = {f"browser: {name}": [] for name in names}
    for _ in range(_OPENINGS):
        viewer.open("about:blank")
        viewer.open(url)
        viewer.until(lambda: viewer.driver.execute_script(_MARKS)[1], _PATIENCE)
        figures = [*viewer.driver.execute_script(_MARKS), 1000 * _computing(viewer)]
        for values, at in zip(marks.values(), figures, strict=True):
            values.append(at)
    viewer.driver.execute_script(_WATCH)
    rows = compared(marks, "ms")
    for what, deed in _motions(viewer).items():
        viewer.driver.execute_script(_WATCHED)
        begin = time.monotonic()
        deed()
        longest, frames, gap = viewer.driver.execute_script(_WATCHED)
        rate = f"{frames / (time.monotonic() - begin):.0f} frames/s, longest gap {gap:.0f} ms"
        rows.append(Row(f"browser: longest task while {what}", longest, "ms", note=rate))
    return rows


def _computing(viewer: Any) -> float:
    """Seconds that the page's own thread has computed since it was loaded."""
    metrics = viewer.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "TaskDuration"))


def _motions(viewer: Any) -> dict[str, Callable[[], None]]:
    from selenium.webdriver.common.action_chains import ActionChains

    def pan() -> None:
        hand = ActionChains(viewer.driver, duration=16).move_to_element(viewer.find("#map")).click_and_hold()
        for k in range(120):
            hand.move_by_offset(*((6, 3) if k % 60 < 30 else (-6, -3)))
        hand.release().perform()

    def closer() -> None:
        for key in "++++----":
            viewer.press(key)
            time.sleep(0.3)

    def close_up() -> None:
        for key in "++++":
            viewer.press(key)
        time.sleep(1)
        pan()

    def watch() -> None:
        time.sleep(3)

    def views() -> None:
        for key in "2341":
            viewer.press(key)
            time.sleep(0.5)

    return {
        "it is looked at": watch,
        "panning, all of it in sight": pan,
        "zooming": closer,
        "panning, close up": close_up,
        "changing views": views,
    }
