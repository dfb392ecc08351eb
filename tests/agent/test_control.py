"""Orders to a process: from a terminal's signals, and from the standard input of one that was started."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from agent.control import Control, Supervised


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline


@pytest.fixture
def signals() -> Iterator[None]:
    """Gives the signals' handlers back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def starter(monkeypatch: pytest.MonkeyPatch) -> Iterator[io.TextIOBase]:
    """The other end of our standard input."""
    reading, writing = os.pipe()
    with open(reading) as stdin, open(writing, "w", buffering=1) as other_end:  # noqa: PTH123 - descriptors
        monkeypatch.setattr(sys, "stdin", stdin)
        yield other_end


# In a terminal


def status(*, around: int = 0, **apart: str) -> dict[str, object]:
    return {"around": around, "apart": apart, "done": True, "positions": {}}


def test_a_person_is_told_when_a_robot_is_done_and_never_that_an_observer_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    robot, observer = Control(), Control()
    for done in (False, False, True, True, False, True):
        robot.tell("status", **status() | {"done": done})
        observer.tell("status", **status())
    told = "orion: it is done, and all of it is published; it stays in the swarm until Ctrl-C"
    assert capsys.readouterr().err.splitlines() == [told, told]


def test_a_process_in_a_terminal_goes_at_once_and_tells_a_person_what_is_new(
    capsys: pytest.CaptureFixture[str],
) -> None:
    control = Control()
    assert (control.go, control.stop, control.kernel) == (True, False, False)
    control.tell("ready", name="r1")
    control.tell("status", **status())
    control.tell("status", **status(around=1))
    control.tell("status", **status(around=1, a1="r2: cell size 0.05 m, ours is 0.02 m"))
    control.tell("status", **status(around=2, a1="r2: cell size 0.05 m, ours is 0.02 m", b2="r3: no start pose"))
    control.tell("status", **status(around=2, b2="r3: replaced by c3"))
    control.tell("report", map_digest="00")
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "orion: r1 is ready; Ctrl-C ends it",
        "orion: 1 other peer",
        "orion: session a1 of r2: cell size 0.05 m, ours is 0.02 m",
        "orion: session b2 of r3: no start pose",
        "orion: 2 other peers",
        "orion: session b2 of r3: replaced by c3",
        "orion: session a1 of r2: all is well again",
    ]


def test_a_person_is_told_what_is_wrong_with_the_robot_once_until_it_is_something_else(
    capsys: pytest.CaptureFixture[str],
) -> None:
    control = Control()
    for trouble in ("", "it is not connected", "it is not connected", "", "it is not connected", "it waits", ""):
        control.tell("status", around=0, body=trouble)
    assert capsys.readouterr().err.splitlines() == ["orion: it is not connected", "orion: it waits"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures("signals")
def test_the_first_signal_stops_it_cleanly_and_the_second_at_once(number: signal.Signals) -> None:
    control = Control()
    control.obey_signals()
    signal.raise_signal(number)
    assert control.stop
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)


# Started by another


def test_a_supervised_process_waits_for_the_word(starter) -> None:
    control = Supervised()
    assert (control.go, control.stop, control.kernel) == (False, False, False)
    starter.write("kernel\n")
    until(lambda: control.kernel)
    assert not control.go
    starter.write("go\n")
    until(lambda: control.go)
    assert not control.stop
    starter.write("finish\n")
    until(lambda: control.stop)


def test_words_that_mean_nothing_change_nothing(starter) -> None:
    control = Supervised()
    starter.write("\nGO\nstop\nümlaut\ngo on\n kernel \n")
    until(lambda: control.kernel)
    assert (control.go, control.stop) == (False, False)


def test_a_supervised_process_stops_when_its_starter_is_gone(starter) -> None:
    control = Supervised()
    starter.close()
    until(lambda: control.stop)
    assert not control.go


def test_a_supervised_process_tells_in_lines_of_json(starter, capsys: pytest.CaptureFixture[str]) -> None:
    control = Supervised()
    control.tell("ready")
    control.tell("status", positions={"00ff": 3}, refused=["räume"])
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines == [{"event": "ready"}, {"event": "status", "positions": {"00ff": 3}, "refused": ["räume"]}]
    starter.close()
    until(lambda: control.stop)


@pytest.mark.parametrize("trouble", [BrokenPipeError(), ValueError("closed")])
def test_telling_somebody_who_is_gone_means_to_stop(starter, monkeypatch: pytest.MonkeyPatch, trouble) -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise trouble

    control = Supervised()
    monkeypatch.setattr(sys, "stdout", Gone())
    control.tell("ready")
    assert control.stop
    starter.close()
