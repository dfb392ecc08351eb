import io

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from agent.errors import UserError
from agent.map_files import load_map, load_walls, save_map
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_picture import Trail

GRID = Grid(np.array([[85, -40, 0], [0, -200, 170]], np.int32), -3, 7, Lattice(50))
TRAIL = Trail("r1", (0, 0, 0), np.array([[-0.1, 0.4], [0.0, 0.4]]))
same_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def test_a_saved_map_is_read_back_from_every_form(tmp_path):
    files = save_map(tmp_path, "lab", GRID)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lab.npz", "lab.pgm", "lab.png", "lab.yaml"]
    assert load_map(files["npz"]).digest() == GRID.digest()
    seen = load_map(files["yaml"])
    assert seen.evidence.tolist() == [[460, 0, 0], [0, -460, 460]]
    assert (seen.i0, seen.j0, seen.lattice) == (-3, 7, Lattice(50))
    assert load_map(files["pgm"]).digest() == seen.digest()


def test_the_picture_is_grey_without_trails_and_coloured_with(tmp_path):
    for trails, mode in (((), "L"), ([TRAIL], "RGB")):
        picture = save_map(tmp_path, "map", GRID, trails)["png"].read_bytes()
        with Image.open(io.BytesIO(picture)) as image:
            assert image.mode == mode


@pytest.mark.parametrize("stem", ["", "a/b", "..", ".", ".hidden", "/abs"])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path, stem):
    with pytest.raises(UserError, match="is no name for files"):
        save_map(tmp_path, stem, GRID)
    assert list(tmp_path.iterdir()) == []


def test_a_picture_in_another_folder_is_found_from_the_yaml(tmp_path, monkeypatch):
    (tmp_path / "images").mkdir()
    files = save_map(tmp_path, "lab", GRID)
    files["pgm"].rename(tmp_path / "images" / "other.pgm")
    files["yaml"].write_text(files["yaml"].read_text().replace("lab.pgm", "images/other.pgm"))
    monkeypatch.chdir("/")
    assert load_map(files["yaml"]).evidence.any()
    moved = files["yaml"].rename(tmp_path / "lab.yml")
    assert load_map(moved).evidence.any()


def test_each_damage_names_its_file(tmp_path):
    files = save_map(tmp_path, "lab", GRID)
    whole = {kind: path.read_bytes() for kind, path in files.items()}
    files["npz"].write_bytes(whole["npz"][:-10])
    with pytest.raises(UserError, match=r"lab\.npz: not a readable npz"):
        load_map(files["npz"])
    files["pgm"].write_bytes(whole["pgm"][:-1])
    with pytest.raises(UserError, match=r"lab\.pgm: picture: .* truncated"):
        load_map(files["yaml"])
    files["yaml"].write_bytes(whole["yaml"].replace(b"0.05", b"0.0505"))
    files["pgm"].write_bytes(whole["pgm"])
    with pytest.raises(UserError, match=r"lab\.yaml: cell: .* whole number of millimetres"):
        load_map(files["pgm"])
    files["yaml"].write_bytes(whole["yaml"].replace(b"negate", b"nugate"))
    with pytest.raises(UserError, match=r"lab\.yaml: negate: "):
        load_map(files["pgm"])
    files["yaml"].unlink()
    with pytest.raises(UserError, match=r"lab\.pgm: has no lab\.yaml beside it"):
        load_map(files["pgm"])
    with pytest.raises(UserError, match=r"lab\.png: is not a map"):
        load_map(files["png"])
    with pytest.raises(UserError, match=r"lab\.yaml: cannot be read: No such file"):
        load_map(files["yaml"])


@same_folder
@given(st.sampled_from(["npz", "pgm", "yaml", "csv"]), st.binary(max_size=120))
def test_garbage_is_the_users_to_mend(tmp_path, kind, data):
    path = tmp_path / f"map.{kind}"
    (tmp_path / "map.yaml").write_text("image: map.pgm")
    path.write_bytes(data)
    with pytest.raises(UserError):
        load_walls(path) if kind == "csv" else load_map(path)


@same_folder
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 4), min_size=1, max_size=5))
def test_walls_are_read_back(tmp_path, walls):
    path = tmp_path / "walls.csv"
    path.write_text("# true walls, metres\n\n" + "".join(", ".join(map(repr, wall)) + "  # a\n" for wall in walls))
    assert load_walls(path).tolist() == [list(wall) for wall in walls]


@pytest.mark.parametrize("line", ["1,2,3", "1,2,3,4,5", "1,2,3,x", "1 2 3 4", "1,2,3,nan", "1,2,3,inf"])
def test_a_bad_wall_is_named_by_its_line(tmp_path, line):
    path = tmp_path / "walls.csv"
    path.write_text(f"# walls\n0,0,1,1\n{line}\n")
    with pytest.raises(UserError, match=r"walls\.csv:3: expected x1,y1,x2,y2"):
        load_walls(path)


def test_a_file_without_a_wall_is_refused(tmp_path):
    path = tmp_path / "walls.csv"
    path.write_text("# nothing\n")
    with pytest.raises(UserError, match="holds no wall"):
        load_walls(path)


@pytest.mark.recordings
def test_all_public_maps_and_walls_are_read(recordings_dir, tmp_path):
    for path in sorted((recordings_dir / "maps").glob("*.yaml")):
        grid = load_map(path)
        assert load_map(path.with_suffix(".pgm")).digest() == grid.digest()
        assert load_map(save_map(tmp_path, path.stem, grid)["npz"]).digest() == grid.digest()
        assert load_map(tmp_path / path.name).digest() == grid.digest()
    for path in sorted((recordings_dir / "nano_swarm").glob("*/walls.csv")):
        assert len(load_walls(path)) >= 4
