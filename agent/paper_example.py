"""Figure 3: the paper's world of 6 x 6 cells over three steps, by its pipeline and by our kernel.

Readings are given as cells: the directions that the figure draws are not those of one rigid robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.paper import Cell, LogOdds, occupancy_grid_mapping
from agent.paper import probability as p
from mapping.evidence import EvidenceModel, probability
from mapping.lattice import Cells, TileKey
from mapping.raster import raster_rays
from mapping.rays import Rays
from mapping.tiles import added

SIDE = 6
"""Rows and columns."""


@dataclass(frozen=True, slots=True)
class Step:
    """What happens at one time.

    Attributes:
        robot: the index of its cell.
        readings: by the index of the cell that they fall on, the sensor's name, empty where the paper names none.
    """

    robot: int
    readings: dict[int, str]


STEPS = (
    Step(36, {10: "RIGHT", 19: ""}),  # a moving obstacle at m_10
    Step(35, {4: "RIGHT", 19: "RIGHT DIAGONAL"}),  # it is gone
    Step(34, {4: "RIGHT", 13: "RIGHT DIAGONAL", 31: "FRONT"}),
)

Frame = dict[int, float]
"""p(m_i = occupied) by the index i = 1 ... 36."""


def cell_of(index: int) -> Cell:
    """m_index, counted row by row from the north-west, as column and row from the south-west."""
    row, column = divmod(index - 1, SIDE)
    return column, SIDE - 1 - row


def frames_by_the_paper() -> list[Frame]:
    """The grid at t = 0 ... 3 by algorithms 1 and 2."""
    log_odds: LogOdds = {}
    frames = [_frame(log_odds)]
    for step in STEPS:
        for reading in step.readings:
            log_odds = occupancy_grid_mapping(log_odds, cell_of(step.robot), cell_of(reading))
        frames.append(_frame(log_odds))
    return frames


def _frame(log_odds: LogOdds) -> Frame:
    return {index: p(log_odds.get(cell_of(index), 0.0)) for index in range(1, SIDE**2 + 1)}


def frames_by_us() -> list[Frame]:
    """The grid at t = 0 ... 3 by our kernel and evidence model."""
    tiles: dict[TileKey, Cells] = {}
    frames = [_frame({})]
    for step in STEPS:
        ends = np.array([cell_of(reading) for reading in step.readings], np.int32)
        starts = np.tile(np.array(cell_of(step.robot), np.int32), (len(ends), 1))
        tiles |= added(tiles, raster_rays(Rays(starts, ends, np.ones(len(ends), np.uint8)), EvidenceModel()))
        seen = probability(tiles[TileKey(0, 0)])
        frames.append({index: float(seen[cell_of(index)[::-1]]) for index in range(1, SIDE**2 + 1)})
    return frames
