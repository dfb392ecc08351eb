"""One scan of five beams into evidence: the call that every update of a small robot costs every peer."""

from __future__ import annotations

from functools import partial

from benchmarks.inputs import ORION, orion_walk
from benchmarks.integration import kernels
from benchmarks.table import Row, compared, cpu_seconds, interleaved
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.raster import Raster
from mapping.scan import Scans

_CALLS = 200
_LATTICE, _MODEL = Lattice(20), EvidenceModel()


def measure() -> list[Row]:
    """Microseconds a call of the kernel, and a scan where ten come together; cells of 2 cm."""
    variants = {}
    for name, kernel in kernels().items():
        for count in (1, 10):
            call = partial(_call, kernel, orion_walk(10, 1)[:count])
            call()
            variants[f"{name}, {count} a call"] = lambda call=call, count=count: cpu_seconds(call, _CALLS) / count
    return compared(interleaved(variants, 15), "us a scan", scale=1e6)


def _call(kernel: Raster, scans: Scans) -> None:
    kernel(scans, ORION, _LATTICE, _MODEL)
