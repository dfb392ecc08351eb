"""What browsers are sent: put together again it is the map, however slowly it is taken."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.overview import Overview
from agent.page_feed import FRAME_TILES, FUSED, Feed, pooled
from agent.page_history import MOST_HISTORY
from agent.page_snapshot import SessionView, Snapshot, Snapshots, Traffic
from agent.page_tracks import Track
from mapping.evidence import EvidenceModel
from mapping.lattice import TILE, Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.sensor import orion
from swarm.contributions import Contribution
from swarm.session import Descriptor, Rules

RULES = Rules(Lattice(50), EvidenceModel())
NOTHING = Traffic({}, {}, {})


class Screen:
    """A browser's memory: what its frames made of it."""

    def __init__(self) -> None:
        self.tiles: dict[str, dict[TileKey, np.ndarray]] = {}
        self.coarse: dict[TileKey, np.ndarray] = {}
        self.trails: dict[str, list[list[int]]] = {}
        self.hits: dict[str, int] = {}
        self.history: list[list[float]] = []
        self.state: dict = {}
        self.ended = False

    def show(self, frame: bytes) -> None:
        content = msgpack.unpackb(frame)
        for layer, level, keys, cells in content.get("tiles", []):
            places = np.frombuffer(keys, "<i4").reshape(-1, 2).tolist()
            values = np.frombuffer(cells, "<i2").reshape(-1, TILE >> level, TILE >> level)
            assert len(places) == len(values)
            assert values.size <= FRAME_TILES * TILE * TILE
            tiles = self.coarse if level else self.tiles.setdefault(layer, {})
            tiles.update(zip([TileKey(*place) for place in places], values, strict=True))
        for layer, first, trail, first_hit, hits in content.get("tracks", []):
            known = self.trails.setdefault(layer, [])
            assert first <= len(known)
            known[first:] = np.frombuffer(trail, "<i4").reshape(-1, 3).tolist()
            self.hits[layer] = first_hit + len(hits) // 8
        self.history += content.get("history", [])
        self.state = content.get("state", self.state)
        self.ended = content.get("ended", False)

    def follow(self, browser) -> None:
        while (frame := browser.frame()) is not None:
            self.show(frame)


def bare(fused: dict, now: float = 0.0) -> Snapshot:
    """A snapshot of a map alone."""
    return Snapshot(now=now, rules=RULES, fused=fused, sessions=(), peers=(), bytes_rate=0.0, traffic=NOTHING)


@pytest.fixture
def feed() -> Feed:
    return Feed(Overview("lab", ["r1", "r2"]))


def test_frames_put_together_are_the_map_and_every_robots_own(watched, straight, feed) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    sessions = [watched.robot("r1"), watched.robot("r2")]
    early, late = Screen(), Screen()
    browser = feed.join()
    for k in range(5):
        watched.sense("r1", straight(20, y_mm=300 * k, first_ms=2000 * k))
        watched.sense("r2", straight(20, y_mm=-300 * k, first_ms=2000 * k))
        feed.take(snapshots.take(watched.now))
        early.follow(browser)
    late.follow(feed.join())
    for screen in (early, late):
        layers = {FUSED: watched.observer.fusion.tiles}
        layers |= {session.hex(): watched.observer.replicas[session].state.cells for session in sessions}
        assert screen.tiles.keys() == layers.keys()
        for layer, tiles in layers.items():
            assert screen.tiles[layer].keys() == tiles.keys()
            assert all((screen.tiles[layer][key] == cells).all() for key, cells in tiles.items())
        assert screen.trails == {s.hex(): watched.tracks.of(s).trail.tolist() for s in sessions}
        assert screen.state["digest"] == watched.observer.fusion.digest().hex()
    cells = sum(int(np.count_nonzero(cells)) for cells in watched.observer.fusion.tiles.values())
    assert early.state["known_m2"] == pytest.approx(cells * 0.0025)
    assert early.hits[sessions[0].hex()] == 500


def test_a_browser_that_takes_nothing_costs_a_set_of_keys_and_gets_the_newest(feed) -> None:
    browser = feed.join()
    keys = [TileKey(0, k) for k in range(30)]
    for value in range(1, 200):
        feed.take(bare({key: np.full((TILE, TILE), value, np.int32) for key in keys}))
    assert browser.lacks == {FUSED: set(keys)}
    screen = Screen()
    screen.show(browser.frame())
    assert all((cells == 199).all() for cells in screen.tiles[FUSED].values())
    assert browser.frame() is None


def test_a_large_map_comes_coarse_in_one_frame_and_then_whole_and_nothing_twice(feed) -> None:
    tiles = {TileKey(k, k): np.full((TILE, TILE), k + 1, np.int32) for k in range(3 * FRAME_TILES)}
    feed.take(bare(tiles))
    browser, screen, frames = feed.join(), Screen(), 0
    while (frame := browser.frame()) is not None:
        assert len(frame) < FRAME_TILES * 2100 + 2000
        screen.show(frame)
        frames += 1
        assert {key: int(cells[0, 0]) for key, cells in screen.coarse.items()} == {key: key.ty + 1 for key in tiles}
    assert frames == 1 + 3
    assert len(screen.tiles[FUSED]) == 3 * FRAME_TILES


def test_of_four_cells_the_most_occupied_is_seen_from_afar_or_else_the_most_free() -> None:
    cells = np.zeros((2, 4, 4), np.int16)
    cells[0, :2, :2] = [[-5, -9], [1, 0]]
    cells[0, :2, 2:] = [[-5, -9], [0, -1]]
    cells[1, 2:, :2] = [[7, 3], [-800, 0]]
    assert pooled(cells, 0) is cells
    assert pooled(cells, 1).tolist() == [[[1, -9], [0, 0]], [[0, 0], [7, 0]]]
    assert pooled(cells, 2).tolist() == [[[1]], [[7]]]


def track(poses: int, hits: int, *, stride_mm: int = 20) -> Track:
    """A track along x; of the hits only the newest three are there."""
    trail = np.column_stack([np.arange(poses) * stride_mm, np.zeros((poses, 2), int)]).astype(np.int32)
    points = np.column_stack([np.arange(hits)[-3:], np.zeros(min(hits, 3), int)]).astype(np.int32)
    return Track(trail, stride_mm, trail[-1] if poses else None, points, hits)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9), st.sampled_from([20, 40])), min_size=1, max_size=8))
def test_a_track_is_that_of_its_time_wherever_one_jumps(times) -> None:
    descriptor = Descriptor("r1", b"r1r1r1r1", RULES, orion(), QuantisedPose(0, 0, 0))
    standing = Contribution(descriptor, n=1, summed=True, live=False, duplicate=False, reason="")
    feed = Feed(Overview("lab", []))
    browser, screen = feed.join(), Screen()
    for poses, hits, stride_mm in times:
        there = track(poses, hits, stride_mm=stride_mm)
        view = SessionView(standing, 1, None, {}, there, 0.0, None, None)
        feed.take(Snapshot(now=0.0, rules=RULES, fused={}, sessions=(view,), peers=(), bytes_rate=0.0, traffic=NOTHING))
        screen.follow(browser)
        assert screen.trails.get(descriptor.session.hex(), []) == there.trail.tolist()
        assert screen.hits.get(descriptor.session.hex(), 0) == hits


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=8))
def test_evidence_beyond_16_bits_is_cut_and_keeps_its_sign(values) -> None:
    feed = Feed(Overview("lab", []))
    cells = np.zeros((TILE, TILE), np.int32)
    cells[0, : len(values)] = values
    feed.take(bare({TileKey(-1, 2): cells}))
    screen = Screen()
    screen.follow(feed.join())
    assert screen.tiles[FUSED][TileKey(-1, 2)][0, : len(values)].tolist() == np.clip(values, -32768, 32767).tolist()


def test_a_tile_that_is_gone_is_sent_as_unknown(feed) -> None:
    key = TileKey(0, 0)
    feed.take(bare({key: np.ones((TILE, TILE), np.int32)}))
    browser, screen = feed.join(), Screen()
    screen.follow(browser)
    feed.take(bare({}))
    screen.follow(browser)
    assert not screen.tiles[FUSED][key].any()


def test_it_is_told_who_saw_a_cell_and_when(watched, straight, feed) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    watched.robot("r1")
    watched.robot("r2")
    watched.sense("r1", straight(3))
    feed.take(snapshots.take(watched.now))
    watched.now += 30
    watched.sense("r2", straight(2))
    feed.take(snapshots.take(watched.now))
    found = feed.cell(0, 0)
    assert [each["robot"] for each in found["witnesses"]] == ["r1", "r2"]
    assert found["evidence"] == sum(each["evidence"] for each in found["witnesses"])
    assert found["evidence"] == watched.observer.fusion.tiles[TileKey(0, 0)][0, 0]
    assert found["witnesses"][0]["seconds"] > 30 > found["witnesses"][1]["seconds"]
    assert feed.cell(-1000, 5000)["witnesses"] == []


def test_of_a_session_that_is_replaced_nothing_is_remembered(watched, straight, feed) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    session = watched.robot("r1")
    watched.sense("r1", straight(5))
    feed.take(snapshots.take(watched.now))
    assert feed._seen[session.hex()]
    again = Descriptor("r1", b"again-r1", watched.RULES, orion(), QuantisedPose(0, 0, 0), session)
    watched._robots["r1"].open_session(again)
    watched.sense("r1", straight(5))
    feed.take(snapshots.take(watched.now))
    assert not feed._seen[session.hex()]
    assert [each["session"] for each in feed.cell(0, 0)["witnesses"]] == [again.session.hex()]


def test_an_evicted_robot_leaves_the_map_and_keeps_its_layer(watched, straight, feed) -> None:
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard)
    session = watched.robot("r1")
    watched.sense("r1", straight(5))
    feed.take(snapshots.take(watched.now))
    browser, screen = feed.join(), Screen()
    screen.follow(browser)
    watched.observer.evict(session, watched.now)
    feed.take(snapshots.take(watched.now))
    screen.follow(browser)
    assert not any(cells.any() for cells in screen.tiles[FUSED].values())
    assert any(cells.any() for cells in screen.tiles[session.hex()].values())
    (told,) = screen.state["sessions"]
    assert (told["summed"], told["evicted"], told["reason"]) == (False, True, "evicted by observer")


def test_a_robot_without_a_start_pose_says_so(watched, straight, feed) -> None:
    watched.robot("r9", start=None)
    watched.sense("r9", straight(5))
    feed.take(Snapshots(watched.observer, watched.tracks, watched.heard).take(watched.now))
    (told,) = feed.state["sessions"]
    assert (told["start"], told["sensed_from"], told["reason"]) == (None, None, "no start pose")
    watched.observer.set_start_pose("r9", QuantisedPose(1, 2, 3), watched.now)
    feed.take(Snapshots(watched.observer, watched.tracks, watched.heard).take(watched.now))
    assert feed.state["sessions"][0]["start"] == [1, 2, 3]


def test_the_history_thins_out_and_is_sent_once(feed) -> None:
    browser, screen = feed.join(), Screen()
    for k in range(3 * MOST_HISTORY):
        feed.take(bare({}, now=0.5 * k))
        screen.follow(browser)
    assert len(feed.history) <= MOST_HISTORY
    times = [row[0] for row in screen.history]
    assert times == sorted(set(times))
    assert times[-1] > 0.9 * 1.5 * MOST_HISTORY


def test_the_last_frame_says_that_the_swarm_has_ended(feed) -> None:
    browser, screen = feed.join(), Screen()
    feed.take(bare({}))
    screen.follow(browser)
    assert not screen.ended
    feed.end(bare({TileKey(0, 0): np.ones((TILE, TILE), np.int32)}))
    screen.show(browser.frame())
    assert screen.ended
    assert screen.state["ended"]
    assert (screen.tiles[FUSED][TileKey(0, 0)] == 1).all()
