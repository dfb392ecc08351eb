"""Everything that a robot sensed in its session: unrounded, unmasked, in its start frame.

Laws kept here: rows are only ever added, none is changed; what the robot published follows from these rows, its start
pose and its team-mates' tracks, so that it can be made anew when one of them is corrected.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.column import Column
from agent.readings import Readings
from mapping.pose import QuantisedPose
from mapping.scan import Scans
from mapping.sensor import Sensor
from swarm.session import SessionId

MAX_BYTES = 512 << 20
"""The most that a journal holds: 200 hours of an Orion (five beams, 10 Hz), 10 hours of a laser (180 beams, 10 Hz).
While it grows it takes up to three times what it holds."""

Rows = slice | NDArray[np.intp]


class JournalFullError(Exception):
    """A robot has sensed as much as it may remember."""


class Past(NamedTuple):
    """What an earlier run sensed, and is to be published anew.

    Attributes:
        run: the run's name.
        replaces: the session in which it was published.
        start: where that run started, as it is known now.
        sensor: what sensed.
        readings: all of them.
    """

    run: SessionId
    replaces: SessionId
    start: QuantisedPose | None
    sensor: Sensor
    readings: Readings


class Journal:
    """A robot's readings, oldest first.

    Args:
        sensor: whose readings they are.
        max_bytes: the most that it holds.
    """

    def __init__(self, sensor: Sensor, max_bytes: int = MAX_BYTES) -> None:
        beams = len(sensor.beams)
        self.sensor = sensor
        self._most = max_bytes // (8 + 3 * 8 + beams * 8)
        self._stamps_ms = Column(np.int64)
        self._poses = Column(np.float64, (3,))
        self._ranges = Column(np.float64, (beams,))

    def __len__(self) -> int:
        return len(self._stamps_ms)

    def __getitem__(self, rows: Rows) -> Readings:
        return Readings(self._stamps_ms.rows[rows], self._poses.rows[rows], self._ranges.rows[rows])

    @property
    def stamps_ms(self) -> NDArray[np.int64]:
        """Every row's stamp, shape (N,), never decreasing."""
        return self._stamps_ms.rows

    def append(self, readings: Readings) -> None:
        """Add what was sensed next.

        Raises:
            JournalFullError: there is no room for it; nothing was added.
        """
        if len(self) + len(readings) > self._most:
            raise JournalFullError(f"the journal is full: {len(self)} scans")
        self._stamps_ms.append(readings.stamps_ms)
        self._poses.append(readings.poses)
        self._ranges.append(readings.ranges)

    def scans(self, start: QuantisedPose, rows: Rows) -> Scans:
        """Some rows as a robot publishes them whose start frame lies there, unmasked."""
        return self[rows].scans(start, self.sensor)
