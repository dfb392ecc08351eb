"""Measures, figures, tables and files of ``orion paper``, from runs that were made here without any process."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import agent.paper_report
from agent.config import Config, resolve
from agent.errors import UserError
from agent.paper_experiments import CELL, CROSSING, EXPERIMENTS, MULTI, SINGLE, Experiment, Run
from agent.paper_figures import DPI
from agent.paper_measures import (
    cloud_by_the_paper,
    cloud_by_us,
    fading_by_the_paper,
    fading_by_us,
    grid_by_the_paper,
    pose_errors,
    worth,
)
from agent.paper_report import report
from agent.scan_record import Recorded
from agent.world import load_world
from mapping.evidence import EvidenceModel
from mapping.grid import Grid
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.scan import quantise
from mapping.sensor import Sensor, orion, sensor
from mapping.tiles import summed

LATTICE = Lattice.of(CELL)
BOX = np.array([[-0.5, -0.5, 0.5, -0.5], [0.5, -0.5, 0.5, 0.5], [0.5, 0.5, -0.5, 0.5], [-0.5, 0.5, -0.5, -0.5]])


def run_of(experiment: Experiment, walls: Any, robots: list[tuple[Sensor, Any, Any]], config: Config) -> Run:
    """A run whose robots knew where they were: sensor, poses (N, 3) and ranges (N, B) of each."""
    sessions = [
        Recorded(f"r{k + 1}", f"{k:016x}", sensor, quantise(np.arange(len(poses)) * 0.1, poses, ranges, sensor))
        for k, (sensor, poses, ranges) in enumerate(robots)
    ]
    maps = [integrated({}, each.scans, each.sensor, EvidenceModel(), LATTICE) for each in sessions]
    truth = np.stack([np.asarray(poses, np.float64) for _, poses, _ in robots], axis=1)
    summary = {"observer": {"map_digest": "00"}}
    return Run(experiment, config, Grid.of(summed(list(maps)), LATTICE), sessions, np.asarray(walls), truth, summary)


def config_of(robots: int) -> Config:
    return resolve({"robots": {f"r{k + 1}": {"start": {"x": 2.0 * k}} for k in range(robots)}})


def circling(world: str, robots: int, experiment: Experiment) -> Run:
    """Robots that turn on the spot at their starts."""
    there = load_world(world)
    sensed = []
    for start in there.starts[:robots]:
        yaws = np.linspace(0, math.tau, 60)
        poses = np.column_stack([np.full(60, start.x), np.full(60, start.y), yaws])
        table = orion().table
        bearings = yaws[:, None] + table[:, 2] / 65536 * math.tau
        origins = np.stack([start.x + 0.03 * np.cos(yaws), start.y + 0.03 * np.sin(yaws)], axis=1).repeat(5, axis=0)
        sensed.append((orion(), poses, there.cast(origins, bearings.ravel()).reshape(60, 5)))
    return run_of(experiment, there.walls, sensed, config_of(robots))


# --- measures


CENTRED = sensor([(0.0, 0.0, turn * math.pi / 2) for turn in (-1, 0, 1)], 0.8)
"""No offset, no diagonals: nothing for rounding to decide."""


def square(*rows: tuple[float, float, float]) -> Run:
    """A robot that stands in the middle of a cell and looks right, ahead (along +x) and left."""
    poses = np.tile([0.01, 0.01, 0.0], (len(rows), 1))
    return run_of(Experiment(SINGLE, "box", "ideal"), BOX, [(CENTRED, poses, np.array(rows))], config_of(1))


def test_where_every_reading_hits_both_pipelines_draw_the_same_grid() -> None:
    run = square((0.5, 0.48, 0.48), (0.5, 0.48, 0.2), (0.3, 0.48, 0.48))
    assert grid_by_the_paper(run).digest() == run.grid.digest()


def test_a_reading_of_nothing_frees_a_ray_for_us_only() -> None:
    run = square((0.48, math.inf, 0.48))
    theirs = grid_by_the_paper(run)
    assert run.grid.known_m2 == pytest.approx(theirs.known_m2 + 40 * CELL**2)


def test_the_hit_points_of_both_are_the_same_but_for_rounding() -> None:
    recorded = circling("rectangle", 1, Experiment(SINGLE, "rectangle", "ideal")).sessions[0]
    assert np.abs(cloud_by_the_paper(recorded) - cloud_by_us(recorded)).max() < 0.001


def test_worth_tells_how_far_points_are_from_the_walls() -> None:
    run = square((0.51, 0.49, 0.29), (0.51, 0.49, 0.29))
    found = worth(run, cloud_by_the_paper, grid_by_the_paper(run))
    assert found.wall_error_mean == pytest.approx(0.2 / 3)
    assert found.wall_error_p95 == pytest.approx(0.2)
    assert found.precision == pytest.approx(2 / 3)
    assert 0 < found.recall < 0.1


def test_pose_errors_are_those_of_every_robot() -> None:
    run = square((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
    run.truth[1, 0, 0] += 0.03
    assert pose_errors(run) == pytest.approx([0.0, 0.03])


@pytest.mark.parametrize("fading_of", [fading_by_the_paper, fading_by_us])
def test_an_obstacle_that_goes_away_fades_as_long_as_something_is_seen_behind_it(fading_of: Any) -> None:
    behind = (0.5, 0.48, 0.48)
    fading = fading_of(square(behind, (0.5, 0.3, 0.48), behind, behind, behind))
    (column,) = fading.probabilities.T
    l = np.array([-0.4, 0.45, 0.05, -0.35, -0.75])  # noqa: E741 - the paper's letter
    assert column == pytest.approx(1 - 1 / (1 + np.exp(l)))
    assert fading.at_first == pytest.approx([column[1]])
    assert fading.at_most == pytest.approx([column[1]])
    assert fading.at_end == pytest.approx([column[4]])
    assert fading.seconds == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


def test_an_obstacle_before_nothing_stays_in_the_papers_map_and_fades_from_ours() -> None:
    nothing = (0.5, math.inf, 0.48)
    run = square((0.5, 0.3, 0.48), nothing, nothing, nothing)
    assert fading_by_the_paper(run).at_end == pytest.approx(fading_by_the_paper(run).at_first)
    assert fading_by_us(run).at_end[0] < 0.5


# --- the report


@pytest.fixture
def without_processes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Runs are made here; gives the names of those that were asked for."""
    asked = []

    def conduct(experiment: Experiment, base: Config, folder: Path, seed: int) -> Run:
        asked.append(experiment.name)
        if experiment is CROSSING:
            return run_of(
                CROSSING,
                BOX,
                [(CENTRED, np.tile([0.01, 0.01, 0.0], (3, 1)), np.array([[0.5, 0.3, 0.48], *[[0.5, 0.48, 0.48]] * 2]))],
                config_of(1),
            )
        return circling(experiment.world, 2 if experiment.letter == MULTI else 1, experiment)

    monkeypatch.setattr(agent.paper_report, "conduct", conduct)
    return asked


FILES = [f"figure-{number}.png" for number in (3, 5, 6, 8, 9)]


def test_a_report_has_all_figures_and_a_row_a_run_and_pipeline(tmp_path: Path, without_processes: list[str]) -> None:
    said: list[str] = []
    found = report(resolve({}), tmp_path / "new" / "report", 1, said.append)
    folder = tmp_path / "new" / "report"
    assert without_processes == [each.name for each in EXPERIMENTS]
    assert len(said) == len(EXPERIMENTS)
    assert {path.name for path in folder.iterdir()} == {*FILES, "fading.png", "table.md", "table.json"}
    assert set(found["files"]) == {path.name for path in folder.iterdir()}
    for name in (*FILES, "fading.png"):
        with Image.open(io.BytesIO((folder / name).read_bytes())) as picture:
            picture.load()
            assert picture.info["dpi"] == pytest.approx((DPI, DPI), abs=0.1)
            assert min(picture.size) > 600
    table = json.loads((folder / "table.json").read_bytes())
    assert [(row["experiment"], row["odometry"]) for row in table["runs"]] == [
        (letter, odometry) for letter in "AB" for odometry in ("ideal", "default", "drifting")
    ]
    text = (folder / "table.md").read_text()
    assert text.count("| paper ") == text.count("| ours ") == 6 + 8 + 1
    assert found["table"] == text


def test_a_quick_report_runs_the_default_odometry_only(tmp_path: Path, without_processes: list[str]) -> None:
    found = report(resolve({}), tmp_path, 1, lambda line: None, quick=True)
    assert without_processes == [each.name for each in EXPERIMENTS if each.odometry == "default"]
    assert {row["odometry"] for row in found["runs"]} == {"default"}
    assert set(FILES) < set(found["files"])


def test_a_folder_that_cannot_be_is_told_before_anything_runs(tmp_path: Path, without_processes: list[str]) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is no folder to write to"):
        report(resolve({}), tmp_path / "file", 1, lambda line: None)
    assert without_processes == []
