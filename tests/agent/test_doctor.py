"""``orion doctor``: what is looked at for which words, how it is said, and how it ends."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from agent import cli, doctor_link, doctor_machine
from agent.config import resolve
from agent.doctor import examine
from agent.finding import ok, problem, warning


@pytest.fixture
def asked(monkeypatch) -> list[tuple[str, int]]:
    """The ports that were tested, instead of testing them."""
    ports: list[tuple[str, int]] = []

    def link(port: str, baudrate: int):
        ports.append((port, baudrate))
        yield ok(port, "fine")

    monkeypatch.setattr(doctor_link, "link", link)
    monkeypatch.setattr(doctor_machine, "machine", lambda folder: iter([ok("machine", str(folder))]))
    return ports


CONFIG = resolve(
    {
        "base_port": 22450,
        "robots": {
            "r1": {"body": {"kind": "serial", "port": "/dev/ttyACM0", "baudrate": 921_600}},
            "r2": {"host": "192.0.2.1", "body": {"kind": "serial", "port": "/dev/ttyACM1"}},
            "r3": {"body": {"kind": "recording", "path": "run.log"}},
        },
    }
)


def test_a_configuration_tests_the_serial_ports_of_this_machine(asked, tmp_path) -> None:
    subjects = [finding.subject for finding in examine(None, CONFIG, tmp_path)]
    networks = ["r1 127.0.0.1:22450", "r2 192.0.2.1:22451", "r3 127.0.0.1:22452"]
    assert subjects == ["machine", *networks, "/dev/ttyACM0"]
    assert asked == [("/dev/ttyACM0", 921_600)]


def test_a_port_is_tested_alone_and_at_the_rate_that_is_known_of_it(asked, tmp_path) -> None:
    assert [finding.subject for finding in examine("/dev/x", None, tmp_path)] == ["/dev/x"]
    assert [finding.subject for finding in examine("/dev/ttyACM0", CONFIG, tmp_path)][-1] == "/dev/ttyACM0"
    assert [finding.subject for finding in examine("/dev/x", None, tmp_path, 9600)] == ["/dev/x"]
    assert asked == [("/dev/x", 115_200), ("/dev/ttyACM0", 921_600), ("/dev/x", 9600)]


def run(monkeypatch, capsys, *words: str) -> tuple[int, str]:
    monkeypatch.setattr(sys, "argv", ["orion", "doctor", *words])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0), capsys.readouterr().out


@pytest.mark.parametrize(
    ("finding", "status"), [(ok("a", "b"), 0), (warning("a", "b", "c"), 0), (problem("a", "b", "c"), 1)]
)
def test_the_status_tells_of_problems_alone(monkeypatch, capsys, finding, status: int) -> None:
    monkeypatch.setattr(doctor_link, "link", lambda port, baudrate: iter([finding]))
    ended, out = run(monkeypatch, capsys, "/dev/x")
    assert ended == status
    assert out.split()[0] == finding.verdict
    assert out.count("\n") == 1
    ended, out = run(monkeypatch, capsys, "/dev/x", "--json")
    assert ended == status
    assert json.loads(out) == {"verdict": finding.verdict, "findings": [finding._asdict()]}


def test_a_bad_configuration_is_a_usage_error(monkeypatch, capsys, tmp_path: Path) -> None:
    assert run(monkeypatch, capsys, "-c", str(tmp_path / "none.toml"))[0] == 2
    assert run(monkeypatch, capsys, "/dev/x", "--baudrate", "fast")[0] == 2


def test_what_a_port_says_cannot_order_the_terminal_about(monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor_link, "link", lambda port, baudrate: iter([ok(port, "fine")]))
    _, out = run(monkeypatch, capsys, "/dev/\x1b[2J")
    assert "\x1b" not in out
