"""The paper's experiments (section IV), each run by real processes that share a simulated world and one map.

Laws kept here: a run is what its folder holds (the resolved configuration, the observer's maps, the scans that the
robots published, the truth); only runs that every process agrees on count.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.config import Config, resolve
from agent.errors import UserError
from agent.files import prepare_folder, read_bytes, write_whole
from agent.fleet import Fleet
from agent.launch import demo_config
from agent.links import check_ports
from agent.map_files import load_map
from agent.outputs import Outputs
from agent.progress import progress
from agent.scan_record import Recorded, load_scans
from mapping.grid import Grid

CELL = 0.02
"""Metres."""

DRIFTING = {"heading_deg": 0.5, "heading_drift_deg": 2.5, "heading_drift_time": 60.0, "slip": 0.01, "slip_walk": 0.01}
"""A badly kept Orion: the heading error that the BNO055's data sheet allows, and wheels that slip five times more."""

ODOMETRY: dict[str, dict[str, Any]] = {
    "ideal": {"ideal": True},
    "default": {},
    "drifting": {"noise": DRIFTING},
}
"""How well the robots know where they are: tables ``[simulation]``."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """One run to do.

    Attributes:
        letter: the paper's: ``SINGLE`` or ``MULTI``.
        world: a packaged world.
        odometry: a key of ``ODOMETRY``.
    """

    letter: str
    world: str
    odometry: str

    @property
    def name(self) -> str:
        """Its folder's name too."""
        return f"{self.letter}-{self.world}-{self.odometry}"


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What came of one.

    Attributes:
        experiment: what was asked for.
        config: what ran.
        grid: the fused map, as the observer has written it.
        sessions: what each robot published, in the roster's order.
        walls: the true ones, shape (M, 4), metres.
        truth: the robots' true poses at every sample, shape (S, N, 3), metres and radians.
        summary: as ``orion demo --json`` prints it.
    """

    experiment: Experiment
    config: Config
    grid: Grid
    sessions: list[Recorded]
    walls: NDArray[np.float64]
    truth: NDArray[np.float64]
    summary: dict[str, Any]


SINGLE = "A"
"""A single robot in a rectangular space (figures 4 to 6)."""

MULTI = "B"
"""Robot 1 in Space 1, Robot 2 in Space 2 (figures 7 to 9)."""

CROSSING = Experiment(SINGLE, "crossing", "default")
"""As the first, and somebody walks through."""

EXPERIMENTS = [
    *(Experiment(SINGLE, "rectangle", odometry) for odometry in ODOMETRY),
    *(Experiment(MULTI, "paper", odometry) for odometry in ODOMETRY),
    CROSSING,
]


def conduct(experiment: Experiment, base: Config, folder: Path, seed: int) -> Run:
    """Run one: every robot, the observer and the world a process of its own.

    Args:
        experiment: which.
        base: ports, the transport and what readings are worth.
        folder: for its files.
        seed: decides the sensors' noise.

    Raises:
        UserError: a process could not do its part, or they do not agree in the end.
    """
    folder = prepare_folder(folder)
    table = base.model_dump(mode="json", exclude_none=True) | {"publish": "scans", "cell": CELL}
    table["simulation"] |= ODOMETRY[experiment.odometry]
    config = demo_config(resolve(table), world=experiment.world, robots=None, speed="max", seed=seed)
    check_ports(config)
    write_whole(folder / "orion.toml", config.toml())
    with Fleet(config, folder, Outputs(scans=folder / "scans.npz")) as fleet:
        fleet.start(simulated=True)
        with progress() as bars:
            settled = fleet.run(bars)
        fleet.finish()
        summary = fleet.summary(settled=settled, seconds=0.0)
    if not summary["converged"]:
        raise UserError(folder, "the robots of this run did not come to one map", "run the command again")
    found = {recorded.robot: recorded for recorded in load_scans(folder / "scans.npz")}
    for robot in summary["robots"]:
        if robot["id"] not in found or len(found[robot["id"]].scans) != robot["scans"]:
            raise UserError(folder, f"the observer has missed scans of {robot['id']}", "run the command again")
    with np.load(io.BytesIO(read_bytes(folder / "truth.npz"))) as truth:
        walls, poses = truth["walls"], truth["poses"]
    sessions = [found[robot] for robot in config.roster]
    return Run(experiment, config, load_map(folder / "map.npz"), sessions, walls, poses, summary)
