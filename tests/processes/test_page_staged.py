"""The page before a swarm that is made up: what holds while a hand is on it, on a small screen, and for everybody."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.config import Config
from agent.page import Page
from agent.page_options import PageOptions
from agent.page_orders import Order
from agent.page_snapshot import SessionView, Snapshot, Timeline, Traffic
from agent.page_tracks import Track
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Cells, Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.sensor import orion
from mapping.tiles import Tiles, frozen
from swarm.contributions import Contribution
from swarm.session import Descriptor, Rules

pytestmark = [pytest.mark.processes, pytest.mark.browser]

PATIENCE = 20.0
RULES = Rules(Lattice(50), EvidenceModel())
STANDING = Timeline(1.0, 2.0, whole=True, torn="", speed=0.0, history=[])

SCALE = """
const tiles = [...document.querySelectorAll(".layer-map .leaflet-tile-container")];
return Math.max(...tiles.filter((each) => each.childElementCount).map((each) => new DOMMatrix(each.style.transform).a));
"""
TRAIL_WIDTH = """
const canvas = document.querySelector(".leaflet-trails-pane canvas.leaflet-zoom-animated");
const {data, width, height} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
let [west, east] = [Infinity, -Infinity];
for (let k = 0; k < width * height; k++) if (data[4 * k + 3] > 128) {
  west = Math.min(west, k % width); east = Math.max(east, k % width);
}
return east - west;
"""
BOX = "const {left, right, top, bottom} = arguments[0].getBoundingClientRect(); return [left, right, top, bottom];"
INSIDE = "return arguments[0].scrollWidth <= arguments[0].clientWidth"
CONTRAST = """
const style = getComputedStyle(arguments[0]);
const light = (colour) => colour.match(/[0-9.]+/g).slice(0, 3).map((each) => each / 255)
  .map((each) => (each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4))
  .reduce((sum, each, k) => sum + each * [0.2126, 0.7152, 0.0722][k], 0.05);
const both = [light(style.color), light(style.backgroundColor)];
return Math.max(...both) / Math.min(...both);
"""


def corridor(tiles: int) -> Tiles:
    """Tiles from the origin to the east, free but for a wall."""
    cells = np.full((TILE, TILE), -300, np.int32)
    cells[5] = 400
    made: Cells = frozen(cells)
    return {TileKey(0, k): made for k in range(tiles)}


def way(poses: int) -> NDArray[np.int32]:
    """A trail from the origin to the east, shape (poses, 3)."""
    return np.column_stack([np.arange(poses) * 2, np.zeros(poses), np.zeros(poses)]).astype(np.int32)


@dataclass
class Stage:
    """A swarm as the test wants it (``agent.page_source.Source``).

    Attributes:
        tiles: of each robot's one session, by its id; of a replaced one none.
        trail: every robot's.
        updates_rate: every robot's.
        timeline: of a log.
    """

    tiles: dict[bytes, Tiles] = field(default_factory=lambda: {b"r1" * 4: corridor(4), b"r2" * 4: corridor(2)})
    trail: NDArray[np.int32] = field(default_factory=lambda: way(2))
    updates_rate: float = 1.0
    timeline: Timeline | None = None

    def take(self, now: float) -> Snapshot:
        """See ``Source``."""
        sessions = tuple(self._view(session, tiles) for session, tiles in sorted(self.tiles.items()))
        fused = {key: cells for view in sessions for key, cells in view.tiles.items()}
        return Snapshot(now, RULES, fused, sessions, (), 0.0, Traffic({}, {}, {}), self.timeline)

    def _view(self, session: bytes, tiles: Tiles) -> SessionView:
        descriptor = Descriptor(session[:2].decode(), session, RULES, orion(), QuantisedPose(0, 0, 0))
        reason = "" if tiles else "replaced by another"
        standing = Contribution(descriptor, n=1, summed=not reason, live=True, duplicate=False, reason=reason)
        track = Track(self.trail, 20, self.trail[-1], np.zeros((0, 2), np.int32), 0)
        return SessionView(standing, 1, 0.0, tiles, track, self.updates_rate, 0.0, descriptor.start)

    def obey(self, order: Order, now: float) -> None:
        """See ``Source``."""
        raise ValueError("nobody is there")


@pytest.fixture
def stage() -> Stage:
    return Stage()


@pytest.fixture
def page(stage) -> Iterator[Page]:
    """Serves it."""
    over = threading.Event()

    def loop(turn: Callable[[float], None]) -> None:
        while not over.wait(0.01):
            turn(time.monotonic())

    with Page(Config(), PageOptions(port=0)) as page:
        thread = threading.Thread(target=loop, args=(page.show(stage),))
        thread.start()
        yield page
        over.set()
        thread.join()


@pytest.fixture
def looker(page, viewer) -> Any:
    """A person who sees two robots."""
    viewer.open(page.url)
    viewer.until(lambda: len(viewer.all(".robot-card")) == 2, PATIENCE)
    return viewer


def pressed(viewer: Any, session: bytes) -> None:
    """Press the layer button of a robot's."""
    viewer.click(f'[data-session="{session.hex()}"] .layer')


def test_a_robots_picture_stays_in_the_hand_while_the_robot_maps_on(stage, looker, hands) -> None:
    looker.click(f'[data-session="{(b"r1" * 4).hex()}"] .place')
    hand = hands.ActionChains(looker.driver, duration=40)
    hand.move_to_element(looker.find(".placed")).click_and_hold().move_by_offset(40, 0).perform()
    first = float(looker.find("#place-x").get_attribute("value"))
    assert first > 0
    width = looker.find(".placed").get_attribute("width")
    stage.tiles = stage.tiles | {b"r1" * 4: corridor(6)}
    looker.until(lambda: looker.find(".placed").get_attribute("width") != width, PATIENCE)
    hands.ActionChains(looker.driver, duration=40).move_by_offset(40, 0).release().perform()
    assert float(looker.find("#place-x").get_attribute("value")) == pytest.approx(2 * first, rel=0.05)


def test_escape_leaves_placing_wherever_the_focus_is(looker, hands) -> None:
    looker.click(f'[data-session="{(b"r1" * 4).hex()}"] .place')
    looker.driver.execute_script("document.getElementById('place-x').focus()")
    looker.press(hands.ESCAPE)
    looker.until(lambda: not looker.find("#place").is_displayed(), PATIENCE)


def test_the_panel_covers_nothing_that_is_told_of_a_cell(looker) -> None:
    panel = looker.driver.execute_script(BOX, looker.find("#panel"))[0]
    middle = looker.driver.execute_script(BOX, looker.find("#map"))[1] / 2
    looker.click_at("#map", int(panel - 20 - middle), 0)
    looker.until(lambda: looker.all(".cell-box"), PATIENCE)
    looker.until(lambda: looker.driver.execute_script(BOX, looker.find(".cell-box"))[1] <= panel, PATIENCE)


def test_a_replaced_session_leaves_the_map_as_it_is_without_it(stage, looker) -> None:
    pressed(looker, b"r1" * 4)
    looker.until(lambda: "own maps" in looker.find("#legend").text, PATIENCE)
    stage.tiles = {b"r1" * 4: {}, b"r1-again": corridor(4)}
    looker.until(lambda: "occupied" in looker.find("#legend").text, PATIENCE)
    looker.press("l")
    looker.until(lambda: looker.all(f".layer-{b'r1-again'.hex()}"), PATIENCE)
    looker.click("#peers summary")
    stage.updates_rate = 7.0
    looker.until(lambda: "7.0/s" in looker.find(".robot-card .rates").text, PATIENCE)
    assert looker.find("#peers details p").is_displayed()


def test_a_trail_is_drawn_to_its_end_even_if_nothing_comes_after_it(stage, looker) -> None:
    stage.timeline = STANDING
    looker.until(lambda: looker.find("#timeline").is_displayed(), PATIENCE)
    stage.trail = way(1500)
    before = looker.until(lambda: looker.driver.execute_script(TRAIL_WIDTH), PATIENCE)
    stage.trail = way(3000)
    looker.until(lambda: looker.driver.execute_script(TRAIL_WIDTH) > 1.8 * before, PATIENCE)


def test_a_key_zooms_once_wherever_the_focus_is(looker) -> None:
    looker.driver.execute_script("document.getElementById('map').focus()")
    before = looker.driver.execute_script(SCALE)
    looker.press("+")
    looker.until(lambda: looker.driver.execute_script(SCALE) != before, PATIENCE)
    assert looker.driver.execute_script(SCALE) == pytest.approx(before * math.sqrt(2))


def test_a_contradiction_is_counted_whatever_the_colours(stage, looker) -> None:
    free = frozen(np.full((TILE, TILE), -300, np.int32))
    stage.tiles = stage.tiles | {b"r2" * 4: {TileKey(0, 0): free}}
    looker.click('[data-view="disagreement"]')
    looker.until(lambda: looker.find("#legend .note").text == f"{TILE} cells", PATIENCE)
    looker.press("d")
    assert looker.find("#legend .note").text == f"{TILE} cells"
    looker.click(f'[data-session="{(b"r1" * 4).hex()}"] .place')
    assert "own maps" in looker.find("#legend").text


def test_a_page_that_comes_while_a_log_is_played_knows_how_fast(stage, page, viewer) -> None:
    stage.timeline = replace(STANDING, speed=10.0)
    viewer.open(page.url)
    viewer.until(lambda: viewer.find("#speed").get_attribute("value") == "10", PATIENCE)
    stage.timeline = STANDING
    viewer.until(lambda: viewer.find("#play").get_attribute("data-playing") == "false", PATIENCE)
    assert viewer.find("#speed").get_attribute("value") == "10"
    assert not viewer.all("output")  # which would be read out with every step


def test_words_fit_on_a_small_phone(page, viewer) -> None:
    width = 360
    viewer.open(page.url, (width, 740))
    viewer.until(lambda: len(viewer.all(".robot-card")) == 2, PATIENCE)
    pressed(viewer, b"r1" * 4)
    for view in ("map", "witness", "disagreement"):
        viewer.click(f'[data-view="{view}"]')
        assert (
            viewer.driver.execute_script(BOX, viewer.find("#legend"))[0]
            >= (viewer.driver.execute_script(BOX, viewer.find("#tools"))[1])
        )
        assert viewer.driver.execute_script(INSIDE, viewer.find("#legend"))
    page.__exit__()
    viewer.until(lambda: "cannot be reached" in viewer.find("#banner").text, PATIENCE)
    left, right, *_ = viewer.driver.execute_script(BOX, viewer.find("#banner"))
    assert viewer.driver.execute_script(BOX, viewer.find("#tools"))[1] <= left < right <= width
    viewer.shot("small-phone-lost")


def test_what_cannot_be_seen_or_done_cannot_be_reached_with_keys(page, looker) -> None:
    reached = "arguments[0].focus(); return document.activeElement === arguments[0]"
    pressed(looker, b"r1" * 4)
    if looker.driver.execute_script("return document.documentElement.dataset.theme") == "light":
        looker.press("d")
    layer = looker.find(f'[data-session="{(b"r1" * 4).hex()}"] .layer')
    assert looker.driver.execute_script(CONTRAST, layer) > 4.5
    assert looker.driver.execute_script(reached, looker.find("#theme"))
    looker.press("b")
    looker.until(lambda: not looker.driver.execute_script(reached, looker.find("#theme")), PATIENCE)
    looker.press("b")
    looker.until(lambda: looker.driver.execute_script(reached, looker.find("#theme")), PATIENCE)
    page.__exit__()
    looker.until(lambda: "cannot be reached" in looker.find("#banner").text, PATIENCE)
    assert not looker.driver.execute_script(reached, looker.find('[href="api/map.png"]'))
