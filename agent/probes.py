"""What a service manager and Prometheus ask a robot's process, which has no page: see ``agent.probe_routes``.

Laws kept here: the loop hands over a snapshot a second and is never asked for anything; the server's packages are
imported in its own thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Self

from agent.config import Config
from agent.page_mailbox import Mailbox
from agent.page_options import listen
from agent.page_snapshot import Lost, Snapshots
from agent.page_tracks import Tracks
from agent.web_server import WebServer
from swarm.peer import Peer

if TYPE_CHECKING:
    from starlette.types import ASGIApp

_PERIOD = 1.0
"""Seconds between two snapshots."""


class NoProbes:
    """Nobody asks."""

    url = ""

    def watch(self, peer: Peer, heard_bytes: Mapping[str, int], lost: Lost) -> Callable[[float], None]:
        """Nothing to do in a turn of the loop."""
        return lambda now: None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        pass


NO_PROBES = NoProbes()


class Probes:
    """The two for a process that has no page, served while its ``with`` statement lasts.

    Args:
        config: the swarm.
        host: where to listen; an address that is not this machine's alone wants a token, which is made and told.
        port: 0 is any that is free.

    Attributes:
        url: their address, with the token if there is one.

    Raises:
        UserError: the address cannot be listened on.
    """

    def __init__(self, config: Config, host: str, port: int) -> None:
        self._config = config
        self._mailbox = Mailbox()
        listener = listen(host, [port], "--metrics-port", "give another one, or another --metrics-host")
        self._server = WebServer(listener, host, self._app)
        self.url = self._server.url

    def __enter__(self) -> Self:
        self._server.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._server.stop()

    def watch(self, peer: Peer, heard_bytes: Mapping[str, int], lost: Lost) -> Callable[[float], None]:
        """What that peer's loop is to do in every turn: now and then hand over a snapshot."""
        snapshots = Snapshots(peer, Tracks(), heard_bytes, lost)
        due = -math.inf

        def turn(now: float) -> None:
            nonlocal due
            if now >= due:
                due = now + _PERIOD
                self._mailbox.newest = snapshots.take(now)

        return turn

    def _app(self, token: str | None) -> ASGIApp:
        from starlette.applications import Starlette

        from agent.overview import Overview, budget
        from agent.page_guard import Guard
        from agent.probe_routes import probe_routes

        overview = Overview(self._config.swarm, self._config.roster, budget(self._config.radio))

        def state() -> dict[str, Any]:
            newest = self._mailbox.newest
            return {} if newest is None else overview.of(newest)

        return Guard(Starlette(routes=probe_routes(self._mailbox, state)), token)
