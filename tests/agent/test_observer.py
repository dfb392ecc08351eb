"""The observer's process: what it leaves behind where it cannot begin, or not end well."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.config import resolve
from agent.control import Control
from agent.errors import UserError
from agent.log_tools import describe
from agent.observer import run_observer
from agent.outputs import Outputs
from agent.page_options import PageOptions


@pytest.fixture
def taken() -> Iterator[int]:
    """A port at which somebody else listens."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


@pytest.mark.parametrize("whose", ["the page's", "the observer's own"])
def test_where_a_port_is_taken_no_log_is_begun(taken: int, tmp_path: Path, whose: str) -> None:
    config = resolve({"robots": {"r1": {}}, "observers": {"desk": {}}, "base_port": taken - 1})  # the desk comes second
    page = PageOptions(port=taken) if whose == "the page's" else None
    outputs = Outputs(page=page, record=tmp_path / "run.mcap")
    with pytest.raises(UserError, match="already in use"):
        run_observer(config, None, outputs, Control(), name=None if page else "desk")
    assert list(tmp_path.iterdir()) == []


def test_a_log_is_whole_though_the_map_cannot_be_written(tmp_path: Path) -> None:
    config = resolve({"robots": {"r1": {}}, "transport": "zmq"})
    control = Control()
    control.stop = True
    with pytest.raises(UserError, match="cannot be written"):
        run_observer(config, tmp_path / "gone", Outputs(record=tmp_path / "run.mcap"), control)
    facts = describe(tmp_path / "run.mcap")
    assert facts["torn"] == ""
