"""Maps as ROS navigation reads them: a PGM picture and a YAML beside it, by the rules of nav2's ``map_server``.

The rules (docs.nav2.org, "Map Server / Saver"; wiki.ros.org/map_server; nav2's ``map_io.cpp``): row 0 of the picture is
north; a pixel x is as occupied as ``p = (max - x) / max``, or ``x / max`` with ``negate``; then

* ``trinary``: occupied if p > occupied_thresh, free if p < free_thresh, else unknown;
* ``scale``: the same, but what lies between is a percentage, 0 at free_thresh and 100 at occupied_thresh;
* ``raw``: the pixel is the percentage, above 100 is unknown; ``negate`` and the thresholds say nothing.

What we write is trinary. A cell is occupied if its probability exceeds 0.65, free if it is below 0.196, and unknown
otherwise: a cell that was seen, but not often enough to be sure of, is unknown to a navigator. (With the default
evidence a cell is free after four rays through it, and occupied after one hit.) These are the very thresholds in the
YAML, so that a map means the same before and after. 0.196 and not the 0.25 of nav2's own saver: the pixel for
unknown, 205, is p = 0.19608, which 0.25 would turn into free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from mapping.evidence import OCCUPIED_PROBABILITY, UNITS_PER_NAT, occupied
from mapping.grid import Grid
from mapping.map_archive import checked_lattice, corner_cell
from mapping.portable_graymap import decode_pgm, encode_pgm
from mapping.tiles import frozen

FREE_PROBABILITY = 0.196
"""A cell is called free when its probability is below this."""

MAX_DESCRIPTION = 1 << 16
"""Bytes of YAML that are looked at; a map's has seven lines."""

PIXEL_OCCUPIED, PIXEL_UNKNOWN, PIXEL_FREE = 0, 205, 254

Mode = Literal["trinary", "scale", "raw"]
_MODES = ("trinary", "scale", "raw")


@dataclass(frozen=True, slots=True)
class MapDescription:
    """What the YAML says.

    Attributes:
        image: the picture's file name, relative to the YAML's folder.
        resolution: metres a pixel.
        origin: x, y (metres) of the picture's lower-left corner, and its yaw (radians).
        negate: whether bright means occupied.
        occupied_thresh: probability above which a pixel is occupied.
        free_thresh: probability below which it is free.
        mode: how pixels between the thresholds are read.
    """

    image: str
    resolution: float
    origin: tuple[float, float, float]
    negate: bool = False
    occupied_thresh: float = OCCUPIED_PROBABILITY
    free_thresh: float = FREE_PROBABILITY
    mode: Mode = "trinary"


def free(evidence: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Where the probability is below 0.196: a plain threshold on the integer (-142 units)."""
    odds = math.log(FREE_PROBABILITY / (1 - FREE_PROBABILITY))
    return np.asarray(evidence < odds * UNITS_PER_NAT)


def encode_map_server(grid: Grid, image: str) -> tuple[bytes, bytes]:
    """The picture (PGM) and its YAML; an empty map is one unknown cell, because a picture has at least one pixel.

    Args:
        grid: the map.
        image: the file name that the YAML gives for the picture.
    """
    evidence = grid.evidence if grid.evidence.size else np.zeros((1, 1), np.int32)
    pixels = np.full(evidence.shape, PIXEL_UNKNOWN, np.uint8)
    pixels[free(evidence)] = PIXEL_FREE
    pixels[occupied(evidence)] = PIXEL_OCCUPIED
    description = {
        "image": image,
        "mode": "trinary",
        "resolution": grid.lattice.cell,
        "origin": [*grid.origin, 0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_PROBABILITY,
        "free_thresh": FREE_PROBABILITY,
    }
    text: str = yaml.safe_dump(description, sort_keys=False, default_flow_style=None, allow_unicode=True)
    return encode_pgm(pixels[::-1]), text.encode()


def decode_description(data: bytes) -> MapDescription:
    """What a map's YAML says.

    Raises:
        ValueError: not YAML, a key is missing or has a value that nav2 would refuse, or the origin is rotated.
    """
    if len(data) > MAX_DESCRIPTION:
        raise ValueError(f"not a map's YAML: {len(data)} bytes, expected at most {MAX_DESCRIPTION}")
    try:
        # The base loader makes nothing but text, lists and dictionaries, and so has no constructors to trip over.
        table = yaml.load(data, yaml.BaseLoader)  # noqa: S506
    # The last three: escapes for characters that there are not, and nesting without end.
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(table, dict):
        raise ValueError("not a map's YAML: expected keys and values")
    image = table.get("image")
    if not isinstance(image, str) or not image or "\0" in image:
        raise ValueError(f"image: expected a file name, got {image!r}")
    origin = table.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise ValueError(f"origin: expected [x, y, yaw], got {origin!r}")
    x, y, yaw = (_number(value, "origin") for value in origin)
    if yaw != 0:
        raise ValueError(f"origin: its yaw is {yaw}, expected 0 (no map is ever rotated)")
    resolution = _number(table.get("resolution"), "resolution")
    occupied_thresh = _number(table.get("occupied_thresh"), "occupied_thresh")
    free_thresh = _number(table.get("free_thresh"), "free_thresh")
    if not 0 <= free_thresh < occupied_thresh <= 1:
        raise ValueError(
            f"free_thresh, occupied_thresh: {free_thresh} and {occupied_thresh}, expected 0 <= free < occupied <= 1"
        )
    negate = str(table.get("negate")).lower()
    if negate not in {"0", "1", "false", "true"}:
        raise ValueError(f"negate: expected 0 or 1, got {table.get('negate')!r}")
    mode = table.get("mode", "trinary")
    if mode not in _MODES:
        raise ValueError(f"mode: expected {', '.join(_MODES)}, got {mode!r}")
    return MapDescription(
        image, resolution, (x, y, yaw), negate in {"1", "true"}, occupied_thresh, free_thresh, cast("Mode", mode)
    )


def decode_map_server(description: MapDescription, picture: bytes) -> Grid:
    """The map that nav2 would read, whole picture included.

    Occupied is +460 units of evidence (p = 0.99, the surest percentage but 100), free -460, unknown 0; a percentage
    between is its log-odds.

    Raises:
        ValueError: the picture is no PGM, the resolution no whole number of millimetres, or the origin no corner of a
            cell.
    """
    pixels, maximum = decode_pgm(picture)
    lattice = checked_lattice(description.resolution, "resolution")
    i0, j0 = corner_cell(description.origin[0], description.origin[1], lattice, pixels.shape)
    # 8-bit pixels have at most 256 meanings: decide each once.
    meaning = _meanings(description, maximum)
    return Grid(frozen(np.ascontiguousarray(meaning[pixels[::-1]])), i0, j0, lattice)


def _meanings(description: MapDescription, maximum: int) -> NDArray[np.int32]:
    """Evidence of each pixel value, shape (maximum + 1,)."""
    value = np.arange(maximum + 1)
    share = (value if description.negate else maximum - value) / maximum
    low, high = description.free_thresh, description.occupied_thresh
    if description.mode == "raw":
        percent = np.floor(value / maximum * 255 + 0.5)
        percent[percent > 100] = 50
    elif description.mode == "scale":
        percent = np.rint((share - low) / (high - low) * 100).clip(0, 100)
    else:
        percent = np.full(maximum + 1, 50.0)
    if description.mode != "raw":
        percent[share > high] = 100
        percent[share < low] = 0
    odds = percent.clip(1, 99) / (100 - percent.clip(1, 99))
    return np.asarray(np.rint(np.log(odds) * UNITS_PER_NAT), dtype=np.int32)


def _number(value: object, name: str) -> float:
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{name}: expected a finite number, got {value!r}")
    return number
