"""The page as browsers meet it: over sockets, from the thread that serves it."""

from __future__ import annotations

import asyncio
import io
import json
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
import zipfile
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import msgpack
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from agent.config import Config
from agent.overview import Overview
from agent.page import Page
from agent.page_feed import Feed
from agent.page_mailbox import Mailbox
from agent.page_options import PageOptions
from agent.page_orders import Orders
from agent.page_server import _Pages
from agent.page_snapshot import Snapshots
from mapping.lattice import TILE, TileKey
from mapping.map_archive import decode_npz
from mapping.tiles import map_digest

PATIENCE = 20.0


class Loop:
    """The loop of the process that owns the state: it turns in a thread of its own until the test is over.

    What the test does with the peer, it does between two turns.
    """

    def __init__(self, page: Page, watched) -> None:
        self.turn = page.watch(watched.observer, watched.heard)
        self.between_turns = threading.Lock()
        self.over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self.over.wait(0.005):
            with self.between_turns:
                self.turn(time.monotonic())

    def stop(self) -> None:
        self.over.set()
        self._thread.join()


@pytest.fixture
def serve(watched):
    """Serves what the observer knows."""
    pages, loops = [], []

    def start(**options) -> tuple[Page, Loop]:
        page = Page(Config(), PageOptions(port=0, **options))
        watched.listeners.append(page)
        page.__enter__()
        pages.append(page)
        loops.append(Loop(page, watched))
        return page, loops[-1]

    yield start
    for loop in loops:
        loop.stop()
    for page in pages:
        page.__exit__()


def ask(url: str, path: str = "", *, data: object = None, **headers: str) -> tuple[int, bytes]:
    """Status and body of an answer; redirections are followed without cookies."""
    body = data if data is None or isinstance(data, bytes) else json.dumps(data).encode()
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    if body is not None:
        names.setdefault("content-type", "application/json")
    request = urllib.request.Request(url + path, body, names)
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as response:
            return response.status, response.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def live(url: str, **options):
    """The live socket."""
    return connect(url.replace("http:", "ws:") + "live", open_timeout=PATIENCE, max_size=None, **options)


def until(socket, condition) -> dict:
    """Take frames until what they made of the map fulfils the condition; gives it by layer."""
    layers: dict[str, dict] = {}
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        frame = msgpack.unpackb(socket.recv(timeout=PATIENCE))
        for layer, level, keys, cells in frame.get("tiles", []):
            if level:
                continue
            places = np.frombuffer(keys, "<i4").reshape(-1, 2).tolist()
            contents = np.frombuffer(cells, "<i2").astype(np.int32).reshape(-1, TILE, TILE)
            layers.setdefault(layer, {}).update({TileKey(*k): c for k, c in zip(places, contents, strict=True)})
        if condition(frame, layers):
            return layers
    pytest.fail("not so in time")


def shows(digest: bytes):
    """Whether the map is the one with that digest."""
    return lambda frame, layers: map_digest(layers.get("", {})) == digest


def test_it_answers_service_managers_and_prometheus(serve, watched, straight) -> None:
    page, loop = serve()
    with loop.between_turns:
        watched.robot("r1")
        watched.sense("r1", straight(5))
    deadline = time.monotonic() + PATIENCE
    while b"orion_summed_sessions 1.0" not in ask(page.url, "metrics")[1]:
        assert time.monotonic() < deadline
    assert ask(page.url, "healthz")[0] == 200


def test_frames_are_the_map_and_follow_it(serve, watched, straight) -> None:
    page, loop = serve()
    with loop.between_turns:
        watched.robot("r1")
        watched.sense("r1", straight(20))
    with live(page.url) as socket:
        until(socket, shows(watched.observer.fusion.digest()))
        with loop.between_turns:
            watched.sense("r1", straight(20, y_mm=400, first_ms=2000))
        digest = watched.observer.fusion.digest().hex()
        until(socket, lambda frame, layers: frame.get("state", {}).get("digest") == digest)


def test_a_server_without_news_says_that_it_is_there(serve, monkeypatch) -> None:
    monkeypatch.setattr("agent.page_server._SILENCE", 0.05)
    page, _ = serve()
    with live(page.url) as socket:
        until(socket, lambda frame, layers: frame == {})


def test_orders_are_carried_out_by_the_loop_and_shown(serve, watched, straight) -> None:
    page, loop = serve()
    with loop.between_turns:
        session = watched.robot("r1")
        watched.sense("r1", straight(20))
    assert ask(page.url, "api/evict", data={"session": session.hex()}) == (200, b'{"decided":true}')
    assert session in watched.observer.controls.evicted
    assert ask(page.url, "api/readmit", data={"session": session.hex()})[0] == 200
    assert session not in watched.observer.controls.evicted
    place = {"robot": "r1", "x_mm": 10, "y_mm": 20, "yaw_turn16": 30}
    assert ask(page.url, "api/start-pose", data=place)[0] == 200
    assert watched.observer.controls.start_pose("r1").pose == (10, 20, 30)


@pytest.mark.parametrize(
    ("status", "path", "data", "headers"),
    [
        (400, "api/evict", {"session": "0000000000000000"}, {}),
        (400, "api/evict", {"session": "nonsense"}, {}),
        (400, "api/evict", "a word", {}),
        (400, "api/evict", b"[" * 4000, {}),
        (415, "api/evict", {}, {"content_type": "text/plain"}),
        (413, "api/evict", {"session": "0" * 5000}, {}),
        (403, "api/evict", {}, {"origin": "http://evil.example"}),
        (403, "api/evict", {}, {"origin": "http://["}),
        (404, "api/map.gif", None, {}),
        (400, "api/cell?i=1", None, {}),
        (400, "api/cell?i=1&j=99999999999", None, {}),
        (421, "api/state", None, {"host": "evil.example"}),
        (421, "", None, {"host": "127.0.0.1.evil.example:8750"}),
    ],
)
def test_what_is_wrong_is_refused(serve, watched, status, path, data, headers) -> None:
    page, _ = serve()
    assert ask(page.url, path, data=data, **headers)[0] == status
    assert len(watched.observer.controls) == 0


def test_the_socket_is_for_our_own_page_alone(serve) -> None:
    page, _ = serve()
    with pytest.raises(InvalidStatus, match="403"):
        live(page.url, origin="http://evil.example")
    with live(page.url, origin=page.url.rstrip("/")) as socket:
        assert socket.recv(timeout=PATIENCE)


def test_beyond_this_machine_only_with_the_token(serve) -> None:
    page, _ = serve(host="0.0.0.0")
    found = urlsplit(page.url)
    token = found.query.removeprefix("token=")
    assert len(token) >= 24
    url = f"http://127.0.0.1:{found.port}/"
    assert ask(url, "api/state")[0] == 401
    assert ask(url, "api/state", authorization=f"Bearer {token}")[0] == 200
    assert ask(url, "api/state", authorization="Bearer wrong")[0] == 401
    assert ask(url, "api/state?token=wrong")[0] == 401
    assert ask(url, "api/state", cookie=f"orion_page={token}")[0] == 200
    with pytest.raises(InvalidStatus, match="403"):
        live(url)
    with live(url, additional_headers={"cookie": f"orion_page={token}"}) as socket:
        assert socket.recv(timeout=PATIENCE)
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with opener.open(f"{url}?token={token}", timeout=PATIENCE) as response:
        assert "token" not in response.url


def test_the_map_can_be_saved_in_every_form(serve, watched, straight) -> None:
    page, loop = serve()
    with loop.between_turns:
        watched.robot("r1")
        watched.sense("r1", straight(20))
    digest = watched.observer.fusion.digest()
    with live(page.url) as socket:
        until(socket, shows(digest))
    assert decode_npz(ask(page.url, "api/map.npz")[1]).digest() == digest
    assert ask(page.url, "api/map.png")[1].startswith(b"\x89PNG")
    with zipfile.ZipFile(io.BytesIO(ask(page.url, "api/map.zip")[1])) as archive:
        assert sorted(archive.namelist()) == ["map.pgm", "map.yaml"]
        assert b"image: map.pgm" in archive.read("map.yaml")


def test_every_answer_forbids_what_is_not_ours(serve) -> None:
    page, _ = serve()
    with urllib.request.urlopen(page.url, timeout=PATIENCE) as response:
        assert response.headers["content-security-policy"].startswith("default-src 'self';")
        assert b"Orion swarm" in response.read()


def test_a_browser_that_stalls_holds_nobody_up_and_costs_little(serve, watched, straight) -> None:
    page, loop = serve()
    with loop.between_turns:
        session = watched.robot("r1")
        watched.sense("r1", straight(1024, stride_mm=1600))
    host, port = page.url.removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port))) as stalled, live(page.url) as lively:
        lines = ["GET /live HTTP/1.1", f"Host: {host}:{port}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", "", ""]
        stalled.sendall("\r\n".join(lines).encode())
        assert stalled.recv(12) == b"HTTP/1.1 101"
        until(lively, shows(watched.observer.fusion.digest()))
        before, sent = resident(), 0
        for k in range(30):  # in and out of the map, all of it
            with loop.between_turns:
                (watched.observer.readmit if k % 2 else watched.observer.evict)(session, watched.now)
            summed = bool(k % 2)
            layers = until(lively, lambda frame, layers, summed=summed: _stands(frame, layers, watched, summed=summed))
            sent += 2048 * len(layers[""])
        assert sent > 100 << 20
        assert resident() - before < 50 << 20


def _stands(frame: dict, layers: dict, watched, *, summed: bool) -> bool:
    """Whether the map has all of its tiles, with the robot or without."""
    fused = layers.get("", {})
    return len(fused) == len(watched.observer.fusion.tiles) and all(cells.any() == summed for cells in fused.values())


def resident() -> int:
    """Bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def test_at_the_end_everybody_has_the_last_map_and_knows_that_it_is(serve, watched, straight) -> None:
    page, loop = serve()
    with loop.between_turns:
        watched.robot("r1")
        watched.sense("r1", straight(20))
    with live(page.url) as socket:
        socket.recv(timeout=PATIENCE)
        loop.stop()
        watched.sense("r1", straight(20, y_mm=400, first_ms=2000))
        page.end()
        seen: dict = {}
        until(socket, lambda frame, layers: seen.update(frame) or frame.get("ended"))
        assert seen["state"]["digest"] == watched.observer.fusion.digest().hex()
        with pytest.raises(ConnectionClosed, match="1000"):
            socket.recv(timeout=PATIENCE)
    assert ask(page.url, "api/evict", data={"session": "0" * 16})[0] == 409


@pytest.mark.parametrize(("end", "seconds"), [(4.0, 6.0), (3600.0, 0.0)])
def test_a_browser_has_the_first_seconds_to_show_up_and_not_the_last(watched, monkeypatch, end, seconds) -> None:
    now, waits = [0.0], []
    monkeypatch.setattr("agent.page.time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr("webbrowser.open", lambda url: True)
    with Page(Config(), PageOptions(port=0, open=True)) as page:
        page.watch(watched.observer, watched.heard)
        monkeypatch.setattr(page._mailbox.visited, "wait", waits.append)
        now[0] = end
        page.end()
    assert waits == [seconds]


def test_the_end_is_told_to_a_browser_that_was_just_being_sent_something(watched) -> None:
    snapshots, feed, sent = Snapshots(watched.observer, watched.tracks, watched.heard), Feed(Overview("lab", [])), []
    feed.take(snapshots.take(0.0))

    class Slow:
        async def send_bytes(self, frame: bytes) -> None:
            sent.append(msgpack.unpackb(frame))
            if not feed.ended:
                feed.end(snapshots.take(1.0))

        async def close(self, code: int, reason: str) -> None:
            sent.append({"closed": code})

    asyncio.run(_Pages(feed, Mailbox(), Orders())._send(Slow(), feed.join()))
    assert sent[-2]["ended"]
    assert sent[-2]["state"]["ended"]
    assert sent[-1] == {"closed": 1000}


def test_a_robots_agent_imports_nothing_of_the_page() -> None:
    page = "{'starlette', 'uvicorn', 'websockets', 'anyio'}"
    code = f"import sys, agent.robot, agent.cli; print([m for m in sys.modules if m.partition('.')[0] in {page}])"
    found = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
