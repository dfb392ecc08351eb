"""From quantised scans to rays between cells: where each beam starts and ends on the lattice (eq. 1 to 4).

Law kept here: integers only. A coordinate is held in Q14 millimetres (the cosine table's scale) and never rounded: the
cell is its floor division by the cell size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mapping.cosine import Q, cosine, sine
from mapping.lattice import Lattice
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """R rays on the lattice, in the order of the scans' valid readings.

    Attributes:
        start: int64, shape (R, 2): cell (i, j) where the beam starts.
        end: int64, shape (R, 2): cell (i, j) of the reading, or where the sensor's range ends.
        hit: bool, shape (R,): whether something was seen at the end.
    """

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    hit: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.hit)

    def __getitem__(self, rows: slice) -> Self:
        return type(self)(self.start[rows], self.end[rows], self.hit[rows])

    @property
    def steps(self) -> NDArray[np.int64]:
        """The number of steps n of each ray, int64 (R,): it visits the n + 1 cells k = 0 ... n."""
        return np.asarray(np.abs(self.end - self.start).max(axis=1, initial=0), dtype=np.int64)


def rays_of(scans: Scans, sensor: Sensor, lattice: Lattice) -> Rays:
    """The rays of every reading that says something; an invalid reading gives none, "no return" a free one."""
    beams = sensor.table
    x, y, yaw = (column[:, None] for column in scans.poses.astype(np.int64).T)
    ranges = scans.ranges.astype(np.int64)
    hit = ranges != NO_RETURN
    reach = np.where(hit, ranges, sensor.max_range_mm)

    c, s = cosine(yaw), sine(yaw)
    x0 = (x << Q) + beams[:, 0] * c - beams[:, 1] * s
    y0 = (y << Q) + beams[:, 0] * s + beams[:, 1] * c
    x1 = x0 + reach * cosine(yaw + beams[:, 2])
    y1 = y0 + reach * sine(yaw + beams[:, 2])

    scale = lattice.cell_mm << Q
    says = ranges != INVALID
    start = np.stack([x0[says], y0[says]], axis=1) // scale
    end = np.stack([x1[says], y1[says]], axis=1) // scale
    return Rays(start, end, hit[says])
