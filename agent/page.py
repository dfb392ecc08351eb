"""The live page of an observer: a web server in a thread beside the loop that owns the state.

Laws kept here: the loop hands over values and takes orders, and never waits for a browser; the server's packages are
imported in its own thread, so that the swarm does not wait for them either.
"""

from __future__ import annotations

import math
import time
import webbrowser
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Self

from agent.config import Config
from agent.page_mailbox import Mailbox
from agent.page_options import PageOptions
from agent.page_orders import Orders
from agent.page_snapshot import Lost
from agent.page_source import PeerSource, Source
from agent.page_tracks import Tracks
from agent.web_server import WebServer
from swarm.messages import Update
from swarm.peer import Peer
from swarm.session import Descriptor

if TYPE_CHECKING:
    from starlette.types import ASGIApp

_PERIOD = 0.1
"""Seconds between two snapshots."""

_LAST_FRAMES = 3.0
"""Seconds that browsers have to take the last of it."""

_BROWSER_STARTS = 10.0
"""Seconds from the beginning that a browser which we started has to show up."""


class NoPage:
    """Nobody looks."""

    url = ""

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Nothing to draw."""

    def watch(self, peer: Peer, heard_bytes: Mapping[str, int], lost: Lost = dict) -> Callable[[float], None]:
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
        self._server = WebServer(options.listen(), options.host, self._app)
        self.url = self._server.url
        self._tracks = Tracks()
        self._orders = Orders()
        self._mailbox = Mailbox()
        self._source: Source | None = None
        self._began = 0.0

    def __enter__(self) -> Self:
        self._began = time.monotonic()
        self._server.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._server.stop()

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        self._tracks(descriptor, update)

    def watch(self, peer: Peer, heard_bytes: Mapping[str, int], lost: Lost = dict) -> Callable[[float], None]:
        """Show that peer; gives what its loop is to do in every turn."""
        return self.show(PeerSource(peer, self._tracks, heard_bytes, lost))

    def show(self, source: Source) -> Callable[[float], None]:
        """Show that; gives what its loop is to do in every turn: have orders carried out, and hand over snapshots."""
        self._source = source
        due = -math.inf

        def turn(now: float) -> None:
            nonlocal due
            if self._orders.carry_out(source.obey, now) or now >= due:
                due = now + _PERIOD
                self._mailbox.newest = source.take(now)

        return turn

    def end(self) -> None:
        """Show everybody who looks the last state; there will be no other."""
        if self._source is None:
            return
        self._mailbox.last = self._source.take(time.monotonic())
        if self._open:
            self._mailbox.visited.wait(max(0.0, self._began + _BROWSER_STARTS - time.monotonic()))
        self._mailbox.seen_off.wait(_LAST_FRAMES)

    def _app(self, token: str | None) -> ASGIApp:
        from agent.overview import Overview, budget
        from agent.page_feed import Feed
        from agent.page_server import build_app

        config = self._config
        feed = Feed(Overview(config.swarm, config.roster, budget(config.radio)))
        if self._open:
            webbrowser.open(self.url)
        return build_app(feed, self._mailbox, self._orders, token=token)
