"""Scans into maps, in batches: the paper's algorithm 1 as a function from a map and scans to new tiles.

What a batch adds is worth the same everywhere and does not depend on the map; only the optional limit looks at what is
there, and then scans are taken one by one.
"""

from __future__ import annotations

from collections import ChainMap

from mapping.evidence import EvidenceModel
from mapping.lattice import Cells, Lattice, TileKey
from mapping.raster import Raster, raster
from mapping.scan import Scans
from mapping.sensor import Sensor
from mapping.tiles import Tiles, added


def integrated(
    tiles: Tiles,
    scans: Scans,
    sensor: Sensor,
    model: EvidenceModel,
    lattice: Lattice,
    kernel: Raster = raster,
) -> dict[TileKey, Cells]:
    """The tiles that the scans touch, with their new contents; ``tiles`` itself is left alone.

    Args:
        tiles: one session's map before.
        scans: any number; with ``model.limit`` their order matters, without it nothing does.
        sensor: whose scans they are.
        model: what readings are worth.
        lattice: the swarm's.
        kernel: ``mapping.raster.raster`` or ``mapping.raster_jit.raster``: the same integers from both.

    Raises:
        ValueError: the scans touch more tiles than one call may.
    """
    if not model.limit:
        return added(tiles, kernel(scans, sensor, lattice, model))
    touched: dict[TileKey, Cells] = {}
    current = ChainMap(touched, tiles)  # type: ignore[arg-type]  # it is only read
    for row in range(len(scans)):
        evidence = kernel(scans[row : row + 1], sensor, lattice, model)
        touched |= added(current, evidence, model.limit)
    return touched
