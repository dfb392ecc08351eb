"""The live page of an observer: a web server in a thread beside the loop that owns the state.

Laws kept here: the loop hands over values and takes orders, and never waits for a browser; the server's packages are
imported in its own thread, so that the swarm does not wait for them either.
"""

from __future__ import annotations

import math
import secrets
import threading
import time
import webbrowser
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Self

from agent.config import Config
from agent.page_mailbox import Mailbox
from agent.page_options import PageOptions, is_loopback
from agent.page_orders import Orders
from agent.page_snapshot import Snapshots
from agent.page_tracks import Tracks
from swarm.messages import Update
from swarm.peer import Peer
from swarm.radio import PROFILES
from swarm.session import Descriptor

if TYPE_CHECKING:
    import uvicorn

_PERIOD = 0.1
"""Seconds between two snapshots."""

_LAST_FRAMES = 3.0
"""Seconds that browsers have to take the last of it."""

_BROWSER_STARTS = 10.0
"""Seconds that a browser which we started has to show up."""


class NoPage:
    """Nobody looks."""

    url = ""

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Nothing to draw."""

    def watch(self, peer: Peer, heard_bytes: Mapping[str, int]) -> Callable[[float], None]:
        """Nothing to do in a turn of the loop."""
        return lambda now: None

    def end(self) -> None:
        """There is nothing to end."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        pass


class Page:
    """A page that is served while its ``with`` statement lasts; told of every update that is applied.

    Args:
        config: the swarm.
        options: where, and whether to start a browser.

    Attributes:
        url: its address, with the token if there is one.

    Raises:
        UserError: the address cannot be listened on.
    """

    def __init__(self, config: Config, options: PageOptions) -> None:
        self._config = config
        self._open = options.open
        self._socket = options.listen()
        self._token = None if is_loopback(options.host) else secrets.token_urlsafe(18)
        host, port = self._socket.getsockname()[:2]
        query = "" if self._token is None else f"?token={self._token}"
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}/{query}"
        self._tracks = Tracks()
        self._orders = Orders()
        self._mailbox = Mailbox()
        self._snapshots: Snapshots | None = None
        self._server: uvicorn.Server | None = None
        self._thread = threading.Thread(target=self._serve, name="orion-page", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._server is not None:
            self._server.should_exit = True
        self._thread.join(_LAST_FRAMES)

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        self._tracks(descriptor, update)

    def watch(self, peer: Peer, heard_bytes: Mapping[str, int]) -> Callable[[float], None]:
        """What that peer's loop is to do in every turn: carry out orders, and now and then hand over a snapshot."""
        snapshots = self._snapshots = Snapshots(peer, self._tracks, heard_bytes)
        due = -math.inf

        def turn(now: float) -> None:
            nonlocal due
            self._orders.carry_out(peer, now)
            if now >= due:
                due = now + _PERIOD
                self._mailbox.newest = snapshots.take(now)

        return turn

    def end(self) -> None:
        """Show everybody who looks the last state; the swarm has ended."""
        if self._snapshots is None:
            return
        self._mailbox.last = self._snapshots.take(time.monotonic())
        if self._open:
            self._mailbox.visited.wait(_BROWSER_STARTS)
        self._mailbox.seen_off.wait(_LAST_FRAMES)

    def _serve(self) -> None:
        import uvicorn

        from agent.page_feed import Feed
        from agent.page_server import build_app

        profile = PROFILES[self._config.radio]
        budget = profile.rate if profile.repeats else None  # of a channel that all share
        feed = Feed(self._config.swarm, self._config.roster, budget)
        app = build_app(feed, self._mailbox, self._orders, token=self._token)
        self._server = uvicorn.Server(
            uvicorn.Config(
                app,
                ws="websockets-sansio",
                ws_per_message_deflate=False,  # it costs four to twenty times the time of a frame
                ws_max_size=1024,  # browsers have nothing to say there
                log_config=None,
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )
        if self._open:
            webbrowser.open(self.url)
        self._server.run(sockets=[self._socket])
