"""From quantised scans to rays between cells: where each beam starts and ends on the lattice (eq. 1 to 4).

Law kept here: integers only. A coordinate is held in Q14 millimetres (the cosine table's scale) and never rounded: the
cell is its floor division by the cell size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from mapping.cosine import Q, direction
from mapping.lattice import Lattice
from mapping.pose import FULL_TURN
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor

# What a ray says of its last cell.
FREE = 0  # free, like all before it: nothing was seen up to there
HIT = 1  # occupied: something was seen there
SILENT = 2  # nothing: something was seen somewhere at this distance, perhaps not here


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """R rays on the lattice, in the order of the scans' valid readings.

    Attributes:
        start: int32, shape (R, 2): cell (i, j) where the beam starts. Best column by column in memory, as all i are
            worked on together, and all j.
        end: int32, shape (R, 2): cell (i, j) of the reading, or where the sensor's range ends.
        ending: shape (R,): ``FREE``, ``HIT`` or ``SILENT``. Booleans will do where none is silent: whether it hit.
    """

    start: NDArray[np.int32]
    end: NDArray[np.int32]
    ending: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.ending)

    def __getitem__(self, rows: slice) -> Self:
        return type(self)(self.start[rows], self.end[rows], self.ending[rows])

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Whether something was seen at the end, shape (R,)."""
        return np.asarray(self.ending == HIT)

    @property
    def steps(self) -> NDArray[np.int32]:
        """The number of steps n of each ray, int32 (R,): its cells are k = 0 ... n."""
        across, along = np.abs(self.end - self.start).T
        return np.asarray(np.maximum(across, along))

    @property
    def visits(self) -> NDArray[np.int32]:
        """How many of its cells each ray says something of, int32 (R,): the n + 1, or n if its end is silent."""
        return np.asarray(self.steps + (self.ending != SILENT))


class Fan(NamedTuple):
    """A sensor's beams as F thin rays in the robot's frame; whole numbers, shape (F,) each.

    Attributes:
        beam: whose reading the ray has.
        x_mm: where it starts.
        y_mm: where it starts.
        bearing_turn16: where it looks; not wrapped.
        ending: what a reading says at its end: ``HIT`` in the beam's inner half, ``SILENT`` in its outer half.
        turns: the robot's own two axes, then the bearings: shape (2 + F,).
        table: all but the turns as the rows of one array, shape (5, F).
        rays: the same, ray by ray.
    """

    beam: NDArray[np.int64]
    x_mm: NDArray[np.int64]
    y_mm: NDArray[np.int64]
    bearing_turn16: NDArray[np.int64]
    ending: NDArray[np.uint8]
    turns: NDArray[np.int64]
    table: NDArray[np.int64]
    rays: tuple[tuple[int, int, int, int, int], ...]


def spread(half_width_turn16: int, max_range_mm: int, cell_mm: int) -> tuple[int, int]:
    """How a wide beam is cut into thin rays at bearing + k * step, k = -m ... m.

    Two rays that are ``step`` apart are 2 pi * step / 65536 * range apart at their ends, along the arc. With
    2 pi < 710 / 113 the largest step that keeps this below one cell at the maximum range is, in whole numbers,
    65536 * 113 * cell / (710 * range), rounded down (at least 2, as a range has at most 4,095 cells). Rays are then
    spread evenly: m = half-width / largest step, rounded up, and step = half-width / m, rounded down.

    Returns:
        m and step; (0, 0) for a thin beam.
    """
    if half_width_turn16 == 0:
        return 0, 0
    largest = FULL_TURN * 113 * cell_mm // (710 * max_range_mm)
    m = -(-half_width_turn16 // largest)
    return m, half_width_turn16 // m


@lru_cache(maxsize=64)
def fan(sensor: Sensor, lattice: Lattice) -> Fan:
    """The thin rays that a sensor's beams are made of: one a thin beam, 2 m + 1 a wide one (``spread``).

    All rays of a beam have its origin and its reading's length. Had there been something nearer, it would have been
    read, so each frees its cells before its end; but which of the ends returned the echo nobody knows. It is taken for
    likelier near the axis (as by Moravec and Elfes, 1985): the rays of the inner half, 2 |k| <= m, say what a thin
    beam's says; those of the outer half say nothing of their ends. If the middle ray alone marked its end, walls would
    be lost to all the rays beside it that end a little too far; if all did, gaps would close between their corners.
    Where nothing is in range, all of them free everything up to it.
    """
    rows = []
    for number, (x_mm, y_mm, bearing, half_width) in enumerate(sensor.beams):
        m, step = spread(half_width, sensor.max_range_mm, lattice.cell_mm)
        rows += [(number, x_mm, y_mm, bearing + k * step, HIT if 2 * abs(k) <= m else SILENT) for k in range(-m, m + 1)]
    table = np.array(rows, np.int64).T.copy()
    table.setflags(write=False)
    beam, x_mm, y_mm, bearing, ending = table
    turns = np.concatenate([[0, FULL_TURN // 4], bearing])
    return Fan(beam, x_mm, y_mm, bearing, ending.astype(np.uint8), turns, table, tuple(rows))


def check_beams(scans: Scans, sensor: Sensor) -> None:
    """Refuse scans of another sensor.

    Raises:
        ValueError: they have more or fewer beams.
    """
    if scans.beams != len(sensor.beams):
        raise ValueError(f"rays: {scans.beams} readings a scan cannot be broadcast to {len(sensor.beams)} beams")


def rays_of(scans: Scans, sensor: Sensor, lattice: Lattice) -> Rays:
    """The rays of every reading that says something; an invalid reading gives none, "no return" free ones.

    Raises:
        ValueError: the scans are another sensor's.
    """
    check_beams(scans, sensor)
    beams = fan(sensor, lattice)
    ranges = scans.ranges.take(beams.beam, axis=1)
    returned = ranges != NO_RETURN
    reach = np.where(returned, ranges, sensor.max_range_mm)
    ending = np.where(returned, beams.ending, FREE)

    turned = direction(scans.poses[:, 2:] + beams.turns)  # the robot's axes, then the rays
    points = np.empty((2, 2, *reach.shape))  # starts and ends; x and y; scans; rays
    start, end = points
    start[...] = (scans.poses.T[:2] * float(1 << Q))[:, :, None]
    start += beams.x_mm * turned[:, :, :1]
    start += beams.y_mm * turned[:, :, 1:2]
    np.multiply(reach, turned[:, :, 2:], out=end)
    end += start

    # Doubles hold these whole numbers exactly, and round no quotient up to the next: one that is not whole is farther
    # away from it than they err, and half a unit more keeps those that are whole from falling short.
    points += 0.5
    points *= 1.0 / (lattice.cell_mm << Q)
    cells = np.floor(points, out=points).astype(np.int32).reshape(2, 2, -1)
    ending = ending.ravel()
    says = (ranges != INVALID).ravel()
    if not says.all():
        cells, ending = np.compress(says, cells, axis=2), ending[says]  # an index would turn the columns around
    return Rays(cells[0].T, cells[1].T, ending)
