"""What a shell completes on Tab, asked as bash asks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from agent import cli, completion
from agent.config import Config, RecordedBody
from agent.news import Form
from agent.packaged_worlds import world_names
from swarm.radio import PROFILES


@pytest.fixture
def tab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """The words that a line may go on with; an empty last word is one that has not been begun."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["orion"])

    def press(line: str) -> list[str]:
        monkeypatch.setenv("_ORION_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, errors = capsys.readouterr()
        assert (end.value.code, errors) == (0, "")
        return out.split()

    return press


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("orion to", ["top"]),
        ("orion map d", ["diff"]),
        ("orion demo --transport ", ["zenoh", "zmq"]),
        ("orion replay --transport zm", ["zmq"]),
        ("orion demo --world r", [name for name in world_names() if name.startswith("r")]),
        ("orion demo --radio digimesh-3", ["digimesh-3hop"]),
        ("orion demo --publish s", ["scans"]),
        ("orion demo --speed ", ["max"]),
        ("orion replay --poses o", ["odometry"]),
        ("orion agent --log ", [str(form) for form in Form]),
        ("orion agent -c lab.toml --robot ", ["r1", "r2", "scout"]),
        ("orion agent -c lab.toml --robot s", ["scout"]),
        ("orion start-pose -c lab.toml s", ["scout"]),
        ("orion evict -c lab.toml r", ["r1", "r2"]),
        ("orion agent -c none.toml --robot ", []),
        ("orion agent -c wrong.toml --robot ", []),
        ("orion agent --robot ", []),
    ],
)
def test_bash_is_told_how_a_line_may_go_on(tab, tmp_path: Path, line: str, words: list[str]) -> None:
    (tmp_path / "lab.toml").write_text("[robots.r1]\n[robots.r2]\n[robots.scout]\n")
    (tmp_path / "wrong.toml").write_bytes(b"robots = 3\n\xff")
    assert tab(line) == words


def test_options_are_completed_too(tab) -> None:
    assert {"--transport", "--world", "--radio"} <= set(tab("orion demo --"))
    assert "--supervised" not in tab("orion agent --")


def test_values_are_those_that_the_configuration_takes() -> None:
    assert get_args(Config.model_fields["transport"].annotation) == completion.TRANSPORTS
    assert get_args(Config.model_fields["radio"].annotation) == tuple(PROFILES) == completion.RADIOS
    assert get_args(Config.model_fields["publish"].annotation) == completion.FORMS
    assert get_args(get_args(RecordedBody.model_fields["poses"].annotation)[0]) == completion.POSES


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_to_be_installed_asks_us(shell: str, tmp_path: Path) -> None:
    environment = {**os.environ, "HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    program = "import sys; sys.argv[0] = 'orion'; from agent.cli import main; main()"
    words = [sys.executable, "-c", program, "--show-completion", shell]
    script = subprocess.run(words, env=environment, capture_output=True, text=True, check=True, timeout=60).stdout
    assert "_ORION_COMPLETE" in script
    checker = shutil.which(shell)
    if checker is not None:
        subprocess.run([checker, "-n"], input=script, text=True, check=True, timeout=60)
