"""Where a robot's readings come from: the contract of every body."""

from __future__ import annotations

from typing import Protocol

from agent.readings import Readings
from mapping.pose import QuantisedPose
from mapping.sensor import Sensor

BATCH = 64
"""The most scans that one ``read`` returns, so that a robot running as fast as it can still hears its peers."""


class Body(Protocol):
    """A robot's senses: simulated, recorded, or real.

    Attributes:
        sensor: what its scans' ranges mean.
        patience: seconds that whoever reads it may sleep at most.
        status: what is wrong with it, in words; empty if nothing is.
    """

    sensor: Sensor
    patience: float
    status: str

    def place(self, start: QuantisedPose) -> None:
        """The robot's start frame lies there in the common frame, ``T_common_start``, from now on.

        For whoever drives it; its readings stay as they are. Until it is placed it lies at the origin.
        """
        ...

    def read(self, until: float) -> Readings:
        """The next scans (at most ``BATCH``) sensed before ``until``, unrounded, poses in the start frame.

        Args:
            until: seconds of the body's own time since it started, 0 before it may; infinity reads as fast as
                possible. A real robot has its own time and does not look at it.
        """
        ...

    @property
    def progress(self) -> tuple[int, int]:
        """Scans read so far, and of how many in all (0: nobody knows)."""
        ...

    @property
    def done(self) -> bool:
        """Whether there is nothing more to come."""
        ...

    def close(self) -> None:
        """Leave the body as it is safe to be left: its wheels still."""
        ...
