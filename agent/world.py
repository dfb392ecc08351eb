"""A world to simulate in: walls, what moves among them, where robots start, and the waypoints that they visit.

Laws kept here: everything is in the common frame; a world comes from a YAML file that is checked in whole when it is
loaded, and what is wrong with it is said in one line with its remedy.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from itertools import pairwise
from math import radians
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from agent.errors import UserError
from agent.geometry import distances_to_walls, meet_walls
from agent.obstacle import Obstacle, Shape
from agent.occupied_cells import NO_CELLS, OccupiedCells
from agent.packaged_worlds import FOLDER, world_names
from mapping.evidence import occupied
from mapping.pose import Pose

_EXAMPLE = "compare it with agent/worlds/paper.yaml"


_BATCH = 1 << 18
"""Pairs of ray and wall that are looked at in one go: some megabytes."""

NEAR = 0.5
"""Metres up to which the distance to a picture's cells is told."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Walls and the robots' errands among them.

    Attributes:
        name: as the user gave it, for messages.
        walls: shape (M, 4), x0, y0, x1, y1 of each straight piece, metres.
        starts: one true start pose a robot.
        waypoints: for each start the points to visit in order, shape (W, 2), metres; none: the robot finds its own way.
        obstacles: what moves besides the robots.
        cells: a picture's walls, besides the straight ones.
    """

    name: str
    walls: NDArray[np.float64]
    starts: tuple[Pose, ...]
    waypoints: tuple[NDArray[np.float64], ...]
    obstacles: tuple[Obstacle, ...] = ()
    cells: OccupiedCells = NO_CELLS

    def cast(
        self, origins: NDArray[np.float64], bearings: NDArray[np.float64], reach: float = np.inf
    ) -> NDArray[np.float64]:
        """How far each ray goes until it meets a wall; exact, and without a gap where two walls share a corner.

        Args:
            origins: shape (K, 2), metres.
            bearings: shape (K,), radians counter-clockwise from the x axis.
            reach: metres up to which walls matter; a picture's beyond it may be left out, to save time.

        Returns:
            Shape (K,), metres; infinity where no wall is ahead.
        """
        nearest = self.cells.cast(origins, bearings, reach)
        step = max(1, _BATCH // max(1, len(self.walls)))
        for k in range(0, len(nearest) if len(self.walls) else 0, step):
            rays = slice(k, k + step)
            met = meet_walls(origins[rays], bearings[rays], self.walls).min(axis=1)
            np.minimum(nearest[rays], met, out=nearest[rays])
        return nearest

    def clearance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """From each point, shape (N, 2), to the nearest wall, metres; with a picture at most ``NEAR``."""
        nearest = self.cells.distances(points, NEAR)
        if len(self.walls):
            np.minimum(nearest, distances_to_walls(points, self.walls).min(axis=1), out=nearest)
        return nearest


def _chain(corners: list[float]) -> list[float]:
    """Checks that numbers are the corners of a wall."""
    if len(corners) < 4 or len(corners) % 2:
        raise ValueError(f"expected x, y of two corners or more, got {len(corners)} numbers")
    points = list(zip(corners[::2], corners[1::2], strict=True))
    for corner, following in pairwise(points):
        if corner == following:
            raise ValueError(f"corner {corner} is given twice in a row")
    return corners


_Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Metres = Annotated[_Finite, Field(ge=-1000, le=1000)]
_STRICT = ConfigDict(extra="forbid", frozen=True)


class _Start(BaseModel):
    """One robot's start and errand, as the file has it."""

    model_config = _STRICT
    x: _Metres
    y: _Metres
    yaw_deg: _Finite
    waypoints: list[tuple[_Metres, _Metres]] | None = Field(None, min_length=1)


class _Obstacle(BaseModel):
    """Something that moves, as the file has it."""

    model_config = _STRICT
    shape: Shape
    radius: Annotated[_Finite, Field(gt=0, le=10)]
    speed: Annotated[_Finite, Field(ge=0, le=10)]
    waypoints: list[tuple[_Metres, _Metres]] = Field(min_length=1)
    loop: bool = Field(False, strict=True)


class _File(BaseModel):
    """The whole file."""

    model_config = _STRICT
    walls: list[Annotated[list[_Metres], AfterValidator(_chain)]] | None = Field(None, min_length=1)
    image: str | None = Field(None, min_length=1)
    starts: list[_Start] = Field(min_length=1)
    obstacles: list[_Obstacle] = []


def load_world(where: str | Path) -> World:
    """The world of that name, or else in the YAML file of that path.

    The file holds ``walls``, each a list of corners ``[x, y, x, y, ...]``, or an ``image``, the YAML of a map_server
    map beside it whose occupied cells are walls, or both; and ``starts``, each with ``x``, ``y``, ``yaw_deg`` and, if
    the robot has an errand, ``waypoints`` ``[[x, y], ...]``. It may hold ``obstacles``, each with ``shape`` (disc or
    box), ``radius`` (or half a side), ``speed``, ``waypoints`` and ``loop``.

    Raises:
        UserError: there is no such world, its file or image is wrong, or a wall stands between waypoints.
    """
    content = _parse(where, _read(where))
    try:
        checked = _File.model_validate(content)
    except ValidationError as error:
        raise _complaint(where, error) from error
    if checked.walls is None and checked.image is None:
        raise UserError(f"{where}: walls", "is missing", "add it, or an image")
    chains = checked.walls or []
    walls = [[*a, *b] for chain in chains for a, b in pairwise(zip(chain[::2], chain[1::2], strict=True))]
    world = World(
        name=str(where),
        walls=np.array(walls, dtype=np.float64).reshape(-1, 4),
        starts=tuple(Pose(start.x, start.y, radians(start.yaw_deg)) for start in checked.starts),
        waypoints=tuple(_points(start.waypoints or []) for start in checked.starts),
        obstacles=tuple(
            Obstacle(it.shape, it.radius, it.speed, _points(it.waypoints), it.loop) for it in checked.obstacles
        ),
        cells=NO_CELLS if checked.image is None else _cells(Path(where).parent / checked.image),
    )
    _check_errands(world)
    return world


def _check_errands(world: World) -> None:
    """Robots drive straight from waypoint to waypoint.

    Raises:
        UserError: there is a wall in between.
    """
    for k, (start, waypoints) in enumerate(zip(world.starts, world.waypoints, strict=True)):
        legs = np.diff(np.vstack([(start.x, start.y), waypoints]), axis=0)
        lengths = np.hypot(*legs.T)
        room = world.cast(waypoints - legs, np.arctan2(legs[:, 1], legs[:, 0]), float(lengths.max(initial=0.0)))
        for leg in np.flatnonzero(room < lengths).tolist():
            place = f"{world.name}: starts[{k}].waypoints[{leg}]"
            raise UserError(place, "a wall stands on the straight way to it", "move it, or add one that leads round")


def _points(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    """Shape (N, 2)."""
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def _cells(image: Path) -> OccupiedCells:
    """The occupied cells of a map file."""
    from agent.map_files import load_map  # brings the pictures' library, which few worlds need

    grid = load_map(image)
    return OccupiedCells(occupied(grid.evidence), grid.origin, grid.lattice.cell)


def _read(where: str | Path) -> bytes:
    """The bytes of a packaged world or of a file."""
    if where in world_names():
        return (FOLDER / f"{where}.yaml").read_bytes()
    path = Path(where)
    if path.suffix not in {".yaml", ".yml"} and not path.exists():
        raise UserError(f"world {where}", "there is none of that name", f"use {_listed(world_names())}, or a YAML file")
    try:
        return path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UserError(where, reason, f"name a YAML file, or a world: {_listed(world_names())}") from error


def _parse(where: str | Path, data: bytes) -> dict[Any, Any]:
    """The mapping that the YAML holds, its values not yet looked at."""
    try:
        content = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: dates that are none, broken UTF-8
        mark = getattr(error, "problem_mark", None)
        place = f"{where}:{mark.line + 1}" if mark else where
        raise UserError(place, "this is not YAML", _EXAMPLE) from error
    if not isinstance(content, dict):
        raise UserError(where, "expected a mapping", "give it the keys walls and starts")
    return content


def _complaint(where: str | Path, error: ValidationError) -> UserError:
    """The first thing wrong, as a line for the user."""
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")  # a misspelt key also leaves one missing
    *parents, last = first["loc"]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
    place = f"{where}: {key.lstrip('.')}"
    if first["type"] == "extra_forbidden":
        tables: dict[str | int, type[BaseModel]] = {"starts": _Start, "obstacles": _Obstacle}
        known = list(tables.get(parents[0], _File).model_fields if parents else _File.model_fields)
        near = difflib.get_close_matches(str(last), known, n=1, cutoff=0)
        return UserError(place, "unknown key", f"did you mean {near[0]}? Known are {_listed(known)}")
    if first["type"] == "missing":
        return UserError(place, "is missing", "add it")
    what = first["msg"].removeprefix("Value error, ").replace(" after validation", "")
    if isinstance(first["input"], str | float | int):
        what += f", got {str(first['input'])[:40]!r}"
    return UserError(place, what[0].lower() + what[1:], _EXAMPLE)


def _listed(names: list[str]) -> str:
    return ", ".join(names)
