"""The command line: help with examples, exit statuses, and one line for whatever a user gets wrong."""

from __future__ import annotations

import gzip
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import typer

from agent import cli

WORLDS = ", ".join(sorted(file.stem for file in (Path(cli.__file__).parent / "worlds").glob("*.yaml")))
GOOD_LINE = "FLASER 2 1.0 2.0 0 0 0 0 0 0 7.5 host 7.5\n"


class Said(NamedTuple):
    """How a command ended."""

    status: int
    out: str
    errors: list[str]


def in_a_terminal(line: str) -> str:
    """A line as it would be there: elsewhere the processes of a swarm write JSON."""
    return f"orion: {json.loads(line)['message']}" if line.startswith("{") else line


@pytest.fixture
def orion(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs a command that ends by itself, in this process; leaves no trace in it."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    interval = sys.getswitchinterval()

    def run(*words: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["orion", *(str(word) for word in words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, errors = capsys.readouterr()
        return Said(int(end.value.code or 0), out, [in_a_terminal(line) for line in errors.splitlines()])

    yield run
    sys.setswitchinterval(interval)
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """An output folder that must not be there in the end."""
    return tmp_path / "out"


@pytest.fixture
def port() -> Iterator[int]:
    """A free port, as far as one can know."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def commands() -> list[list[str]]:
    """All commands, as words."""
    found = []
    ways: list[tuple[list[str], object]] = [([], typer.main.get_command(cli.app))]
    for words, command in ways:
        for name, inner in getattr(command, "commands", {}).items():
            ways.append(([*words, name], inner))
        if not hasattr(command, "commands"):
            found.append(words)
    return found


# Help


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_the_help_of_every_command_has_an_example(orion, words: list[str]) -> None:
    said = orion(*words, "--help")
    assert said.status == 0
    text = " ".join(said.out.split())
    assert "Example" in text
    assert f"orion {' '.join(words)}" in text.partition("Example")[2]


def test_orion_alone_and_its_help_list_the_commands(orion) -> None:
    for said in (orion(), orion("--help"), orion("map")):
        assert said.status in {0, 2}  # typer's choice differs by version where no word is given
    text = orion("--help").out
    assert all(word in text for word in ("demo", "replay", "agent", "observe", "top", "simulate", "doctor", "map"))
    assert "--supervised" not in orion("agent", "--help").out


def test_help_does_not_wait_for_heavy_imports() -> None:
    """0.4 s on two busy cores, most of it Python and typer."""
    heavy = {"numpy", "zenoh", "zmq", "pydantic", "numba", "yaml", "PIL", "msgpack"}
    program = f"import sys, agent.cli; print(*sorted({heavy!r} & sys.modules.keys()))"
    words = [sys.executable, "-c", program]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout.split() == []


# Usage


@pytest.mark.parametrize(
    "words",
    [
        ["dmeo"],
        ["demo", "--fast"],
        ["demo", "--robots", "two"],
        ["demo", "--seed", "-1"],
        ["replay"],
        ["replay", "run.log", "--robots", "0"],
        ["agent"],
        ["agent", "--robot", "r1"],
        ["observe", "extra"],
        ["simulate"],
    ],
    ids=" ".join,
)
def test_a_wrong_command_or_option_is_a_usage_error(orion, words: list[str]) -> None:
    said = orion(*words)
    assert said.status == 2
    assert said.out == ""
    assert any("Usage" in line for line in said.errors)


# Bad input: exactly one line, status 2, and nothing written


def assert_one_line(said: Said, *words: object) -> None:
    assert said.status == 2, said
    assert said.out == ""
    (line,) = said.errors
    assert line.startswith("orion: ")
    for word in words:
        assert str(word) in line


RECORDINGS = {
    "missing.log": (None, "there is no such file"),
    "empty.log": (b"", "the file is empty"),
    "blank.log": (b"\n \n", "the file is empty"),
    "other.log": (b"some text\n", "no FLASER line"),
    "truncated.log": ((GOOD_LINE * 2)[:-9].encode(), "cut off in its last line"),
    "garbled.log": (GOOD_LINE.replace("2.0", "2,0").encode(), "garbled.log:1: a damaged FLASER line"),
    "short.log": (GOOD_LINE.replace("FLASER 2", "FLASER 3").encode(), "short.log:1: a damaged FLASER line"),
    "absurd.log": (GOOD_LINE.replace(" 0 0 0 ", " nan 0 0 ", 1).encode(), "is none of a robot"),
    "binary.log": (bytes(range(256)), "this is no text"),
    "cut.log.gz": (gzip.compress(GOOD_LINE.encode() * 99)[:-20], "the gzip file is cut off"),
    "damaged.log.gz": (gzip.compress(GOOD_LINE.encode() * 99)[:30] + b"x" * 30, "the gzip file is damaged"),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_bad_recording_is_one_line(orion, tmp_path: Path, out: Path, name: str) -> None:
    content, what = RECORDINGS[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert_one_line(orion("replay", tmp_path / name, "--out", out), name, what)
    assert not out.exists()


def test_a_folder_without_scans_is_one_line(orion, tmp_path: Path, out: Path) -> None:
    assert_one_line(orion("replay", tmp_path, "--out", out), "scans.csv", "there is no such file")
    assert not out.exists()


TOMLS = {
    "unknown key": ("sped = 3\n[robots.r1]\n", ["lab.toml", "sped", "is no key"]),
    "nearest key": ("[robots.r1]\nhots = 'a'\n", ["robots.r1.hots", "did you mean host?"]),
    "robot twice": ("[robots.r1]\n[robots.r1]\n", ["lab.toml", "twice"]),
    "start of nan": ("[robots.r1]\nstart = {x = nan}\n", ["robots.r1.start.x", "finite"]),
    "start of inf": ("[robots.r1]\nstart = {yaw_deg = inf}\n", ["robots.r1.start.yaw_deg"]),
    "absurd start": ("[robots.r1]\nstart = {yaw_deg = 1e308}\n", ["robots.r1.start.yaw_deg"]),
    "no TOML": ("[robots.r1\n", ["lab.toml", "is no TOML"]),
    "key of two lines": ('"a\\nb" = 1\n[robots.r1]\n', ["lab.toml", "is no key"]),
}


@pytest.mark.parametrize("name", TOMLS)
@pytest.mark.parametrize(
    "command", [["demo"], ["agent", "--robot", "r1"], ["observe"], ["simulate"]], ids=lambda words: words[0]
)
def test_a_bad_configuration_is_one_line(orion, tmp_path: Path, out: Path, command: list[str], name: str) -> None:
    text, words = TOMLS[name]
    (tmp_path / "lab.toml").write_text(text)
    folder = ["--out", out] if command[0] in {"demo", "observe"} else []
    assert_one_line(orion(*command, "-c", tmp_path / "lab.toml", *folder), *words)
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["demo", "--speed", "fast"], "--speed: is 'fast'; give a positive number, or max"),
        (["demo", "--speed", "nan"], "--speed: is 'nan'"),
        (["demo", "--speed", "0"], "--speed: is '0'"),
        (["demo", "--speed", "inf"], "--speed: is 'inf'"),
        (["demo", "--cell", "0.0205"], "0.0205 m is not a whole number of millimetres"),
        (["demo", "--cell", "nan"], "--cell: cell: input should be a finite number"),
        (["demo", "--robots", "3"], "--robots: is 3, but world 'paper' has 2 starts"),
        (["demo", "--world", "atlantis"], f"world atlantis: there is none of that name; use {WORLDS}, or a YAML"),
        (["demo", "--world", "atlantis.yaml"], "atlantis.yaml: no such file or directory"),
        (
            ["demo", "--radio", "loud"],
            "--radio: radio: input should be 'lan', 'digimesh-1hop', 'digimesh-3hop' or 'digimesh-6hop', got 'loud'",
        ),
        (["demo", "--transport", "pigeon"], "--transport: transport: input should be 'zenoh' or 'zmq'"),
        (["demo", "--publish", "loud"], "--publish: publish: input should be"),
        (["demo", "--base-port", "65535"], "base_port: 65535 leaves no ports for 2 peers"),
        (["demo", "--base-port", "0"], "--base-port: base_port: input should be greater than or equal to 1"),
        (["demo", "-c", "none.toml"], "none.toml: cannot be read: No such file or directory"),
        (["observe", "-c", "none.toml"], "none.toml: cannot be read: No such file or directory"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_bad_option_is_one_line(orion, out: Path, words: list[str], what: str) -> None:
    assert_one_line(orion(*words, "--out", out), what)
    assert not out.exists()


@pytest.mark.parametrize(
    "option", [["--poses", "gps"], ["--max-range", "-1"], ["--max-range", "nan"], ["--cell", "0.004"]]
)
def test_a_bad_option_for_a_recording_is_one_line(orion, tmp_path: Path, out: Path, option: list[str]) -> None:
    (tmp_path / "run.log").write_text(GOOD_LINE)
    assert_one_line(orion("replay", tmp_path / "run.log", *option, "--out", out))
    assert not out.exists()


def test_an_occupied_port_is_one_line_before_anything_is_written(orion, tmp_path: Path, out: Path) -> None:
    with socket.socket() as somebody:
        somebody.bind(("127.0.0.1", 0))
        somebody.listen()
        taken = somebody.getsockname()[1]
        said = orion("demo", "--base-port", taken, "--out", out)
        assert_one_line(said, f"robots.r1: 127.0.0.1:{taken}: address already in use")
        assert not out.exists()
        (tmp_path / "run.log").write_text(GOOD_LINE)
        body = 'body = {kind = "recording", path = "run.log"}'
        (tmp_path / "lab.toml").write_text(f"base_port = {taken}\n[robots.r1]\n{body}\n")
        said = orion("agent", "-c", tmp_path / "lab.toml", "--robot", "r1")
        assert_one_line(said, f"robots.r1: 127.0.0.1:{taken}: address already in use")


@pytest.mark.parametrize("command", ["demo", "observe"])
def test_a_folder_below_a_file_is_one_line(orion, tmp_path: Path, port: int, command: str) -> None:
    """Root may write everywhere, but not below a file."""
    (tmp_path / "file").write_text("I am no folder")
    (tmp_path / "lab.toml").write_text(f"base_port = {port}\n[robots.r1]\n")
    said = orion(command, "-c", tmp_path / "lab.toml", "--out", tmp_path / "file" / "out")
    assert_one_line(said, "file/out: is no folder to write to: Not a directory")
    assert (tmp_path / "file").read_text() == "I am no folder"


def test_a_robot_that_is_not_in_the_roster_is_one_line(orion, tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text("[robots.r1]\n[robots.r2]\n")
    said = orion("agent", "-c", tmp_path / "lab.toml", "--robot", "r3")
    assert_one_line(said, "--robot: 'r3' is not in the roster; robots there are: r1, r2")


def test_an_agents_bad_body_is_one_line(orion, tmp_path: Path, port: int) -> None:
    (tmp_path / "run.log").write_text(GOOD_LINE)
    for body, what in {
        'kind = "recording", path = "none.log"': "none.log: there is no such file",
        'kind = "recording", path = "run.log", robot = 1': "run.log: has 1 robots",
        'kind = "recording", path = "run.log", part = 2': "part 2 of 1",
        'kind = "serial", port = "nonsense://1"': "robots.r1.body.port: ",
    }.items():
        (tmp_path / "lab.toml").write_text(f"base_port = {port}\n[robots.r1]\nbody = {{{body}}}\n")
        assert_one_line(orion("agent", "-c", tmp_path / "lab.toml", "--robot", "r1"), what)


def test_an_observer_of_nobody_is_told_so(orion, out: Path) -> None:
    """It once listened to nothing until it was interrupted."""
    assert_one_line(orion("observe"), "robots: none in the configuration, so there is nobody to observe")


@pytest.mark.processes
def test_what_only_a_process_finds_out_is_one_line_and_leaves_the_last_map_alone(
    orion, tmp_path: Path, out: Path, port: int
) -> None:
    """The observer once wrote its empty map over the last one, and the new configuration stood beside it."""
    out.mkdir()
    before = {"map.png": b"the last map", "r1.tty": b"a file of that name"}
    for name, content in before.items():
        (out / name).write_bytes(content)
    said = orion("demo", "--robots", 1, "--base-port", port, "--out", out)
    assert_one_line(said, "r1.tty: is a file, and a robot's port is to have that name; move it away")
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.processes
def test_a_refused_command_to_a_supervised_process_is_told_in_json(orion, tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text("[robots.r1]\n")
    words = [sys.executable, "-m", "agent", "agent", "-c", str(tmp_path / "lab.toml"), "--robot", "r9", "--supervised"]
    ended = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.PIPE, check=False)
    assert ended.returncode == 2
    assert ended.stderr == ""
    assert ended.stdout.startswith('{"event": "error", "where": "--robot", ')
