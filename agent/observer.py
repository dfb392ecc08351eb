"""``orion observe``: a peer without a body that holds the same map and writes it out."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.config import Config
from agent.control import Control
from agent.errors import UserError
from agent.files import prepare_folder
from agent.keeper import open_keeper
from agent.links import open_bus
from agent.map_files import save_map
from agent.node import SOFTWARE, Node
from agent.outputs import Outputs
from agent.page import NoPage, Page
from agent.published import published_scans
from agent.scan_record import ScanRecord, save_scans
from mapping.grid import Grid
from mapping.map_picture import Trail, robot_colour
from swarm.contributions import contributions
from swarm.messages import Hello, Update
from swarm.peer import Peer
from swarm.radio import PROFILES
from swarm.session import Descriptor, SessionId


class Outlet(Protocol):
    """Where what the observer knows goes: a log, ROS 2.

    Attributes:
        status: what is wrong with it, in words; empty if nothing is.
    """

    status: str

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an update that the peer has applied."""
        ...

    def watch(self, peer: Peer) -> Callable[[float], None]:
        """What that peer's loop is to do in every turn."""
        ...

    def close(self) -> dict[str, Any]:
        """Bring it to its end; gives what is to be told of it."""
        ...


def open_outlets(outputs: Outputs, config: Config) -> list[Outlet]:
    """Those that were asked for: only then their packages are needed.

    Raises:
        UserError: the log is there already or cannot be made, or the router's endpoint is none.
    """
    outlets: list[Outlet] = []
    if outputs.record is not None:
        from agent.recorder import Recorder

        outlets.append(Recorder(outputs.record, config.toml().decode()))
    if outputs.ros2 is not None:
        from agent.ros2 import Ros2

        outlets.append(Ros2(outputs.ros2))
    return outlets


class Trails:
    """Where the robots went, as far as their updates tell: poses in the common frame."""

    def __init__(self) -> None:
        self._poses: dict[SessionId, list[NDArray[np.float64]]] = {}

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        scans = published_scans(descriptor, update)
        if scans is not None:
            self._poses.setdefault(update.session, []).append(scans.poses[:, :2] / 1000)

    def points(self, session: SessionId) -> NDArray[np.float64]:
        """One session's trail in metres, shape (N, 2)."""
        return np.concatenate([np.zeros((0, 2)), *self._poses.get(session, [])])


def run_observer(
    config: Config, out: Path | None, outputs: Outputs, control: Control, name: str | None = None
) -> dict[str, Any]:
    """Follow the swarm until told to stop, then write the map; gives the summary.

    Args:
        config: the swarm.
        out: a prepared folder for the map's files, or None for none.
        outputs: what else it makes of it.
        control: who says when.
        name: of its table in the configuration; None for one that has none, whom nobody finds.

    Raises:
        UserError: there are no robots, or no such observer, an endpoint cannot be used, a file cannot be written, or
            the state is another process's.
    """
    if not config.robots:
        raise UserError(
            "robots", "none in the configuration, so there is nobody to observe", "give the swarm's TOML: -c"
        )
    if name is not None and name not in config.observers:
        known = ", ".join(config.observers) or "none"
        what = f"no observer is called {name!r}; known: {known}"
        raise UserError("--name", what, f"add a table [observers.{name}] to the file")
    for file in (outputs.scans, outputs.record):
        if file is not None:
            prepare_folder(file.absolute().parent)
    called = name or "observer"
    trails, kept = Trails(), ScanRecord()
    outlets: list[Outlet] = []
    live = NoPage() if outputs.page is None else Page(config, outputs.page)

    def listen(descriptor: Descriptor, update: Update) -> None:
        trails(descriptor, update)
        live(descriptor, update)
        for outlet in outlets:
            outlet(descriptor, update)
        if outputs.scans is not None:
            kept(descriptor, update)

    with live, open_keeper(config, called, outputs.state) as keeper, open_bus(config, called) as bus:
        outlets += open_outlets(outputs, config)  # last, for a log is there from then on
        hello = Hello(Hello.OBSERVER, called.encode(), SOFTWARE)
        profile = PROFILES[config.radio]
        node = Node(bus, config.rules(), hello, now=time.monotonic(), profile=profile, listener=listen, keeper=keeper)
        control.tell("ready", name="the observer")
        if live.url:
            control.tell("page", url=live.url)
        show = live.watch(node.peer, node.heard_bytes, node.lost)
        watches = [(outlet, outlet.watch(node.peer)) for outlet in outlets]
        said: set[str] = set()

        def watch(now: float) -> None:
            show(now)
            for outlet, turn in watches:
                turn(now)
                if outlet.status and outlet.status not in said:
                    said.add(outlet.status)
                    control.tell("trouble", what=outlet.status)

        node.run(control, watch)
        told = {key: value for outlet in outlets for key, value in outlet.close().items()}  # whatever goes wrong below
        grid = Grid.of(node.peer.fusion.tiles, config.rules().lattice)
        # before the bus is left: a mute peer may hold that up for seconds
        files = {} if out is None else write_maps(node.peer, grid, trails, config.roster, out)
        if outputs.scans is not None:
            save_scans(outputs.scans, kept.sessions())
        live.end()
        facts = {"tiles": len(node.peer.fusion.tiles), "known_m2": round(grid.known_m2, 6)}
        return {**facts, **node.summary(), **told, "files": files}


def write_maps(peer: Peer, grid: Grid, trails: Trails, roster: list[str], out: Path) -> dict[str, Any]:
    """Write the fused map with the trails of the robots in it, and every robot's own map beside it.

    Returns:
        Paths by kind, those of the robots' own maps under ``robots``.
    """
    sessions = sorted(
        peer.replicas.values(), key=lambda replica: (replica.descriptor.robot, replica.descriptor.session)
    )
    summed = {each.descriptor.session for each in contributions(peer, time.monotonic()) if each.summed}
    drawn = []
    robots: dict[str, str] = {}
    for replica in sessions:
        robot, session = replica.descriptor.robot, replica.descriptor.session
        colour = robot_colour(roster.index(robot) if robot in roster else len(roster))
        if session in summed:
            drawn.append(Trail(robot, colour, trails.points(session)))
        stem = f"map-{robot}" if robot not in robots else f"map-{robot}-{session.hex()}"
        own = Grid.of(replica.state.cells, peer.rules.lattice)
        robots[stem.removeprefix("map-")] = str(save_map(out, stem, own)["npz"])
    files: dict[str, Any] = {kind: str(path) for kind, path in save_map(out, "map", grid, drawn).items()}
    return files | {"robots": robots}
