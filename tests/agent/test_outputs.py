"""What is kept of a run: said to ``orion observe`` in its own options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import typer

from agent import cli, observer
from agent.outputs import Outputs
from agent.page_options import PageOptions


@pytest.mark.parametrize(
    "outputs",
    [
        Outputs(),
        Outputs(PageOptions("::1", 9000)),
        Outputs(record=Path("/tmp/run.mcap"), scans=Path("/tmp/scans.npz"), state=Path("/tmp/state")),
        Outputs(ros2="tcp/192.168.1.5:7447"),
    ],
)
def test_what_is_said_to_observe_is_understood_by_it(outputs: Outputs, monkeypatch: pytest.MonkeyPatch) -> None:
    understood: list[Outputs] = []

    def run(config: Any, out: Any, given: Outputs, control: Any, name: Any) -> dict[str, Any]:
        understood.append(given)
        return {}

    monkeypatch.setattr(observer, "run_observer", run)
    monkeypatch.setattr(cli, "_work", lambda work, **options: work(None))
    typer.main.get_command(cli.app).main(["observe", *outputs.arguments()], standalone_mode=False)
    assert understood == [outputs]


def test_files_are_named_wherever_the_process_is_started() -> None:
    words = Outputs(record=Path("run.mcap")).arguments()
    assert words[words.index("--record") + 1] == str(Path.cwd() / "run.mcap")
