import json

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.errors import UserError
from agent.map_command import app
from agent.map_files import load_map, save_map
from mapping.grid import Grid
from mapping.lattice import Lattice


@pytest.fixture
def room(tmp_path):
    """A room of 1 x 0.5 m with walls one cell thick, saved as room.*, and its walls as walls.csv."""
    evidence = np.full((10, 20), -200, np.int32)
    evidence[[0, -1]] = 85
    evidence[:, [0, -1]] = 85
    save_map(tmp_path, "room", Grid(evidence, 0, 0, Lattice(50)))
    half = evidence.copy()
    half[:, 10:] = 0
    save_map(tmp_path, "half", Grid(half, 0, 0, Lattice(50)))
    (tmp_path / "walls.csv").write_text("# walls\n0,0,1,0\n1,0,1,0.5\n1,0.5,0,0.5\n0,0.5,0,0\n")
    return tmp_path


def run(*words, status=0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    if isinstance(result.exception, UserError):
        raise result.exception
    assert result.exit_code == status, result.output
    return result.stdout


def run_json(*words, status=0):
    return json.loads(run(*words, "--json", status=status).splitlines()[-1])


def test_info_says_what_a_map_is_and_verifies_it(room):
    facts = run_json("info", room / "room.npz")
    assert facts == {
        "map": str(room / "room.npz"),
        "cell": 0.05,
        "rows": 10,
        "columns": 20,
        "origin": [0.0, 0.0],
        "width_m": 1.0,
        "height_m": 0.5,
        "known_m2": pytest.approx(0.5),
        "known": 200,
        "occupied": 56,
        "free": 144,
        "tiles": 1,
        "digest": load_map(room / "room.npz").digest().hex(),
        "verified": True,
    }
    text = run("info", room / "room.npz")
    assert "1 x 0.5 m, 20 x 10 cells" in text
    assert f"{facts['digest']} (verified)" in text
    assert "verified" not in run("info", room / "room.yaml")


def test_a_map_whose_digest_is_wrong_is_refused(room):
    entries = dict(np.load(room / "room.npz"))
    entries["evidence"][3, 3] += 1
    np.savez(room / "room.npz", **entries)
    with pytest.raises(UserError, match=r"digest: .* damaged"):
        run("info", room / "room.npz")


def test_export_writes_every_form(room):
    files = run_json("export", room / "room.npz", "--out", room / "new" / "ros", "--name", "lab")["files"]
    assert files == {kind: str(room / "new" / "ros" / f"lab.{kind}") for kind in ("npz", "pgm", "yaml", "png")}
    assert (room / "new" / "ros" / "lab.npz").read_bytes() == (room / "room.npz").read_bytes()
    assert "lab.yaml" in run("export", room / "room.npz", "--out", room / "new", "--name", "lab")


def test_exporting_an_archive_into_its_own_folder_keeps_it(room):
    before = (room / "room.npz").read_bytes()
    run("export", room / "room.npz", "--out", room)
    assert (room / "room.npz").read_bytes() == before


def test_exporting_a_picture_over_itself_is_refused(room):
    with pytest.raises(UserError, match="would be overwritten by its own export"):
        run("export", room / "room.pgm", "--out", room)
    run("export", room / "room.pgm", "--out", room, "--name", "other")


def test_a_map_does_not_differ_from_itself_in_any_place(room):
    assert run("diff", room / "room.npz", room / "room.npz").startswith("equal, digest ")
    assert run_json("diff", room / "room.yaml", room / "room.pgm")["equal"] is True


def test_diff_counts_cells_of_maps_of_different_extent(room):
    """The second map lacks the eastern half, is smaller, and knows a cell far in the south-west."""
    evidence = np.zeros((60, 60), np.int32)
    evidence[50:, 50:] = load_map(room / "room.npz").evidence[:, :10]
    evidence[0, 0] = -(2**31)
    save_map(room, "b", Grid(evidence, -50, -50, Lattice(50)))
    found = run_json("diff", room / "room.npz", room / "b.npz", status=1)
    assert (found["equal"], found["differing"], found["largest"]) == (False, 101, 2**31)
    assert len(set(found["digests"])) == 2
    assert run("diff", room / "b.npz", room / "room.npz", status=1) == (
        "101 cells differ, by at most 2147483648 units of evidence\n"
    )


def test_maps_of_different_cells_are_not_compared(room):
    save_map(room, "fine", Grid(np.ones((1, 1), np.int32), 0, 0, Lattice(20)))
    with pytest.raises(UserError, match=r"cells of 0\.05 m and 0\.02 m"):
        run("diff", room / "room.npz", room / "fine.npz")


def test_score_prints_a_row_for_each_map(room):
    found = run_json("score", room / "room.npz", room / "half.npz", "--walls", room / "walls.csv")
    assert [row["map"] for row in found["maps"]] == [str(room / "room.npz"), str(room / "half.npz")]
    whole, half = found["maps"]
    assert found["truth"] == str(room / "walls.csv")
    assert {key: found[key] for key in whole} == whole
    assert (whole["recall"], whole["precision"], whole["tolerance"]) == (1.0, 1.0, pytest.approx(0.075))
    assert half["recall"] == pytest.approx(0.5, abs=0.05)
    assert half["precision"] == 1.0
    assert half["iou"] < whole["iou"]
    head, *rows = run("score", room / "room.npz", room / "half.npz", "--walls", room / "walls.csv").splitlines()
    assert head.split()[:3] == ["map", "recall", "precision"]
    assert [row.split()[:3] for row in rows] == [
        [str(room / "room.npz"), "1.000", "1.000"],
        [str(room / "half.npz"), f"{half['recall']:.3f}", "1.000"],
    ]


def test_score_against_a_true_map_and_with_a_tolerance(room):
    found = run_json("score", room / "half.npz", "--truth", room / "room.yaml", "--tolerance", "0.02")
    assert (found["recall"], found["precision"], found["tolerance"]) == (0.5, 1.0, 0.02)


def test_the_score_of_an_empty_map_is_json_too(room):
    save_map(room, "empty", Grid(np.zeros((0, 0), np.int32), 0, 0, Lattice(50)))
    found = run_json("score", room / "empty.npz", "--walls", room / "walls.csv")
    assert (found["recall"], found["precision"], found["iou"]) == (0.0, None, 0.0)
    assert " - " in run("score", room / "empty.npz", "--walls", room / "walls.csv")


def test_score_needs_exactly_one_truth(room):
    both = ("--walls", room / "walls.csv", "--truth", room / "room.npz")
    for options in ((), both):
        with pytest.raises(UserError, match="give either --walls CSV or --truth MAP"):
            run("score", room / "room.npz", *options)


def test_a_tolerance_that_is_none_is_the_users_to_mend(room):
    with pytest.raises(UserError, match="tolerance: -1"):
        run("score", room / "room.npz", "--walls", room / "walls.csv", "--tolerance", "-1")


@pytest.mark.parametrize("command", ["export", "info", "diff", "score"])
def test_help_shows_an_example(command):
    text = run(command, "--help")
    assert f"orion map {command}" in text


def test_a_terminal_gets_a_table(room, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert "┃" in run("score", room / "room.npz", "--walls", room / "walls.csv")


def test_a_difference_and_a_score_are_drawn(room):
    run("diff", room / "room.npz", room / "half.npz", "--png", room / "diff.png", status=1)
    run("score", room / "half.npz", room / "room.npz", "--walls", room / "walls.csv", "--png", room / "score.png")
    assert all((room / name).read_bytes().startswith(b"\x89PNG") for name in ("diff.png", "score.png"))
    with pytest.raises(UserError, match=r"let it end in \.png"):
        run("diff", room / "room.npz", room / "half.npz", "--png", room / "map.npz")
    assert load_map(room / "room.npz").evidence.any()
