"""The observer's page, as a person sees it in a browser: the map cell for cell, and what can be decided there."""

from __future__ import annotations

import json
import math
import signal
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.log_reader import LogReader
from agent.playback import read
from mapping.evidence import EvidenceModel
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_archive import decode_npz
from mapping.map_picture import brightness
from mapping.pose import Pose
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Rules

pytestmark = [pytest.mark.processes, pytest.mark.browser]

CELL = 0.05
ROBOTS = {"r1": 60, "r2": 55, "r3": 50}
"""How many scans each has of the same room."""

RIGHT = dict.fromkeys(ROBOTS, Pose())
WRONG = RIGHT | {"r2": Pose(0.4, -0.25, math.radians(5))}
PATIENCE = 20.0


class Bench:
    """A swarm whose robots have seen a room, its observer, and a person at the page.

    Attributes:
        url: the page's.
        viewer: the browser.
        grid: the map as the server has it, r2 being placed wrong.
    """

    def __init__(self, url: str, viewer: Any, truth: Any, folder: Path) -> None:
        self.url = url
        self.viewer = viewer
        self._truth = truth
        self._folder = folder
        self.grid: Grid

    def map_of(self, **placed: Pose) -> Grid:
        """The map of some robots, made here."""
        recordings = [read(self._folder / f"{name}.log")[0] for name in placed]
        return self._truth.map_of(recordings, CELL, list(placed.values()))

    def await_map(self, **placed: Pose) -> None:
        """Wait until the page shows the digest of that map."""
        digest = self.map_of(**placed).digest().hex()
        self.viewer.until(lambda: self.viewer.find("#digest").get_attribute("data-digest") == digest, PATIENCE)

    def ask(self, path: str) -> bytes:
        """What the page's server answers."""
        with urllib.request.urlopen(self.url + path, timeout=PATIENCE) as response:
            return response.read()

    def session(self, robot: str) -> dict[str, Any]:
        """A robot's session as the server tells of it."""
        sessions = json.loads(self.ask("api/state"))["sessions"]
        return next(each for each in sessions if each["robot"] == robot and not each["replaced"])

    def card(self, robot: str, button: str) -> str:
        """The selector of a button of a robot's."""
        return f'[data-session="{self.session(robot)["session"]}"] {button}'

    def pixels(self, layer: str) -> Any:
        """A layer's pixels in the shape of the map."""
        return self.viewer.pixels(layer, self.grid.i0, self.grid.j0, *self.grid.evidence.shape)

    def in_shape(self, part: Grid) -> Any:
        """The evidence of a smaller map in the shape of the map."""
        whole = np.zeros(self.grid.evidence.shape, np.int64)
        row, column = part.j0 - self.grid.j0, part.i0 - self.grid.i0
        whole[row : row + part.evidence.shape[0], column : column + part.evidence.shape[1]] = part.evidence
        return whole

    def contradicted(self, **placed: Pose) -> Any:
        """On which cells some of the robots contradict others as strongly as with one clear hit."""
        parts = np.stack([self.in_shape(self.map_of(**{name: pose})) for name, pose in placed.items()])
        return np.minimum(parts.clip(min=0).sum(axis=0), -parts.clip(max=0).sum(axis=0)) >= 85

    def doubted(self) -> int:
        """How many cells the page counts on which robots contradict each other."""
        return int((self.viewer.find("#legend .note").text or "0").split()[0])


def draws(viewer: Any, grid: Grid) -> bool:
    """Whether the page shows that map, in grey, cell for cell."""
    pixels = viewer.pixels(".layer-map", grid.i0, grid.j0, *grid.evidence.shape)
    return bool((pixels[..., :3] == brightness(grid)[::-1, :, None]).all() and (pixels[..., 3] == 255).all())


@pytest.fixture
def lab(swarm):
    """The TOML of three robots; r2 was not started where it says."""
    robots = {}
    for name, scans in ROBOTS.items():
        log, pose = swarm.log(f"{name}.log", scans=scans, seconds=3.0), WRONG[name]
        start = {"x": pose.x, "y": pose.y, "yaw_deg": math.degrees(pose.yaw)}
        robots[name] = {"start": start, "body": {"kind": "recording", "path": str(log), "speed": 1.0}}
    return swarm.toml(robots, cell=CELL)


def test_a_person_sees_the_map_cell_for_cell_and_corrects_it(orion, swarm, lab, truth, viewer, hands) -> None:
    watch = orion("observe", "-c", lab, "--supervised", "--page", "--port", swarm.base_port + 7)
    bench = Bench(watch.says(lambda event: event["event"] == "page")["url"], viewer, truth, swarm.folder)
    viewer.open(bench.url)
    agents = [orion("agent", "-c", lab, "--robot", name, "--supervised") for name in ROBOTS]
    for agent in agents:
        agent.is_ready()
    for agent in agents:
        agent.order("go")
    bench.await_map(**WRONG)
    assert len(viewer.all(".robot-card")) == 3
    viewer.press("f")
    viewer.shot("desktop-light")

    the_map_is_drawn_cell_for_cell(bench)
    a_robots_own_layer_is_drawn_cell_for_cell(bench)
    a_click_tells_who_saw_a_cell(bench, hands.ESCAPE)
    contradictions_are_drawn_cell_for_cell(bench)
    a_robot_is_taken_out_and_in_again(bench)
    a_start_pose_is_dragged(bench)
    other_screens(bench, hands.PHONE)

    assert watch.finish()["map_digest"] == bench.map_of(**RIGHT).digest().hex()
    viewer.until(lambda: "has ended" in viewer.find("#banner").text, PATIENCE)
    bench.await_map(**RIGHT)  # it stays
    viewer.shot("ended")
    assert {message for message in viewer.complaints() if "ERR_CONNECTION_REFUSED" not in message} == set()
    assert viewer.hosts_asked() == {bench.url.split("/")[2]}


def test_the_page_outlives_its_observer_and_finds_the_next_one(orion, swarm, lab, truth, viewer) -> None:
    words = ("observe", "-c", lab, "--supervised", "--page", "--port", swarm.base_port + 7)

    def stands(standing: str) -> None:
        shown = (
            'return document.documentElement.dataset.standing + (document.getElementById("banner").hidden ? "" : "!")'
        )
        viewer.until(lambda: viewer.driver.execute_script(shown) == standing, PATIENCE)

    watch = orion(*words)
    bench = Bench(watch.says(lambda event: event["event"] == "page")["url"], viewer, truth, swarm.folder)
    agents = [orion("agent", "-c", lab, "--robot", name, "--supervised") for name in ROBOTS]
    for agent in agents:
        agent.is_ready()
        agent.order("go")
    viewer.open(bench.url)
    bench.await_map(**WRONG)
    bench.grid = decode_npz(bench.ask("api/map.npz"))
    viewer.choose("#palette", "grey")
    stands("live")
    watch.signal(signal.SIGKILL)
    stands("lost!")
    viewer.shot("lost")
    assert viewer.until(lambda: draws(viewer, bench.grid), PATIENCE)
    watch = orion(*words)
    stands("live")
    bench.await_map(**WRONG)
    watch.finish()
    stands("ended!")
    assert viewer.until(lambda: draws(viewer, bench.grid), PATIENCE)
    orion(*words).is_ready()
    stands("live")
    bench.await_map(**WRONG)
    assert {message for message in viewer.complaints() if "ERR_CONNECTION_REFUSED" not in message} == set()


def test_a_log_is_shown_as_it_was_at_any_time(orion, swarm, processes, lab, viewer, hands) -> None:
    log, port = swarm.folder / "run.mcap", swarm.base_port + 7
    observer = orion("observe", "-c", lab, "--supervised", "--no-page", "--record", log)
    agents = [orion("agent", "-c", lab, "--robot", name, "--supervised") for name in ROBOTS]
    for agent in [observer, *agents]:
        agent.is_ready()
    observer.shows("around", len(ROBOTS))
    for agent in agents:
        agent.order("go")
    for agent in agents:
        agent.shows("done", value=True)
    observer.hears_no_more()
    recorded = observer.finish()
    for agent in agents:
        agent.finish()

    def at(seconds: float) -> Grid:
        """The map of a peer that heard only what had been recorded until then."""
        peer, began = (
            Peer(Hello(0, b"t", b""), Rules(Lattice.of(CELL), EvidenceModel()), seed=b"t", mtu=32768, now=0),
            None,
        )
        for log_ns, told in LogReader(log).told():
            began = log_ns if began is None else began
            if (log_ns - began) / 1e9 <= seconds:
                peer.repeat(told, 0.0)
        return Grid.of(peer.fusion.tiles, peer.rules.lattice)

    def shows(digest: str) -> None:
        viewer.until(lambda: viewer.find("#digest").get_attribute("data-digest") == digest, PATIENCE)

    show = orion("log", "show", log, "--port", port, "--no-open")
    processes.until(lambda: f"127.0.0.1:{port}" in show.errors)
    viewer.open(f"http://127.0.0.1:{port}/")
    shows(recorded["map_digest"])
    viewer.choose("#palette", "grey")
    viewer.until(lambda: draws(viewer, at(math.inf)), PATIENCE)
    assert not viewer.find(".robot-card .evict").is_displayed()
    viewer.shot("log")
    duration = float(viewer.find("#time").get_attribute("max"))
    for share in (0.6, 0.3, 0.8):
        viewer.type("#time", str(share * duration))
        then = at(share * duration)
        shows(then.digest().hex())
        viewer.until(lambda then=then: draws(viewer, then), PATIENCE)
        viewer.shot(f"log-{share}")
    viewer.press(hands.HOME)
    shows(at(0.0).digest().hex())
    viewer.press(" ")
    viewer.until(lambda: viewer.find("#play").get_attribute("data-playing") == "true", PATIENCE)
    shows(recorded["map_digest"])
    viewer.until(lambda: viewer.find("#play").get_attribute("data-playing") == "false", PATIENCE)
    show.signal(signal.SIGINT)
    assert show.ends() == 0
    viewer.until(lambda: "log is closed" in viewer.find("#banner").text, PATIENCE)


def the_map_is_drawn_cell_for_cell(bench: Bench) -> None:
    bench.grid = decode_npz(bench.ask("api/map.npz"))
    bench.viewer.choose("#palette", "grey")
    bench.viewer.until(lambda: draws(bench.viewer, bench.grid), PATIENCE)
    bench.viewer.choose("#palette", "paper")


def a_robots_own_layer_is_drawn_cell_for_cell(bench: Bench) -> None:
    session = bench.session("r1")
    layer = f".layer-{session['session']}"
    bench.viewer.click(bench.card("r1", ".layer"))
    bench.viewer.until(lambda: bench.pixels(layer).any(), PATIENCE)
    own, evidence = bench.pixels(layer), bench.in_shape(bench.map_of(r1=RIGHT["r1"]))
    assert ((own[..., 3] > 0) == (evidence != 0)).all()
    sure = own[evidence > 200][:, :3].astype(int)  # p > 0.88: hardly transparent
    assert len(sure)
    colour = [int(session["colour"][k : k + 2], 16) for k in (1, 3, 5)]
    assert (abs(sure - colour) <= 2).all()  # a canvas keeps colours multiplied by their opacity
    bench.viewer.shot("layers")
    bench.viewer.click(bench.card("r1", ".layer"))


def a_click_tells_who_saw_a_cell(bench: Bench, escape: str) -> None:
    viewer = bench.viewer
    viewer.click('[data-view="witness"]')
    viewer.shot("witness")
    viewer.click('[data-view="map"]')
    viewer.click_at("#map", -180, 0)
    rows = viewer.until(lambda: viewer.all(".cell-box tr"), PATIENCE)
    viewer.shot("cell")
    told = {row.get_attribute("data-robot"): int(row.get_attribute("data-evidence")) for row in rows}
    i, j = map(int, viewer.find(".cell-box .dim").text.removeprefix("cell ").split(" at")[0].split(","))
    row, column = j - bench.grid.j0, i - bench.grid.i0
    assert told == {name: bench.in_shape(bench.map_of(**{name: WRONG[name]}))[row, column] for name in ROBOTS}
    viewer.press(escape)


def contradictions_are_drawn_cell_for_cell(bench: Bench) -> None:
    bench.viewer.click('[data-view="disagreement"]')
    expected = bench.contradicted(**WRONG)
    assert expected.any()
    bench.viewer.until(lambda: np.array_equal(bench.pixels(".layer-view")[..., 3] > 0, expected), PATIENCE)
    bench.viewer.until(lambda: bench.doubted() == expected.sum(), PATIENCE)
    bench.viewer.shot("disagreement")


def a_robot_is_taken_out_and_in_again(bench: Bench) -> None:
    viewer = bench.viewer
    viewer.click(bench.card("r2", ".name"))
    viewer.click(bench.card("r2", ".evict"))
    viewer.shot("evict")
    viewer.click("#confirm")
    others = {"r1": RIGHT["r1"], "r3": RIGHT["r3"]}
    bench.await_map(**others)
    state = bench.card("r2", ".state")
    viewer.until(lambda: "evicted by observer" in viewer.find(state).text, PATIENCE)
    viewer.until(lambda: bench.doubted() == bench.contradicted(**others).sum(), PATIENCE)
    viewer.shot("evicted")
    viewer.click(bench.card("r2", ".evict"))
    viewer.click("#confirm")
    bench.await_map(**WRONG)


def a_start_pose_is_dragged(bench: Bench) -> None:
    viewer = bench.viewer
    wrong = bench.session("r2")["session"]

    def field(name: str) -> float:
        return float(viewer.find(f"#place-{name}").get_attribute("value"))

    viewer.click('[data-view="map"]')
    viewer.click(bench.card("r2", ".place"))
    assert (field("x"), field("y"), field("yaw")) == (0.4, -0.25, 5.0)
    viewer.drag(".start-mark", -40, 0)
    assert field("x") < 0.39
    assert field("y") == pytest.approx(-0.25, abs=0.01)
    viewer.drag(".turn-mark", 0, -20)
    assert field("yaw") > 6
    for name in ("x", "y", "yaw"):  # no hand is as steady as this
        viewer.type(f"#place-{name}", "0")
    viewer.shot("placing")
    viewer.click("#place-send")
    viewer.shot("confirm")
    viewer.click("#confirm")
    bench.await_map(**RIGHT)
    assert bench.session("r2")["session"] != wrong
    viewer.until(lambda: "all agree" in viewer.find("#facts .mark").text, 2 * PATIENCE)


def other_screens(bench: Bench, phone: tuple[int, int]) -> None:
    for name, options in {
        "desktop-dark": {"dark": True},
        "phone-light": {"size": phone},
        "phone-dark": {"size": phone, "dark": True},
    }.items():
        bench.viewer.open(bench.url, **options)
        bench.await_map(**RIGHT)
        bench.viewer.until(lambda: bench.viewer.all("canvas.cells"), PATIENCE)
        bench.viewer.shot(name)
