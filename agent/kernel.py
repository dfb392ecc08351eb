"""Compiled kernels that nobody waits for: work begins with NumPy and goes on with numba once that is ready.

The two give the same integers, so a process may change over between any two batches. One process on a
machine compiles (``python -m agent.kernel``) and leaves the result in numba's cache; the others load it from there.
"""

from __future__ import annotations

import gc
import importlib.util
import subprocess
import sys
import threading
from types import TracebackType
from typing import Self

import numpy as np

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.raster import Raster, raster
from mapping.scan import Scans
from mapping.sensor import Beam, Sensor
from mapping.tiles import Evidence

_SENSOR = Sensor((Beam(0, 0, 0),), 1000)
_SCAN = Scans(np.zeros(1, np.int64), np.zeros((1, 3), np.int32), np.full((1, 1), 100, np.uint16))


class Kernel:
    """A kernel for scans that becomes a faster one on the way. Call it as ``mapping.raster.raster``."""

    def __init__(self) -> None:
        self._raster: Raster = raster
        self._loading: threading.Thread | None = None

    def __call__(self, scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
        """As ``mapping.raster.raster``."""
        return self._raster(scans, sensor, lattice, model)

    def load(self) -> None:
        """Load the compiled kernel in the background; to be called once it lies in the cache."""
        if self._loading is None:
            self._loading = threading.Thread(target=self._load, name="orion-kernel")
            self._loading.start()

    def _load(self) -> None:
        self._raster = compiled()
        gc.freeze()  # what came with it stays: to look through it for garbage would stop all for tens of ms

    def close(self) -> None:
        """Wait for a load under way: an interpreter must not end in the middle of it."""
        if self._loading is not None:
            self._loading.join()


def compiled() -> Raster:
    """The jitted kernel, compiled or loaded from the cache; the NumPy one if numba cannot be used here."""
    try:
        from mapping import raster_jit
    except ImportError:
        return raster
    raster_jit.raster(_SCAN, _SENSOR, Lattice(50), EvidenceModel())
    return raster_jit.raster


class Compilation:
    """Compiles in a process of its own. Use it in a ``with`` statement."""

    def __enter__(self) -> Self:
        self._process: subprocess.Popen[bytes] | None = None
        if importlib.util.find_spec("numba") is not None:
            quiet = subprocess.DEVNULL
            command = [sys.executable, "-P", "-m", "agent.kernel"]
            self._process = subprocess.Popen(  # noqa: S603 - our own command
                command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
            )
        return self

    @property
    def ready(self) -> bool:
        """Whether the cache holds the compiled kernel (never, where numba is missing or failed)."""
        return self._process is not None and self._process.poll() == 0

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            self._process.wait()


if __name__ == "__main__":
    compiled()
