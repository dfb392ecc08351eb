"""Rows of figures: how they are timed against each other, printed, and kept."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple


class Row(NamedTuple):
    """One figure.

    Attributes:
        what: was measured.
        value: the figure, a median where there were several runs.
        unit: of it.
        low: the least of the runs.
        high: the greatest of the runs.
        ratio: to the row that its group is compared with, the median of all turns; 0 where there is none.
        note: what else belongs to it.
    """

    what: str
    value: float
    unit: str
    low: float = 0.0
    high: float = 0.0
    ratio: float = 0.0
    note: str = ""


def interleaved(variants: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, list[float]]:
    """The figures of several variants, measured in turn, so that what disturbs one disturbs the others too."""
    figures: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(repeats):
        for name, measured in variants.items():
            figures[name].append(measured())
    return figures


def cpu_seconds(work: Callable[[], object], times: int = 1) -> float:
    """Seconds of this thread's own computing, a run: what others do on the machine is not in it."""
    begin = time.thread_time()
    for _ in range(times):
        work()
    return (time.thread_time() - begin) / times


def compared(
    figures: Mapping[str, Sequence[float]], unit: str, reference: str | None = None, scale: float = 1.0
) -> list[Row]:
    """A row a variant: the median of its runs, their spread, and its ratio to the reference.

    That is the median of the ratios of each turn, not the ratio of medians: the speed of a shared machine changes from
    one second to the next, and changes both figures of a turn alike.
    """
    rows = []
    for name, values in figures.items():
        turns = zip(values, [] if reference is None else figures[reference], strict=False)
        ratio = statistics.median([value / base for value, base in turns] or [0.0])
        rows.append(Row(name, statistics.median(values) * scale, unit, min(values) * scale, max(values) * scale, ratio))
    return rows


def printed(title: str, rows: Sequence[Row]) -> str:
    """The rows as text."""
    width = max((len(row.what) for row in rows), default=0)
    lines = [title]
    for row in rows:
        spread = f"{row.low:.4g} to {row.high:.4g}" if row.high else ""
        ratio = f"x {row.ratio:.2f}" if row.ratio else ""
        lines.append(f"  {row.what:<{width}}  {row.value:>10.4g} {row.unit:<10} {spread:<22} {ratio:<8} {row.note}")
    return "\n".join(line.rstrip() for line in lines)
