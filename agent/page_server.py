"""The page's web application: its files, its live socket, the map's files, and a person's orders.

Laws kept here: the feed belongs to this thread's event loop; what is handed over comes through a mailbox of one, in
which only the newest snapshot lies; nothing asks the peer's loop for anything but by an order.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import time
import zipfile
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from agent.page_feed import FUSED, Browser, Feed
from agent.page_guard import Guard
from agent.page_mailbox import Mailbox
from agent.page_orders import Orders, parse
from agent.page_snapshot import Snapshot
from agent.probe_routes import probe_routes
from mapping.grid import Grid
from mapping.map_archive import encode_npz
from mapping.map_picture import Trail, trails_png
from mapping.map_server import encode_map_server

BUNDLE = Path(__file__).with_name("page_bundle")
"""What the build makes of ``web/``: index.html, the script, the styles, the licences of what is in them."""

_PERIOD = 0.1
_LOOK = 0.05
_BREATH = 0.02
"""Seconds from one frame with robots' own tiles to the next: the browser is busy drawing the map."""

_SILENCE = 2.0
"""Seconds without news after which a browser is told that we are there."""

_EMPTY = b"\x80"  # a msgpack map without entries
_PATIENCE = 5.0
_MAX_BODY = 4096

_NO_BUNDLE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Orion swarm</title>
<h1>Orion swarm</h1><p>The server runs, but the page was not built into this installation: that needs npm and the
network, once. In a checkout, with Node 20 or newer:</p>
<pre>cd web &amp;&amp; npm ci --ignore-scripts &amp;&amp; npm run build</pre>
<p>Meanwhile: <a href="api/state">the state</a>, the map as <a href="api/map.png">PNG</a>,
<a href="api/map.zip">PGM and YAML</a>, <a href="api/map.npz">npz</a>.</p></html>"""


def build_app(
    feed: Feed, mailbox: Mailbox, orders: Orders, *, token: str | None = None, bundle: Path = BUNDLE
) -> ASGIApp:
    """The application.

    Args:
        feed: what the browsers are sent.
        mailbox: where snapshots come from.
        orders: where a person's decisions go.
        token: see ``agent.page_guard.Guard``.
        bundle: the built page.
    """
    pages = _Pages(feed, mailbox, orders)
    routes: list[Any] = [
        *probe_routes(mailbox, lambda: feed.state),
        Route("/api/state", pages.state),
        Route("/api/cell", pages.cell),
        Route("/api/map.{kind}", pages.map_file),
        Route("/api/{order}", pages.order, methods=["POST"]),
        WebSocketRoute("/live", pages.live),
    ]
    if (bundle / "index.html").is_file():
        routes.append(Mount("/", StaticFiles(directory=bundle, html=True)))
    else:
        routes.append(Route("/", lambda request: HTMLResponse(_NO_BUNDLE)))
    return Guard(Starlette(routes=routes, lifespan=pages.lifespan), token)


class _Pages:
    def __init__(self, feed: Feed, mailbox: Mailbox, orders: Orders) -> None:
        self._feed = feed
        self._mailbox = mailbox
        self._orders = orders
        self._open = 0

    @contextlib.asynccontextmanager
    async def lifespan(self, app: Starlette) -> AsyncIterator[None]:
        look = asyncio.create_task(self._look())
        yield
        look.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await look

    async def _look(self) -> None:
        """Take what lies in the mailbox."""
        while not self._feed.ended:
            if self._mailbox.last is not None:
                self._feed.end(self._mailbox.last)
            elif (newest := self._mailbox.newest) is not None and newest is not self._feed.snapshot:
                self._feed.take(newest)
            await asyncio.sleep(_LOOK)
        self._see_off()

    def _see_off(self) -> None:
        """Tell the loop, if everybody who is there has had the last of it."""
        if self._feed.ended and not self._open:
            self._mailbox.seen_off.set()

    # --- the live socket

    async def live(self, socket: WebSocket) -> None:
        await socket.accept()
        browser = self._feed.join()
        self._open += 1
        self._mailbox.seen_off.clear()  # after the end, such as a browser that we have just started
        tasks = [asyncio.create_task(self._send(socket, browser)), asyncio.create_task(_until_gone(socket))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                if (error := task.exception()) is not None and not isinstance(error, WebSocketDisconnect | OSError):
                    raise error
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._feed.leave(browser)
            self._open -= 1
            self._see_off()

    async def _send(self, socket: WebSocket, browser: Browser) -> None:
        """A frame every 100 ms; while it lacks tiles as fast as it takes them; in silence an empty one now and then."""
        said_at = 0.0
        while True:
            frame = browser.frame()
            if frame is None and time.monotonic() - said_at > _SILENCE:
                frame = _EMPTY
            if frame is not None:
                await socket.send_bytes(frame)  # waits for a browser that takes nothing
                said_at = time.monotonic()
                self._mailbox.visited.set()
            if browser.done:
                await socket.close(1000, "the observer has ended")
                return
            await asyncio.sleep(0 if FUSED in browser.lacks else _BREATH if browser.lacks else _PERIOD)

    # --- what is known

    async def state(self, request: Request) -> Response:
        return JSONResponse(self._feed.state)

    async def cell(self, request: Request) -> Response:
        try:
            i, j = int(request.query_params["i"]), int(request.query_params["j"])
        except (KeyError, ValueError):
            return _complaint("give i and j, a cell's whole numbers")
        if max(abs(i), abs(j)) >= 1 << 31:
            return _complaint("there is no such cell")
        return JSONResponse(self._feed.cell(i, j))

    def map_file(self, request: Request) -> Response:
        """The map as a file, made in a thread of its own; snapshots are immutable."""
        snapshot, kind = self._feed.snapshot, request.path_params["kind"]
        made = _FILES.get(kind)
        if made is None:
            return PlainTextResponse(f"no such file; there are {', '.join(_FILES)}", 404)
        if snapshot is None:
            return PlainTextResponse("there is no map yet", 503)
        media_type, encode = made
        name = f'attachment; filename="map.{kind}"'
        return Response(encode(snapshot, self._feed), media_type=media_type, headers={"content-disposition": name})

    # --- orders

    async def order(self, request: Request) -> Response:
        if request.headers.get("content-type", "").partition(";")[0] != "application/json":
            return _complaint("expected application/json", 415)  # what a form of another site cannot send
        if int(request.headers.get("content-length", _MAX_BODY + 1)) > _MAX_BODY:
            return _complaint("too long", 413)
        if self._feed.ended:
            return _complaint("the observer has ended", 409)
        try:
            done = self._orders.give(parse(request.path_params["order"], await request.json()))
            await asyncio.wait_for(asyncio.wrap_future(done), _PATIENCE)
        except TimeoutError:
            return _complaint("the peer did not answer in time", 504)
        except (ValueError, RecursionError) as error:  # RecursionError: JSON that is nested too deeply
            return _complaint(str(error))
        return JSONResponse({"decided": True})


async def _until_gone(socket: WebSocket) -> None:
    """Whatever a browser says, it only matters that it is there."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


def _complaint(what: str, status: int = 400) -> Response:
    return JSONResponse({"error": what}, status)


def _grid(snapshot: Snapshot) -> Grid:
    return Grid.of(snapshot.fused, snapshot.rules.lattice)


def _png(snapshot: Snapshot, feed: Feed) -> bytes:
    """The picture that ``--out`` writes too."""
    trails = []
    for view in snapshot.sessions:
        standing = view.contribution
        if standing.summed:
            robot = standing.descriptor.robot
            trails.append(Trail(robot, feed.overview.rgb(robot), view.track.trail[:, :2] / 1000))
    return trails_png(_grid(snapshot), trails)


def _zip(snapshot: Snapshot, feed: Feed) -> bytes:
    """PGM and YAML as map_server reads them."""
    picture, description = encode_map_server(_grid(snapshot), "map.pgm")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("map.pgm", picture)
        archive.writestr("map.yaml", description)
    return buffer.getvalue()


_FILES: dict[str, tuple[str, Callable[[Snapshot, Feed], bytes]]] = {
    "png": ("image/png", _png),
    "zip": ("application/zip", _zip),
    "npz": ("application/octet-stream", lambda snapshot, feed: encode_npz(_grid(snapshot))),
}
