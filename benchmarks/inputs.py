"""What is measured on: recorded logs where ``ORION_DATA`` has them, else a synthetic office."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.carmen import read
from mapping.scan import NO_RETURN, Scans, quantise
from mapping.sensor import Sensor, laser, orion

_LOGS = {"intel": "carmen/intel-corrected.log.gz", "seattle": "carmen/seattle-corrected.log.gz"}


class Log(NamedTuple):
    """One robot's run.

    Attributes:
        name: of the log.
        scans: quantised.
        sensor: their laser.
        poses: shape (N, 3), metres and radians, as others get them.
        ranges: shape (N, B), metres: 0 says nothing, beyond the sensor's range is nothing in range.
    """

    name: str
    scans: Scans
    sensor: Sensor
    poses: NDArray[np.float64]
    ranges: NDArray[np.float32]


def logs() -> list[Log]:
    """The recorded logs that are there, or the office."""
    folder = Path(os.environ.get("ORION_DATA", ""))
    found = []
    for name, path in _LOGS.items():
        if os.environ.get("ORION_DATA") and (folder / path).exists():
            recording = read(folder / path)
            found.append(_log(name, recording.stamps, recording.poses, recording.ranges, recording.sensor))
    return found or [office()]


def office(scans: int = 600, beams: int = 361) -> Log:
    """A robot that drives along a corridor of 40 m between rooms: distances to walls, with noise."""
    chance = np.random.default_rng(1)
    sensor = laser(beams, first=-math.pi / 2, step=math.pi / (beams - 1), max_range=20.0)
    x = np.linspace(0, 40, scans)
    poses = np.column_stack([x, chance.normal(0, 0.1, scans), chance.normal(0, 0.3, scans)])
    angles = poses[:, 2:] + np.array([beam.bearing_turn16 for beam in sensor.beams]) * math.tau / 65536
    with np.errstate(divide="ignore"):
        side = np.where((x[:, None] + np.cos(angles)) % 5 < 1, 6.0, 1.5)  # a door every five metres
        to_side = side / np.abs(np.sin(angles))
        to_end = np.where(np.cos(angles) > 0, 42 - x[:, None], x[:, None] + 2) / np.abs(np.cos(angles))
    ranges = np.minimum(to_side, to_end) + chance.normal(0, 0.02, to_side.shape)
    return _log(
        "office", np.arange(scans, dtype=np.float64) / 10, poses.astype(np.float64), ranges.astype(np.float64), sensor
    )


def orion_walk(scans: int, seed: int, *, cells_away: int = 0) -> Scans:
    """An Orion at 10 Hz and 0.1 m/s in a room of 6 x 4 m."""
    chance = np.random.default_rng(seed)
    yaw = np.cumsum(chance.normal(0, 0.1, scans))
    x = 3000 + 2000 * np.sin(np.arange(scans) * 0.005 + seed)
    y = 2000 + 1200 * np.sin(np.arange(scans) * 0.0077 + 2 * seed)
    poses = np.column_stack([x + cells_away * 20, y, yaw / math.tau * 65536 % 65536]).astype(np.int32)
    ranges = 400 + 300 * np.sin(np.arange(scans)[:, None] * 0.05 + np.arange(5)) + chance.normal(0, 8, (scans, 5))
    ranges = np.where(ranges > 690, NO_RETURN, np.clip(ranges, 30, 800)).astype(np.uint16)
    return Scans(np.arange(scans, dtype=np.int64) * 100, poses, ranges)


ORION = orion()


def _log(
    name: str, stamps: NDArray[np.float64], poses: NDArray[np.float64], ranges: NDArray[np.float64], sensor: Sensor
) -> Log:
    plain = np.where(np.isnan(ranges), 0.0, np.where(np.isinf(ranges), 1000.0, ranges)).astype(np.float32)
    return Log(name, quantise(stamps, poses, ranges, sensor), sensor, poses, plain)
