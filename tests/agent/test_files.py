import os
import stat

import pytest

from agent.errors import UserError
from agent.files import prepare_folder, read_bytes, write_whole


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_written_and_replaced_and_nothing_stays_beside_it(tmp_path):
    path = tmp_path / "map.npz"
    write_whole(path, b"old")
    write_whole(path, b"new")
    assert read_bytes(path) == b"new"
    assert names(tmp_path) == ["map.npz"]


def test_a_file_gets_the_usual_permissions(tmp_path):
    write_whole(tmp_path / "ours", b"")
    (tmp_path / "theirs").touch()
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "theirs")}
    assert len(modes) == 1


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, step, error):
    path = tmp_path / "map.npz"
    write_whole(path, b"old")

    def fails(*_):
        raise error

    monkeypatch.setattr(*((os, "fsync") if step == "fsync" else (type(path), "replace")), fails)
    expected = UserError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["map.npz"]


def test_what_cannot_be_written_is_the_users_to_mend(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    for path in (tmp_path / "missing" / "a", tmp_path / "folder", tmp_path / "file" / "a", tmp_path / "zero\0byte"):
        with pytest.raises(UserError, match="cannot be written"):
            write_whole(path, b"")
    assert names(tmp_path) == ["file", "folder"]


def test_a_folder_is_made_with_its_parents_and_left_empty(tmp_path):
    folder = prepare_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert folder.is_absolute()
    assert names(folder) == []
    assert prepare_folder(folder) == folder


def test_a_folder_that_cannot_be_written_is_found_out_at_once(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "a", tmp_path / "zero\0byte"):
        with pytest.raises(UserError, match="is no folder to write to"):
            prepare_folder(path)

    def refuses(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(tmp_path), "touch", refuses)
    with pytest.raises(UserError, match="is no folder to write to: Permission denied; choose another"):
        prepare_folder(tmp_path)


def test_what_cannot_be_read_is_the_users_to_mend(tmp_path):
    for path in (tmp_path, tmp_path / "missing", tmp_path / "zero\0byte"):
        with pytest.raises(UserError, match="cannot be read"):
            read_bytes(path)
