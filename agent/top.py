"""``orion top``: an observer without a page that shows the swarm in a terminal, or tells once how it stands.

Laws kept here: the loop hands over snapshots and never waits for the terminal, which a thread of its own draws on.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from agent.config import Config
from agent.control import Control
from agent.errors import UserError
from agent.links import open_bus
from agent.node import SOFTWARE, Node
from agent.operate import MEETING, NobodyError
from agent.overview import Overview, budget
from agent.page_snapshot import Snapshot, Snapshots
from agent.page_tracks import Tracks
from mapping.grid import Grid
from swarm.messages import REFUSED, Hello
from swarm.peer import Peer
from swarm.radio import PROFILES
from swarm.session import SessionId

if TYPE_CHECKING:
    from rich.console import Console

_PERIOD = 0.5
"""Seconds between two pictures."""

_CATCHING_UP = 10.0
"""Seconds in which all should be here that anybody holds. After them it is told how the swarm stands even so."""

_RATES = 1.0
"""Seconds over which rates are taken once it is."""

_TURN = 0.1
"""Seconds between two looks whether all is here."""


def show(config: Config, control: Control, console: Console) -> None:
    """Show the swarm on a terminal until told to stop.

    Raises:
        UserError: there are no robots, or an endpoint cannot be used.
    """
    with _joined(config) as swarm, Terminal(swarm, console, control) as terminal:
        swarm.node.run(control, terminal)


def look(config: Config, control: Control) -> dict[str, Any]:
    """How the swarm stands when all is here that anybody holds, or when that has lasted too long.

    Returns:
        An overview (``agent.overview``), and under ``caught_up`` whether all is here.

    Raises:
        NobodyError: there is nobody.
        UserError: as ``show``.
    """
    with _joined(config) as swarm:
        glance = Glance(swarm, control, time.monotonic())
        swarm.node.run(control, glance)
        if not swarm.node.peer.peers:
            raise NobodyError
        return glance.state(time.monotonic())


class Swarm(NamedTuple):
    """What we are in it, and what is made of that.

    Attributes:
        node: the observer.
        tracks: where robots went, by the updates that it applied.
        overview: tells how the swarm stands.
    """

    node: Node
    tracks: Tracks
    overview: Overview

    def snapshots(self) -> Snapshots:
        """Snapshots whose rates begin now."""
        return Snapshots(self.node.peer, self.tracks, self.node.heard_bytes, self.node.lost)


@contextlib.contextmanager
def _joined(config: Config) -> Iterator[Swarm]:
    if not config.robots:
        raise UserError("robots", "none in the configuration, so there is nobody to see", "give the swarm's TOML: -c")
    tracks = Tracks()
    with open_bus(config, "top") as bus:
        node = Node(
            bus,
            config.rules(),
            Hello(Hello.OBSERVER, b"top", SOFTWARE),
            now=time.monotonic(),
            profile=PROFILES[config.radio],
            listener=tracks,
        )
        yield Swarm(node, tracks, Overview(config.swarm, config.roster, budget(config.radio)))


class Glance:
    """Waits until all is here, and then a moment for the rates; to be called in every turn of the loop.

    Args:
        swarm: what is looked at.
        control: told to stop when it has been.
        now: seconds.
    """

    def __init__(self, swarm: Swarm, control: Control, now: float) -> None:
        self._swarm = swarm
        self._control = control
        self._deadline = now + _CATCHING_UP
        self._nobody_at = now + MEETING
        self._due = now
        self._wanted: dict[SessionId, int] | None = None
        self._caught_up = False
        self._snapshots: Snapshots | None = None
        self._until = math.inf

    def __call__(self, now: float) -> None:
        """Look again."""
        if now < self._due:
            return
        self._due = now + _TURN
        peer = self._swarm.node.peer
        if self._wanted is None:
            self._wanted = held_by_others(peer)
        self._caught_up = self._wanted is not None and holds(peer, self._wanted)
        if self._snapshots is None and (self._caught_up or now >= self._deadline):
            self._snapshots, self._until = self._swarm.snapshots(), now + _RATES
        if self._snapshots is not None:
            self._snapshots.take(now)
        nobody = not peer.peers and now >= self._nobody_at
        self._control.stop = self._control.stop or nobody or now >= self._until

    def state(self, now: float) -> dict[str, Any]:
        """What there was to see."""
        snapshot = (self._snapshots or self._swarm.snapshots()).take(now)
        return {**self._swarm.overview.of(snapshot, exact=True), "caught_up": self._caught_up}


def held_by_others(peer: Peer) -> dict[SessionId, int] | None:
    """The latest update of each session that anybody who is there holds; None until all of them have told."""
    told = [peer.told.get(name) for name in peer.peers]
    held: dict[SessionId, int] = {}
    for digest in told:
        if digest is None:
            return None
        for session, n in digest.positions().items():
            held[session] = max(held.get(session, 0), 0 if n == REFUSED else n)
    return held if told else None


def holds(peer: Peer, wanted: dict[SessionId, int]) -> bool:
    """Whether a peer has all of that, as far as it follows it, and the others' decisions."""
    return all(digest.controls == peer.controls.check for digest in peer.told.values()) and all(
        session in peer.descriptors and (session not in peer.replicas or peer.replicas[session].state.n >= n)
        for session, n in wanted.items()
    )


class Terminal:
    """Draws while its ``with`` statement lasts; to be called in every turn of the loop.

    Args:
        swarm: what is drawn.
        console: the terminal.
        control: told to stop when that has gone.
    """

    def __init__(self, swarm: Swarm, console: Console, control: Control) -> None:
        self._snapshots = swarm.snapshots()
        self._overview = swarm.overview
        self._console = console
        self._control = control
        self._due = -math.inf
        self._newest: Snapshot | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._draw, name="orion-top", daemon=True)

    def __call__(self, now: float) -> None:
        """Hand over a snapshot, if it is time."""
        if now >= self._due:
            self._due = now + _PERIOD
            self._newest = self._snapshots.take(now)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._over.set()
        self._thread.join()

    def _draw(self) -> None:
        from rich.live import Live

        from agent.top_view import screen

        try:
            with Live(console=self._console, screen=True, auto_refresh=False) as live:
                while not self._over.wait(_PERIOD if self._newest is not None else _TURN):
                    if (snapshot := self._newest) is None:
                        continue
                    state, size = self._overview.of(snapshot), self._console.size
                    grid = Grid.of(snapshot.fused, snapshot.rules.lattice)
                    colours = self._console.color_system is not None and not self._console.no_color
                    live.update(screen(state, grid, size.width, size.height, colours=colours), refresh=True)
        except OSError:  # the terminal has gone
            pass
        finally:
            self._control.stop = True
