"""Links to pseudo-terminals: there as long as the ports are, and never over a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.errors import UserError
from agent.mcu_ports import McuPorts


def test_each_robot_has_a_port_under_its_name(tmp_path: Path) -> None:
    with McuPorts(tmp_path, ["r1", "r2"]) as ports:
        assert list(ports.links) == ["r1", "r2"]
        for robot, port in zip(("r1", "r2"), ports.ports, strict=True):
            assert (tmp_path / f"{robot}.tty").is_char_device()
            assert str((tmp_path / f"{robot}.tty").readlink()) == port.path
    assert list(tmp_path.iterdir()) == []


def test_links_that_a_killed_run_left_are_replaced(tmp_path: Path) -> None:
    (tmp_path / "r1.tty").symlink_to("/dev/pts/never")
    with McuPorts(tmp_path, ["r1"]):
        assert (tmp_path / "r1.tty").is_char_device()


def test_a_later_runs_link_is_left_alone(tmp_path: Path) -> None:
    with McuPorts(tmp_path, ["r1"]):
        (tmp_path / "r1.tty").unlink()
        (tmp_path / "r1.tty").symlink_to("/dev/null")
    assert str((tmp_path / "r1.tty").readlink()) == "/dev/null"


def test_a_file_is_not_overwritten_and_nothing_is_left_behind(tmp_path: Path) -> None:
    (tmp_path / "r2.tty").write_text("precious")
    with pytest.raises(UserError, match=r"r2\.tty: is a file.*move it away"), McuPorts(tmp_path, ["r1", "r2"]):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["r2.tty"]
    assert (tmp_path / "r2.tty").read_text() == "precious"


def test_a_missing_folder_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be made"), McuPorts(tmp_path / "nowhere", ["r1"]):
        pass
