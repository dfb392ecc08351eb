"""``orion paper``: the paper's experiments done again, its figures, and its pipeline beside ours in numbers."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from agent.config import Config
from agent.files import prepare_folder, write_whole
from agent.paper_example import Frame, frames_by_the_paper, frames_by_us
from agent.paper_experiments import CELL, CROSSING, EXPERIMENTS, MULTI, SINGLE, Run, conduct
from agent.paper_measures import (
    TOLERANCE,
    Fading,
    cloud_by_the_paper,
    cloud_by_us,
    fading_by_the_paper,
    fading_by_us,
    grid_by_the_paper,
    pose_errors,
    worth,
)
from mapping.evidence import OCCUPIED_PROBABILITY
from mapping.grid import Grid

PIPELINES = ("paper", "ours")

_CELLS_OF_FIGURE_3 = {
    10: "moving obstacle, gone after t = 1",
    4: "wall behind it",
    19: "wall",
    13: "wall",
    31: "wall",
    16: "on the way to m_10",
    29: "on the way to m_10",
    1: "never seen",
}


def report(base: Config, out: Path, seed: int, say: Callable[[str], None], *, quick: bool = False) -> dict[str, Any]:
    """Do it all; gives what ``table.json`` holds and where the files are.

    Args:
        base: ports and transport.
        out: for ``figure-*.png``, ``table.md``, ``table.json`` and a folder ``runs``; made if need be.
        seed: decides the sensors' noise.
        say: told what is being done, a line each.
        quick: leave out the runs with ideal and with drifting odometry, which only the table needs.

    Raises:
        UserError: a file cannot be written, or a run has failed.
    """
    folder = prepare_folder(out)
    examples = {"paper": frames_by_the_paper(), "ours": frames_by_us()}
    pictures = {"figure-3.png": _drawn_example(examples["paper"])}
    rows: list[dict[str, Any]] = []
    fading: dict[str, Fading] = {}
    todo = [each for each in EXPERIMENTS if not quick or each.odometry == "default"]
    for number, experiment in enumerate(todo, start=1):
        say(f"run {number} of {len(todo)}: {experiment.name}")
        run = conduct(experiment, base, folder / "runs" / experiment.name, seed)
        if experiment is CROSSING:
            fading = {"paper": fading_by_the_paper(run), "ours": fading_by_us(run)}
            pictures["fading.png"] = _drawn_fading(fading)
            continue
        grid = grid_by_the_paper(run)
        rows.append(_row(run, grid))
        if experiment.odometry == "default":
            pictures |= _drawn(run, grid)
    for name, picture in pictures.items():
        write_whole(folder / name, picture)
    found: dict[str, Any] = {
        "seed": seed,
        "cell_m": CELL,
        "tolerance_m": TOLERANCE,
        "runs": rows,
        "figure_3": {key: [{f"m_{i}": round(p, 4) for i, p in f.items()} for f in e] for key, e in examples.items()},
        "fading": {name: _faded(each) for name, each in fading.items()},
    }
    table = _markdown(found, examples)
    write_whole(folder / "table.json", json.dumps(found, indent=2).encode() + b"\n")
    write_whole(folder / "table.md", table.encode())
    files = sorted([*pictures, "table.json", "table.md"])
    return found | {"folder": str(folder), "files": files, "table": table}


# --- pictures; matplotlib is loaded only here


def _drawn_example(frames: list[Frame]) -> bytes:
    from agent.paper_figures import figure_3

    return figure_3(frames)


def _drawn(run: Run, paper_grid: Grid) -> dict[str, bytes]:
    """Figures 5 and 6 of the single robot, 8 and 9 of two."""
    from agent.paper_figures import Tour, cloud_figure, grid_figure

    tours = []
    for k, recorded in enumerate(run.sessions):
        start = run.config.robots[recorded.robot].start
        assert start is not None
        pose = start.quantised().pose()
        trail = recorded.scans.poses[:, :2] / 1000
        tours.append(Tour(f"Robot {k + 1}", pose, cloud_by_the_paper(recorded), trail))
    of_us = "ours, one robot" if len(tours) == 1 else "ours, fused by the robots"
    grids = [("the paper's pipeline", paper_grid), (of_us, run.grid)]
    cloud, grid = _FIGURES[run.experiment.letter]
    return {cloud: cloud_figure(run.walls, tours), grid: grid_figure(run.walls, grids, tours)}


_FIGURES = {SINGLE: ("figure-5.png", "figure-6.png"), MULTI: ("figure-8.png", "figure-9.png")}


def _drawn_fading(fading: dict[str, Fading]) -> bytes:
    from agent.paper_figures import fading_figure

    return fading_figure([("the paper's pipeline", fading["paper"]), ("ours", fading["ours"])])


# --- numbers


def _row(run: Run, paper_grid: Grid) -> dict[str, Any]:
    """One run in the table; metres, square metres and shares."""
    errors = pose_errors(run)
    pipelines = {
        "paper": worth(run, cloud_by_the_paper, paper_grid),
        "ours": worth(run, cloud_by_us, run.grid),
    }
    return {
        "experiment": run.experiment.letter,
        "odometry": run.experiment.odometry,
        "robots": len(run.sessions),
        "scans": sum(len(recorded.scans) for recorded in run.sessions),
        "map_digest": run.summary["observer"]["map_digest"],
        "pose_error_mean_m": round(float(errors.mean()), 5),
        "pose_error_max_m": round(float(errors.max()), 5),
        **{name: {key: round(value, 5) for key, value in asdict(each).items()} for name, each in pipelines.items()},
    }


def _faded(fading: Fading) -> dict[str, Any]:
    """The moving obstacle in numbers: the mean and the highest over its cells."""
    moments = {"first_seen": fading.at_first, "peak": fading.at_most, "end": fading.at_end}
    return {
        "cells": len(fading.first),
        **{
            f"p_{name}_{what}": round(float(value), 4)
            for name, p in moments.items()
            for what, value in (("mean", p.mean()), ("max", p.max()))
        },
        "cells_still_occupied": int((fading.at_end > OCCUPIED_PROBABILITY).sum()),
    }


# --- for people


def _markdown(found: dict[str, Any], examples: dict[str, list[Frame]]) -> str:
    """The tables as Markdown."""
    parts = [
        "# The paper's experiments, simulated",
        "",
        f"Seed {found['seed']}, cells of {CELL * 100:g} cm, tolerance {TOLERANCE * 100:g} cm. A: one robot in a "
        "rectangular space. B: two robots in two spaces, one map (eq. 8). Every robot is a process of its own.",
        "Both pipelines get the scans that the robots published.",
        "",
        *_table(
            _COLUMNS,
            [_cells(row, name) for row in found["runs"] for name in PIPELINES],
        ),
        "",
        "Pose error: from the published to the true position. Wall error: from the points that readings hit to the "
        "nearest wall; ours are taken on a lattice of 1 mm. The paper's pipeline makes nothing of a reading without "
        "an echo; ours frees its ray, hence the larger known area.",
        "",
        "## Figure 3: p(occupied) over three steps",
        "",
        *_table(
            ["cell", "what it is", "pipeline", "t = 0", "t = 1", "t = 2", "t = 3"],
            [
                [f"m_{i}", what, name, *(f"{frame[i]:.3f}" for frame in examples[name])]
                for i, what in _CELLS_OF_FIGURE_3.items()
                for name in PIPELINES
            ],
        ),
    ]
    parts += [
        "",
        "## A moving obstacle fades",
        "",
        "Somebody crosses the rectangular space in front of the robot and goes out; p(occupied) of the cells that "
        "readings on them fell in.",
        "",
        *_table(
            ["pipeline", "cells", "first seen: mean", "peak: mean", "max", "end: mean", "max", "still occupied"],
            [
                [name, str(f["cells"]), *(f"{f[key]:.3f}" for key in _FADING_KEYS), str(f["cells_still_occupied"])]
                for name, f in found["fading"].items()
            ],
        ),
    ]
    return "\n".join(parts) + "\n"


_COLUMNS = (
    "",
    "odometry",
    "pose error mean (mm)",
    "pipeline",
    "wall error mean (mm)",
    "p95 (mm)",
    "recall",
    "precision",
    "known (m2)",
)
_FADING_KEYS = ("p_first_seen_mean", "p_peak_mean", "p_peak_max", "p_end_mean", "p_end_max")


def _cells(row: dict[str, Any], name: str) -> list[str]:
    it = row[name]
    return [
        row["experiment"],
        row["odometry"],
        f"{row['pose_error_mean_m'] * 1000:.1f}",
        name,
        f"{it['wall_error_mean'] * 1000:.1f}",
        f"{it['wall_error_p95'] * 1000:.1f}",
        f"{it['recall']:.3f}",
        f"{it['precision']:.3f}",
        f"{it['known_m2']:.2f}",
    ]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table whose columns are aligned in the source, too."""
    widths = [max(len(line[k]) for line in (head, *rows)) for k in range(len(head))]
    lines = [[cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in (head, *rows)]
    lines.insert(1, ["-" * width for width in widths])
    return ["| " + " | ".join(line) + " |" for line in lines]
