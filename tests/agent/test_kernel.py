"""Kernels that change over on the way: the same integers before, after and without the compiled one."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import threading
import time

import numpy as np
import pytest

import agent.kernel
import mapping
from agent.kernel import Compilation, Kernel, compiled
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.raster import raster
from mapping.scan import NO_RETURN, Scans
from mapping.sensor import Sensor, orion
from mapping.tiles import Evidence, map_digest, merged

MODEL = EvidenceModel()

needs_numba = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="numba is missing: install the extra 'fast'"
)


def some_scans(seed: int) -> tuple[Scans, Sensor, Lattice]:
    chance = np.random.default_rng(seed)
    poses = np.column_stack([chance.integers(-3000, 3000, (20, 2)), chance.integers(0, 65536, 20)]).astype(np.int32)
    ranges = chance.integers(1, 801, (20, 5)).astype(np.uint16)
    ranges[chance.random(ranges.shape) < 0.2] = NO_RETURN
    return Scans(np.arange(20, dtype=np.int64), poses, ranges), orion(), Lattice(20)


def digest(*parts: Evidence) -> bytes:
    return map_digest(dict(iter(merged(list(parts)))))


@pytest.fixture
def slow_compiler(monkeypatch: pytest.MonkeyPatch):
    """A compiled kernel that is ready only when the event is set, and says so when it is used."""
    may_end = threading.Event()
    used: list[Scans] = []

    def fast(scans: Scans, sensor: Sensor, lattice: Lattice, model: EvidenceModel) -> Evidence:
        used.append(scans)
        return raster(scans, sensor, lattice, model)

    def compile_slowly():
        assert may_end.wait(10)
        return fast

    monkeypatch.setattr(agent.kernel, "compiled", compile_slowly)
    return may_end, used


@needs_numba
def test_numpy_and_the_compiled_kernel_give_the_same() -> None:
    fast = compiled()
    assert fast is not raster
    for seed in range(5):
        assert digest(fast(*some_scans(seed), MODEL)) == digest(raster(*some_scans(seed), MODEL))


@needs_numba
def test_changing_over_in_the_middle_changes_nothing() -> None:
    kernel = Kernel()
    parts = [kernel(*some_scans(seed), MODEL) for seed in range(3)]
    kernel.load()
    kernel.close()
    parts += [kernel(*some_scans(seed), MODEL) for seed in range(3, 6)]
    assert digest(*parts) == digest(*(raster(*some_scans(seed), MODEL) for seed in range(6)))


def test_nobody_waits_for_a_kernel_that_is_being_loaded(slow_compiler) -> None:
    may_end, used = slow_compiler
    kernel = Kernel()
    kernel.load()
    kernel.load()  # the second call means nothing
    assert digest(kernel(*some_scans(1), MODEL)) == digest(raster(*some_scans(1), MODEL))
    assert used == []
    may_end.set()
    kernel.close()
    kernel(*some_scans(2), MODEL)
    assert len(used) == 1


def test_closing_waits_for_a_load_under_way(slow_compiler) -> None:
    may_end, _ = slow_compiler
    kernel = Kernel()
    kernel.load()
    threading.Timer(0.05, may_end.set).start()
    kernel.close()
    assert may_end.is_set()


def test_a_kernel_that_was_never_loaded_closes() -> None:
    Kernel().close()


def test_without_numba_the_numpy_kernel_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mapping.raster_jit", None)
    monkeypatch.delattr(mapping, "raster_jit", raising=False)
    assert compiled() is raster
    kernel = Kernel()
    kernel.load()
    kernel.close()
    assert digest(kernel(*some_scans(1), MODEL)) == digest(raster(*some_scans(1), MODEL))


def test_without_numba_nothing_is_ever_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with Compilation() as compilation:
        assert not compilation.ready


@needs_numba
def test_a_compilation_that_fails_is_never_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agent.kernel.sys, "executable", shutil.which("false"))
    with Compilation() as compilation:
        assert compilation._process is not None
        assert compilation._process.wait(10) == 1
        assert not compilation.ready


@needs_numba
@pytest.mark.processes
def test_a_compilation_gets_ready_in_a_process_of_its_own() -> None:
    with Compilation() as compilation:
        assert compilation._process is not None
        compilation._process.wait(60)
        assert compilation.ready


@needs_numba
@pytest.mark.processes
def test_a_compilation_that_nobody_wants_any_more_is_ended() -> None:
    began = time.monotonic()
    with Compilation() as compilation:
        assert not compilation.ready
    assert compilation._process is not None
    assert compilation._process.returncode is not None
    assert time.monotonic() - began < 5
