"""Builds the programs of this folder from Debian's development packages, and hands them scans."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.inputs import Log

_HERE = Path(__file__).parent
_MRPT = Path("/usr/include/mrpt")
PACKAGES = "g++ libmrpt-maps-dev liboctomap-dev"


def build(name: str, folder: Path) -> Path | None:
    """The program ``name``; None, and why on standard output, if it cannot be built here."""
    flags = {
        "octomap": ["-loctomap", "-loctomath"],
        "mrpt": [
            *[f"-I{each}" for each in sorted(_MRPT.glob("*/include"))],
            "-I/usr/include/eigen3",
            *[f"-lmrpt-{part}" for part in ("maps", "obs", "poses", "math", "rtti", "serialization", "core", "system")],
        ],
    }[name]
    program = folder / name
    command = ["g++", "-O3", "-DNDEBUG", "-std=c++17", "-w", str(_HERE / f"{name}.cpp"), "-o", str(program), *flags]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        sys.stdout.write(f"{name} cannot be built here: apt-get install {PACKAGES}\n")
        return None
    return program


def write_scans(log: Log, cell: float, path: Path) -> None:
    """The scans as ``scans.hpp`` reads them."""
    first, second = (beam.bearing_turn16 / 65536 * 2 * np.pi for beam in log.sensor.beams[:2])
    head = [cell, first, (second - first) % (2 * np.pi), log.sensor.max_range_mm / 1000]
    with path.open("wb") as file:
        file.write(np.array(log.ranges.shape, "<i4").tobytes() + np.array(head, "<f8").tobytes())
        for pose, ranges in zip(log.poses, log.ranges, strict=True):
            file.write(pose.astype("<f8").tobytes() + ranges.astype("<f4").tobytes())


def seconds(program: Path, scans: Path) -> float:
    """The computing time of one integration, by the program's own clock."""
    return float(subprocess.run([program, scans], check=True, capture_output=True).stdout.split()[0])
