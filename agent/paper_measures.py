"""What a run's maps are worth: the paper's pipeline and ours on the same published scans, against the true walls.

Law kept here: both pipelines see the same readings; what differs is how cells come of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from agent.geometry import distances_to_walls
from agent.paper import L_FREE, L_OCC, LogOdds, Matrix, grid_cell, mapped, point_cloud, theta_of
from agent.paper import probability as p
from agent.paper_experiments import CELL, Run
from agent.scan_record import Recorded
from mapping.evidence import UNITS_PER_NAT, EvidenceModel, probability, to_units
from mapping.grid import Grid
from mapping.integrate import integrated
from mapping.lattice import TILE, Cells, Lattice, TileKey
from mapping.pose import from_turn16
from mapping.rays import rays_of
from mapping.scan import INVALID, NO_RETURN
from mapping.score import score
from mapping.tiles import frozen

TOLERANCE = 0.04
"""Metres: how far from a wall an occupied cell may lie, and the other way round."""

OBSTACLE_FROM_WALLS = 0.10
"""Metres from every wall beyond which a reading is on something else: ten deviations of a reading at 0.8 m."""

Pose = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Worth:
    """One pipeline on one run; metres, shares and square metres."""

    wall_error_mean: float
    wall_error_p95: float
    recall: float
    precision: float
    known_m2: float


@dataclass(frozen=True, slots=True, eq=False)
class Fading:
    """The cells that readings on a moving obstacle fell on.

    Attributes:
        seconds: of each scan since the first, shape (N,).
        probabilities: after each scan, shape (N, K).
        first: of each of the K cells, the scan with its first reading.
    """

    seconds: NDArray[np.float64]
    probabilities: NDArray[np.float64]
    first: NDArray[np.int64]

    @property
    def at_first(self) -> NDArray[np.float64]:
        """Of each cell the probability after its first reading, shape (K,)."""
        return np.asarray(self.probabilities[self.first, np.arange(len(self.first))])

    @property
    def at_most(self) -> NDArray[np.float64]:
        """The highest, shape (K,)."""
        return np.asarray(self.probabilities.max(axis=0))

    @property
    def at_end(self) -> NDArray[np.float64]:
        """The last, shape (K,)."""
        return np.asarray(self.probabilities[-1])


# --- the paper's pipeline


def scans_by_the_paper(recorded: Recorded) -> Iterator[tuple[Pose, Matrix]]:
    """Each scan's pose (theta is the paper's) and point cloud (eq. 3); readings that returned nothing have no point."""
    d_RS = recorded.sensor.beams[0].x_mm / 1000
    phi = [from_turn16(beam.bearing_turn16) + math.pi / 2 for beam in recorded.sensor.beams]
    for (x, y, yaw), ranges in zip(recorded.scans.poses.tolist(), recorded.scans.ranges.tolist(), strict=True):
        pose = (x / 1000, y / 1000, theta_of(from_turn16(yaw)))
        read = [(rho / 1000, angle) for rho, angle in zip(ranges, phi, strict=True) if rho not in {INVALID, NO_RETURN}]
        yield pose, point_cloud(pose, [rho for rho, _ in read], d_RS, [angle for _, angle in read])


def cloud_by_the_paper(recorded: Recorded) -> Matrix:
    """All points of one robot in the common frame, shape (P, 2), metres."""
    return np.concatenate([np.zeros((0, 2)), *(cloud for _, cloud in scans_by_the_paper(recorded))])


def grid_by_the_paper(run: Run) -> Grid:
    """The map of all robots' scans by the paper's algorithms."""
    log_odds: LogOdds = {}
    for pose, cloud in chain.from_iterable(map(scans_by_the_paper, run.sessions)):
        mapped(log_odds, pose, cloud, CELL)
    return _as_grid(log_odds)


def _as_grid(log_odds: LogOdds) -> Grid:
    """Float log-odds as our evidence; exact, as both count in hundredths."""
    tiles: dict[TileKey, Cells] = {}
    for (i, j), value in log_odds.items():
        tile = tiles.setdefault(TileKey(j // TILE, i // TILE), np.zeros((TILE, TILE), np.int32))
        tile[j % TILE, i % TILE] = round(value * UNITS_PER_NAT)
    return Grid.of({key: frozen(cells) for key, cells in tiles.items()}, Lattice.of(CELL))


# --- ours


def cloud_by_us(recorded: Recorded) -> Matrix:
    """The points where our rays end on something, shape (P, 2), metres: on a lattice of 1 mm."""
    rays = rays_of(recorded.scans, recorded.sensor, Lattice(1))
    return np.asarray((rays.end[rays.hit] + 0.5) / 1000)


# --- how good they are


def worth(run: Run, cloud_of: Callable[[Recorded], Matrix], grid: Grid) -> Worth:
    """How far a pipeline's points and cells are from the true walls."""
    points = np.concatenate([cloud_of(recorded) for recorded in run.sessions])
    errors = distances_to_walls(points, run.walls).min(axis=1)
    grade = score(grid, run.walls, TOLERANCE)
    return Worth(
        wall_error_mean=float(errors.mean()),
        wall_error_p95=float(np.percentile(errors, 95)),
        recall=grade.recall or 0.0,
        precision=grade.precision or 0.0,
        known_m2=grid.known_m2,
    )


def pose_errors(run: Run) -> NDArray[np.float64]:
    """How far each scan's pose is from the robot's true place, metres; scan k is of sample k, in lock-step."""
    return np.concatenate(
        [
            np.hypot(*(recorded.scans.poses[:, :2] / 1000 - run.truth[: len(recorded.scans), k, :2]).T)
            for k, recorded in enumerate(run.sessions)
        ]
    )


def fading_by_the_paper(run: Run) -> Fading:
    """How the moving obstacle of a run with one robot fades by the paper's algorithms."""
    log_odds: LogOdds = {}

    def take(k: int, pose: Pose, cloud: Matrix) -> None:
        mapped(log_odds, pose, cloud, CELL)

    return _fading(run, take, lambda i, j: p(log_odds.get((i, j), 0.0)))


def fading_by_us(run: Run) -> Fading:
    """How the moving obstacle of a run with one robot fades by our kernel."""
    (recorded,) = run.sessions
    model, lattice = EvidenceModel(to_units(L_OCC), to_units(L_FREE)), Lattice.of(CELL)
    tiles: dict[TileKey, Cells] = {}
    unknown = np.zeros((TILE, TILE), np.int32)

    def take(k: int, pose: Pose, cloud: Matrix) -> None:
        tiles.update(integrated(tiles, recorded.scans[k : k + 1], recorded.sensor, model, lattice))

    def at(i: int, j: int) -> float:
        tile = tiles.get(TileKey(j // TILE, i // TILE), unknown)
        return float(probability(tile[j % TILE, i % TILE]))

    return _fading(run, take, at)


def _fading(run: Run, take: Callable[[int, Pose, Matrix], None], at: Callable[[int, int], float]) -> Fading:
    (recorded,) = run.sessions
    scans = list(scans_by_the_paper(recorded))
    first: dict[tuple[int, int], int] = {}
    for k, (_, cloud) in enumerate(scans):
        far = distances_to_walls(cloud, run.walls).min(axis=1) > OBSTACLE_FROM_WALLS
        for point in cloud[far].tolist():
            first.setdefault(grid_cell(point, CELL), k)
    history = []
    for k, (pose, cloud) in enumerate(scans):
        take(k, pose, cloud)
        history.append([at(i, j) for i, j in first])
    stamps = recorded.scans.stamps_ms
    return Fading((stamps - stamps[0]) / 1000, np.array(history), np.array(list(first.values()), np.int64))
