"""A world to simulate in: thin walls, where robots start, and the waypoints that each of them visits.

Laws kept here: everything is in the common frame; a world comes from a YAML file that is checked in whole when it is
loaded, and what is wrong with it is said in one line with its remedy.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from math import radians
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from agent.errors import UserError
from mapping.pose import Pose

_PACKAGED = resources.files("agent") / "worlds"
_EXAMPLE = "compare it with agent/worlds/paper.yaml, which has every key"


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Walls and the robots' errands among them.

    Attributes:
        name: as the user gave it, for messages.
        walls: shape (M, 4), x0, y0, x1, y1 of each straight piece, metres.
        starts: one true start pose a robot.
        waypoints: for each start the points to visit in order, shape (W, 2), metres.
    """

    name: str
    walls: NDArray[np.float64]
    starts: tuple[Pose, ...]
    waypoints: tuple[NDArray[np.float64], ...]

    def cast(self, origins: NDArray[np.float64], bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far each ray goes until it meets a wall; exact, and without a gap where two walls share a corner.

        A wall is met where its ends lie on either side of the ray's line. A shared corner is on one and the same side
        for both of its walls, so no ray slips through between them.

        Args:
            origins: shape (K, 2), metres.
            bearings: shape (K,), radians counter-clockwise from the x axis.

        Returns:
            Shape (K,), metres; infinity where no wall is ahead.
        """
        dx, dy = np.cos(bearings), np.sin(bearings)
        nearest = np.full(len(bearings), np.inf)
        for x0, y0, x1, y1 in self.walls:  # wall by wall, so that memory grows with the rays alone
            ahead0, aside0 = _along(x0 - origins[:, 0], y0 - origins[:, 1], dx, dy)
            ahead1, aside1 = _along(x1 - origins[:, 0], y1 - origins[:, 1], dx, dy)
            apart = aside0 != aside1  # otherwise the wall is parallel, and at best its nearer end is met
            share = np.divide(aside0, aside0 - aside1, out=np.zeros_like(aside0), where=apart)
            distance = np.where(apart, ahead0 + share * (ahead1 - ahead0), np.minimum(ahead0, ahead1))
            met = (np.minimum(aside0, aside1) <= 0) & (np.maximum(aside0, aside1) >= 0) & (distance >= 0)
            np.minimum(nearest, distance, out=nearest, where=met)
        return nearest


def _along(
    x: NDArray[np.float64], y: NDArray[np.float64], dx: NDArray[np.float64], dy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offsets (x, y) measured along the unit direction (dx, dy) and to its left."""
    return x * dx + y * dy, y * dx - x * dy


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
    waypoints: list[tuple[_Metres, _Metres]] = Field(min_length=1)


class _File(BaseModel):
    """The whole file."""

    model_config = _STRICT
    walls: list[Annotated[list[_Metres], AfterValidator(_chain)]] = Field(min_length=1)
    starts: list[_Start] = Field(min_length=1)


def world_names() -> list[str]:
    """The worlds that come with Orion."""
    return sorted(entry.name.removesuffix(".yaml") for entry in _PACKAGED.iterdir() if entry.name.endswith(".yaml"))


def load_world(where: str | Path) -> World:
    """The world of that name, or else in the YAML file of that path.

    The file holds ``walls``, each a list of corners ``[x, y, x, y, ...]``, and ``starts``, each with ``x``, ``y``,
    ``yaw_deg`` and ``waypoints`` ``[[x, y], ...]``.

    Raises:
        UserError: there is no such world, or its file is wrong.
    """
    content = _parse(where, _read(where))
    try:
        checked = _File.model_validate(content)
    except ValidationError as error:
        raise _complaint(where, error) from error
    walls = [[*a, *b] for chain in checked.walls for a, b in pairwise(zip(chain[::2], chain[1::2], strict=True))]
    return World(
        name=str(where),
        walls=np.array(walls, dtype=np.float64),
        starts=tuple(Pose(start.x, start.y, radians(start.yaw_deg)) for start in checked.starts),
        waypoints=tuple(np.array(start.waypoints, dtype=np.float64) for start in checked.starts),
    )


def _read(where: str | Path) -> bytes:
    """The bytes of a packaged world or of a file."""
    if where in world_names():
        return (_PACKAGED / f"{where}.yaml").read_bytes()
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
        known = list(_Start.model_fields if parents else _File.model_fields)
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
