"""The doctor at a robot's line: what is well is said to be well, and each thing that can be wrong has its own words."""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import pytest

from agent.doctor_link import Heard, judge, link, listen
from agent.finding import Finding, worst
from agent.kinematics import ORION_CHASSIS
from agent.microcontroller import Microcontroller
from agent.simulator import Simulator
from agent.world import load_world
from mapping.sensor import orion
from transport.mcu_frames import RANGE_INVALID, Drive, Heartbeat, Range, Sample
from transport.mcu_link import McuLink
from transport.mcu_port import McuPort

PERIOD_MS = 20


class Robot:
    """A simulated microcontroller on a thread of its own, which stands still in the paper's first space."""

    def __init__(self, port: McuPort) -> None:
        self.port = port
        self.drives: list[Drive] = []
        self._simulator = Simulator(load_world("paper"), 1, 1, orion(), period=PERIOD_MS / 1000)
        self.mcu = Microcontroller(0, orion(), ORION_CHASSIS, PERIOD_MS)

    def turn(self, number: int) -> None:
        """Everything that a period brings."""
        for frame in self.port.receive():
            if isinstance(frame, Drive):
                self.drives.append(frame)
            for answer in self.mcu.hear(frame, self._simulator.now_ms):
                self.port.send(answer)
        self._simulator.advance(self._simulator.now_ms + PERIOD_MS)
        self.port.send(self.mcu.sample(self._simulator.sense()))
        if number % 5 == 0:
            self.port.send(self.mcu.beat(self.port.counters))


@contextmanager
def turning(turn: Callable[[int], object]) -> Iterator[None]:
    """Calls it on a thread, once a period."""
    end = threading.Event()

    def run() -> None:
        number = 0
        while not end.wait(PERIOD_MS / 1000):
            turn(number)
            number += 1

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


@pytest.fixture
def port() -> Iterator[McuPort]:
    with McuPort.open_pty() as port:
        yield port


@pytest.fixture(scope="module")
def heard() -> Heard:
    """What a healthy robot says, heard over a real pseudo-terminal."""
    with ExitStack() as stack:
        robot = Robot(stack.enter_context(McuPort.open_pty()))
        stack.enter_context(turning(robot.turn))
        heard = listen(robot.port.path, 115_200, patience=10.0, seconds=0.3)
        assert all((drive.left_mm_s, drive.right_mm_s) == (0, 0) for drive in robot.drives), "a wheel was to turn"
        assert robot.drives, "it was not even told to stop"
    return heard


def findings(heard: Heard) -> list[Finding]:
    return list(judge("tty", 115_200, heard))


def the_one(found: list[Finding]) -> Finding:
    """The one finding that is not well."""
    (finding,) = [it for it in found if it.verdict != "ok"]
    assert finding.remedy
    return finding


def steady(heard: Heard) -> Heard:
    """The same with the machine's own haste and waiting taken out of it."""
    counters = heard.counters | {"late": 0}
    return replace(heard, seconds=len(heard.samples) * PERIOD_MS / 1000, counters=Counter(counters))


def test_of_a_healthy_robot_all_is_well(heard) -> None:
    found = findings(steady(heard))
    assert worst(found) == "ok", found
    text = "\n".join(it.found for it in found)
    assert "firmware 1; 5 beams at -90, -45, 0, 45, 90 degrees, up to 0.8 m" in text
    assert f"a sample each {PERIOD_MS} ms" in text
    assert f"stamped {PERIOD_MS} ms apart" in text
    assert "wheels stand still" in text
    assert "it hears us: " in text
    assert sum("beam" in it.found and "valid" in it.found for it in found) == 5


# A real line on which something is wrong


def test_a_port_that_is_not_there_is_told_at_once(tmp_path) -> None:
    finding = the_one(list(link(str(tmp_path / "ttyACM0"), 115_200)))
    assert finding.verdict == "problem"
    assert "No such file" in finding.found
    assert "/dev/serial/by-id" in finding.remedy


def test_a_link_that_a_killed_simulation_left_behind_is_recognised(tmp_path) -> None:
    (tmp_path / "r1.tty").symlink_to(tmp_path / "gone")
    assert "orion simulate" in the_one(list(link(str(tmp_path / "r1.tty"), 115_200))).remedy


def test_a_port_without_rights_names_the_group(monkeypatch, port) -> None:
    """Permissions do not bind root, as which tests may run: the system call is made to say no."""
    opened = os.open

    def denied(path: str, *args: int, **more: int) -> int:
        if path == port.path:
            raise PermissionError(13, "Permission denied", path)
        return opened(path, *args, **more)

    monkeypatch.setattr(os, "open", denied)
    finding = the_one(list(link(port.path, 115_200)))
    assert finding.verdict == "problem"
    assert "dialout" in finding.remedy


def test_a_port_in_use_is_not_shared(port) -> None:
    robot = Robot(port)
    with turning(robot.turn), McuLink(port.path) as other:
        other.receive(5.0)  # until it is open
        finding = the_one(list(link(port.path, 115_200)))
    assert "end the robot's agent" in finding.remedy


def test_a_silent_port_opens_and_says_nothing(port) -> None:
    heard = listen(port.path, 115_200, patience=0.3)
    assert heard.opened
    finding = the_one(findings(heard))
    assert (finding.verdict, "nothing comes" in finding.found) == ("problem", True)


def test_a_port_that_talks_garbage_has_perhaps_another_baud_rate(port) -> None:
    with turning(lambda number: port.write(b"NMEA, $GPGGA\0" * 5)):
        heard = listen(port.path, 9600, patience=0.5)
    finding = the_one(list(judge(port.path, 9600, heard)))
    assert finding.verdict == "problem"
    assert "at 9600 baud, and not a whole one" in finding.found
    assert "baud rate" in finding.remedy


def test_a_line_that_gives_back_what_we_say_is_bridged() -> None:
    finding = the_one(findings(listen("loop://", 115_200, patience=1.0)))
    assert (finding.verdict, "bridged" in finding.remedy) == ("problem", True)


def test_a_port_of_an_unknown_kind_is_a_problem_and_no_crash() -> None:
    assert the_one(list(link("carrier-pigeon://roof", 115_200))).verdict == "problem"


def test_samples_without_a_hello_are_told_apart_from_silence(port) -> None:
    robot = Robot(port)

    def deaf(number: int) -> None:
        port.send(robot.mcu.sample(robot._simulator.sense()))

    with turning(deaf):
        heard = listen(port.path, 115_200, patience=1.0)
    finding = the_one(findings(heard))
    assert "and no hello" in finding.found
    assert "asks for a hello" in finding.remedy


# What else can be wrong with a robot, from what a healthy one said


def with_samples(heard: Heard, change: Callable[[int, Sample], Sample]) -> Heard:
    return replace(steady(heard), samples=[change(k, sample) for k, sample in enumerate(heard.samples)])


def test_a_dead_beam_is_named(heard) -> None:
    def dead(number: int, sample: Sample) -> Sample:
        return replace(sample, ranges=(*sample.ranges[:3], Range(0, RANGE_INVALID), *sample.ranges[4:]))

    finding = the_one(findings(with_samples(heard, dead)))
    assert finding.verdict == "warning"
    assert "beam 3 at 45 degrees: 0 valid" in finding.found


def test_a_stale_heading_is_counted(heard) -> None:
    stale = with_samples(heard, lambda k, sample: replace(sample, heading_valid=int(k > 1)))
    assert "stale in 2 of" in the_one(findings(stale)).found
    none = with_samples(heard, lambda k, sample: replace(sample, heading_valid=0))
    assert "no sample has a valid heading" in the_one(findings(none)).found


def test_a_heading_around_zero_is_averaged_on_the_circle(heard) -> None:
    north = with_samples(heard, lambda k, sample: replace(sample, heading_turn16=(-182, 182)[k % 2] % 65536))
    (found,) = [it.found for it in findings(north) if it.found.startswith("heading")]
    spread = float(found.partition("within ")[2])
    assert spread < 3  # and not 180


def test_wheels_that_turn_though_told_to_stop_are_told_across_the_counters_wrap(heard) -> None:
    moving = with_samples(heard, lambda k, sample: replace(sample, left_ticks=(2**31 - 1) if k == 0 else -(2**31)))
    assert "turned by 1 and 0 ticks" in the_one(findings(moving)).found


def test_ranges_that_do_not_fit_the_hello_are_a_problem(heard) -> None:
    cut = with_samples(heard, lambda k, sample: replace(sample, ranges=sample.ranges[:4]))
    finding = the_one(findings(cut))
    assert (finding.verdict, "samples of 4 ranges, its hello has 5 beams" in finding.found) == ("problem", True)


def test_samples_at_another_rate_than_the_hello_says(heard) -> None:
    hello = replace(heard.hello, sample_period_ms=50)
    assert "its hello says 50" in the_one(findings(replace(steady(heard), hello=hello))).found


def test_a_clock_at_another_speed_is_told(heard) -> None:
    fast = steady(heard)
    assert "as fast as ours" in the_one(findings(replace(fast, seconds=fast.seconds / 10))).found


@pytest.mark.parametrize("name", ["damaged", "lost", "late", "restarts", "unknown_kind"])
def test_what_the_line_does_to_frames_is_a_warning(heard, name: str) -> None:
    counters = Counter(steady(heard).counters)
    counters[name] += 3
    finding = the_one(findings(replace(steady(heard), counters=counters)))
    assert finding.verdict == "warning"
    assert "3 " in finding.found


def test_a_robot_that_does_not_hear_us_is_a_problem(heard) -> None:
    deaf = [Heartbeat(0, 0, 5, 0), Heartbeat(1, 0, 5, 0)]
    assert the_one(findings(replace(steady(heard), heartbeats=deaf))).verdict == "problem"
    mute = the_one(findings(replace(steady(heard), heartbeats=[])))
    assert (mute.verdict, mute.found) == ("warning", "it sends no heartbeat")
    noisy = [Heartbeat(0, 0, 5, 0), Heartbeat(1, 0, 8, 2)]
    assert "2 damaged" in the_one(findings(replace(steady(heard), heartbeats=noisy))).found


def test_a_hello_that_describes_no_robot_is_a_problem(heard) -> None:
    blind = replace(steady(heard), hello=replace(heard.hello, beams=()), samples=[])
    verdicts = {it.found.partition(":")[0]: it.verdict for it in findings(blind)}
    assert verdicts["its hello makes no sense"] == "problem"


def test_an_uncalibrated_compass_is_a_warning(heard) -> None:
    hello = replace(heard.hello, heading_calibration=0)
    assert "calibrated 0 of 3" in the_one(findings(replace(steady(heard), hello=hello))).found


def test_a_cable_that_is_pulled_while_we_listen_is_told(port) -> None:
    robot = Robot(port)

    def pulled(number: int) -> None:
        if number < 10 or not robot.drives:
            robot.turn(number)
        else:
            port.close()

    with turning(pulled):
        heard = listen(port.path, 115_200, patience=10.0, seconds=10.0)
    assert heard.reason
    assert worst(findings(heard)) == "problem"
