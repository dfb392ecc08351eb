"""``orion observe``: a peer without a body that holds the same map and writes it out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.config import Config
from agent.control import Control
from agent.errors import UserError
from agent.files import prepare_folder
from agent.links import open_bus
from agent.map_files import save_map
from agent.node import SOFTWARE, Node
from agent.scan_record import ScanRecord, save_scans
from mapping.grid import Grid
from mapping.map_picture import Trail, robot_colour
from swarm.messages import Hello, Update
from swarm.peer import Peer
from swarm.scan_block import decode_scans
from swarm.session import Descriptor, SessionId


class Trails:
    """Where the robots went, as far as their updates tell: poses in the common frame."""

    def __init__(self) -> None:
        self._poses: dict[SessionId, list[NDArray[np.float64]]] = {}

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        if update.form == Update.SCANS:
            sensor = descriptor.sensor
            scans = decode_scans(update.payload, len(sensor.beams), sensor.max_range_mm)
        elif update.trail:
            scans = decode_scans(update.trail, 0, 0)
        else:
            return
        self._poses.setdefault(update.session, []).append(scans.poses[:, :2] / 1000)

    def points(self, session: SessionId) -> NDArray[np.float64]:
        """One session's trail in metres, shape (N, 2)."""
        return np.concatenate([np.zeros((0, 2)), *self._poses.get(session, [])])


def run_observer(config: Config, out: Path | None, control: Control, scans: Path | None = None) -> dict[str, Any]:
    """Follow the swarm until told to stop, then write the map; gives the summary.

    Args:
        config: the swarm.
        out: a prepared folder for the map's files, or None for none.
        control: who says when.
        scans: an npz for the scans that came by (``agent.scan_record``), or None.

    Raises:
        UserError: there are no robots, an endpoint cannot be used, or a file cannot be written.
    """
    if not config.robots:
        raise UserError(
            "robots", "none in the configuration, so there is nobody to observe", "give the swarm's TOML: -c"
        )
    if scans is not None:
        prepare_folder(scans.absolute().parent)
    trails, record = Trails(), ScanRecord()

    def listen(descriptor: Descriptor, update: Update) -> None:
        trails(descriptor, update)
        if scans is not None:
            record(descriptor, update)

    with open_bus(config, "observer", None) as bus:
        node = Node(bus, config.rules(), Hello(Hello.OBSERVER, b"observer", SOFTWARE), listener=listen)
        control.tell("ready", name="the observer")
        node.run(control)
        grid = Grid.of(node.peer.fusion.tiles, config.rules().lattice)
        # before the bus is left: a mute peer may hold that up for seconds
        files = {} if out is None else write_maps(node.peer, grid, trails, config.roster, out)
        if scans is not None:
            save_scans(scans, record.sessions())
        facts = {"tiles": len(node.peer.fusion.tiles), "known_m2": round(grid.known_m2, 6)}
        return {**facts, **node.summary(), "files": files}


def write_maps(peer: Peer, grid: Grid, trails: Trails, roster: list[str], out: Path) -> dict[str, Any]:
    """Write the fused map with the robots' trails, and every robot's own contribution beside it.

    Returns:
        Paths by kind, those of the robots' own maps under ``robots``.
    """
    sessions = sorted(
        peer.replicas.values(), key=lambda replica: (replica.descriptor.robot, replica.descriptor.session)
    )
    drawn = []
    robots: dict[str, str] = {}
    for replica in sessions:
        robot, session = replica.descriptor.robot, replica.descriptor.session
        colour = robot_colour(roster.index(robot) if robot in roster else len(roster))
        drawn.append(Trail(robot, colour, trails.points(session)))
        stem = f"map-{robot}" if robot not in robots else f"map-{robot}-{session.hex()}"
        own = Grid.of(replica.state.cells, peer.rules.lattice)
        robots[stem.removeprefix("map-")] = str(save_map(out, stem, own)["npz"])
    files: dict[str, Any] = {kind: str(path) for kind, path in save_map(out, "map", grid, drawn).items()}
    return files | {"robots": robots}
