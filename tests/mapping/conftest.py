"""The law a second time: scans into cells in plain Python integers, by the word of the design and nothing else.

The law uses nothing of ``mapping``; the fixtures below give the kernels that are to be tested against it. It is slow
and means to be read.
"""

from __future__ import annotations

import importlib.util
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from mapping import raster
from mapping.corners import Drawing
from mapping.evidence import EvidenceModel
from mapping.rays import Rays
from mapping.tiles import Evidence

NUMBA_IS_MISSING = "numba is missing: install the extra 'fast' to test the compiled kernel"

Cell = tuple[int, int]


class Law:
    """Readings into evidence: eq. 1 to 4 in integers, Bresenham's cells by exact fractions, algorithms 1 and 2."""

    INVALID = 0
    NO_RETURN = 65535
    COSINE = tuple(round(math.cos(2 * math.pi * k / 65536) * 16384) for k in range(65536))

    @classmethod
    def cos(cls, turn16: int) -> int:
        return cls.COSINE[turn16 % 65536]

    @classmethod
    def sin(cls, turn16: int) -> int:
        return cls.COSINE[(turn16 - 16384) % 65536]

    @classmethod
    def ends(cls, pose: Cell, beam: Cell, reach: int, cell_mm: int) -> tuple[Cell, Cell]:
        """The first and the last cell of one reading."""
        x, y, yaw = pose
        forward, left, bearing = beam[:3]
        x0 = x * 16384 + forward * cls.cos(yaw) - left * cls.sin(yaw)
        y0 = y * 16384 + forward * cls.sin(yaw) + left * cls.cos(yaw)
        x1 = x0 + reach * cls.cos(yaw + bearing)
        y1 = y0 + reach * cls.sin(yaw + bearing)
        side = cell_mm * 16384
        return (x0 // side, y0 // side), (x1 // side, y1 // side)

    @staticmethod
    @cache
    def offsets(d: int, n: int) -> tuple[int, ...]:
        """k * d / n for k = 0 ... n, each rounded to the nearest integer, halves away from zero."""
        sign = -1 if d < 0 else 1
        return tuple(sign * math.floor(Fraction(k * abs(d), max(n, 1)) + Fraction(1, 2)) for k in range(n + 1))

    @classmethod
    def ray(cls, start: Cell, end: Cell) -> list[Cell]:
        """The cells from start to end."""
        di, dj = end[0] - start[0], end[1] - start[1]
        n = max(abs(di), abs(dj))
        steps = zip(cls.offsets(di, n), cls.offsets(dj, n), strict=True)
        return [(start[0] + i, start[1] + j) for i, j in steps]

    @classmethod
    def rays(cls, scans, sensor, cell_mm: int) -> Iterator[list[tuple[Cell, Cell, bool]]]:
        """For each scan the rays of the readings that say something: first cell, last cell, whether it hit."""
        for pose, ranges in zip(scans.poses.tolist(), scans.ranges.tolist(), strict=True):
            rays = []
            for beam, reading in zip(sensor.beams, ranges, strict=True):
                if reading != cls.INVALID:
                    hit = reading != cls.NO_RETURN
                    reach = reading if hit else sensor.max_range_mm
                    rays.append((*cls.ends(pose, beam, reach, cell_mm), hit))
            yield rays

    @classmethod
    def evidence(cls, rays: Iterable[tuple[Cell, Cell, bool]], occupied: int, free: int) -> Counter[Cell]:
        """What rays add: occupied at a hit, free before it, nothing behind it."""
        evidence: Counter[Cell] = Counter()
        for start, end, hit in rays:
            *before, last = cls.ray(start, end)
            for cell in before:
                evidence[cell] += free
            evidence[last] += occupied if hit else free
        return evidence

    @classmethod
    def map(cls, scans, sensor, model, lattice, before: dict[Cell, int] | None = None) -> dict[Cell, int]:
        """The known cells after some scans; a limit holds after each of them."""
        cells = Counter(before or {})
        for rays in cls.rays(scans, sensor, lattice.cell_mm):
            for cell, units in cls.evidence(rays, model.occupied, model.free).items():
                cells[cell] += units
                if model.limit:
                    cells[cell] = max(-model.limit, min(model.limit, cells[cell]))
        return {cell: units for cell, units in cells.items() if units}

    @staticmethod
    def known(tiles: Iterable) -> dict[Cell, int]:
        """The cells with evidence in tiles: a map, or an ``Evidence``."""
        pairs = tiles.items() if isinstance(tiles, dict) else tiles
        known = {}
        for (ty, tx), cells in pairs:
            for row, column in zip(*(axis.tolist() for axis in cells.nonzero()), strict=True):
                known[tx * 32 + column, ty * 32 + row] = int(cells[row, column])
        return known


@pytest.fixture(scope="session")
def law() -> type[Law]:
    """The oracle."""
    return Law


def _compiled() -> ModuleType:
    if importlib.util.find_spec("numba") is None:
        pytest.skip(NUMBA_IS_MISSING)
    from mapping import raster_jit

    return raster_jit


@pytest.fixture(scope="session")
def compiled() -> Callable:
    """The compiled kernel; without numba the test is skipped, and the summary says so."""
    return _compiled().raster


@pytest.fixture(scope="session")
def drawn_compiled() -> Callable:
    """The compiled kernel's evidence of rays."""
    return _compiled().raster_rays


@pytest.fixture(scope="session", params=["numpy", "compiled"])
def kernel(request: pytest.FixtureRequest) -> Callable:
    """Each kernel in turn: the evidence of scans."""
    return (raster if request.param == "numpy" else _compiled()).raster


def _all_on_canvases(rays: Rays, model: EvidenceModel) -> Evidence:
    """What NumPy makes of many rays, also where there is but one, unless that is very long."""

    def drawn(ray: Rays, model: EvidenceModel) -> Evidence:
        box = raster.box_of([ray])
        if box.area > 1 << 17:
            return alone(ray, model)
        drawing = Drawing(box, model)
        drawing.add(ray)
        return drawing.evidence()

    alone = raster._alone
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(raster, "_alone", drawn)
        return raster.raster_rays(rays, model)


@pytest.fixture(scope="session", params=["numpy", "numpy, all on canvases", "compiled"])
def drawn(request: pytest.FixtureRequest) -> Callable:
    """Each kernel in turn: the evidence of rays."""
    if request.param == "numpy, all on canvases":
        return _all_on_canvases
    return (raster if request.param == "numpy" else _compiled()).raster_rays


@pytest.fixture(scope="session")
def recorded(recordings_dir: Path) -> Callable:
    """The quantised scans of each robot of a recording, and their sensor."""
    from agent.playback import RecordedBody, read
    from mapping.pose import QuantisedPose
    from mapping.scan import Scans

    @cache
    def scans_of(name: str, max_range: float | None = None) -> list:
        runs = []
        for recording in read(recordings_dir / name, max_range=max_range):
            body = RecordedBody(recording)
            batches = []
            while not body.done:
                batches.append(body.read(math.inf).scans(QuantisedPose(0, 0, 0), body.sensor))
            runs.append((Scans.join(batches), body.sensor))
        return runs

    return scans_of


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line on the tests that did not run for want of numba."""
    skipped = [report for report in terminalreporter.getreports("skipped") if NUMBA_IS_MISSING in str(report.longrepr)]
    if skipped:
        terminalreporter.write_line(f"{len(skipped)} tests were SKIPPED: {NUMBA_IS_MISSING}", yellow=True, bold=True)
