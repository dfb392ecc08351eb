"""Whole logs into a map at 0.05 m: our kernels against MRPT's dense grid and OctoMap's tree, on one core."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.inputs import Log, logs
from benchmarks.peers.build import build, seconds, write_scans
from benchmarks.table import Row, compared, cpu_seconds, interleaved
from mapping import raster
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Cells, Lattice, TileKey
from mapping.tiles import map_digest

CELL = 0.05
_REPEATS = 15


def kernels() -> dict[str, raster.Raster]:
    """Those that can be used here."""
    found: dict[str, raster.Raster] = {"NumPy": raster.raster}
    if importlib.util.find_spec("numba") is not None:
        from mapping import raster_jit

        found["fast"] = raster_jit.raster
    return found


def measure() -> list[Row]:
    """Millions of beams a second; OctoMap once a log, as it takes seconds."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        programs = {name: build(name, Path(folder)) for name in ("mrpt", "octomap")}
        for log in logs():
            scans = Path(folder) / log.name
            write_scans(log, CELL, scans)
            rows += _of_log(log, scans, programs)
    return rows


def _of_log(log: Log, scans: Path, programs: dict[str, Path | None]) -> list[Row]:
    millions = log.scans.ranges.size / 1e6
    variants: dict[str, Callable[[], float]] = {}
    digests = set()
    for name, kernel in kernels().items():
        digests.add(map_digest(_map(log, kernel)).hex())  # and it is compiled now
        variants[f"{log.name}: {name}"] = partial(cpu_seconds, partial(_map, log, kernel))
    assert len(digests) == 1
    reference = None
    if (mrpt := programs["mrpt"]) is not None:
        reference = f"{log.name}: MRPT"
        variants[reference] = partial(seconds, mrpt, scans)
    figures = interleaved(variants, _REPEATS)
    if (octomap := programs["octomap"]) is not None:
        figures[f"{log.name}: OctoMap"] = [seconds(octomap, scans)]
    speeds = {name: [millions / value for value in values] for name, values in figures.items()}
    rows = compared(speeds, "Mbeam/s", reference)
    return [row._replace(note=f"digest {next(iter(digests))}") if "fast" in row.what else row for row in rows]


def _map(log: Log, kernel: raster.Raster) -> dict[TileKey, Cells]:
    return integrated({}, log.scans, log.sensor, EvidenceModel(), Lattice.of(CELL), kernel)
