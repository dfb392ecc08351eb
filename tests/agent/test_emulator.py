"""Robots behind pseudo-terminals: real frames over a real port, in lock-step and in real time, under a fake clock."""

from __future__ import annotations

import json
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from agent.config import Config, load, resolve
from agent.control import Control
from agent.emulator import Emulator, run_simulation
from agent.errors import UserError
from agent.kinematics import ORION_CHASSIS
from agent.mcu_ports import McuPorts
from agent.microcontroller import Microcontroller
from agent.pace import PATIENCE, LockStep, Pace, RealTime
from agent.senses import NO_NOISE, ORION_NOISE, Noise
from agent.simulator import Simulator
from agent.world import World
from mapping.pose import Pose
from mapping.sensor import orion
from transport.framing import Deframer, wrap
from transport.mcu_frames import Drive, Frame, Heartbeat, Hello, Sample, decode, encode

ROOM = World(
    "room",
    np.array([[-2, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]], dtype=np.float64),
    (Pose(-0.5, 0.0, 0.0), Pose(0.5, 0.0, 1.0)),
    (),
)


class Computer:
    """A robot's computer, with nothing but pyserial and the frames."""

    def __init__(self, port: str) -> None:
        self.serial = serial.Serial(port, timeout=0, exclusive=True)
        self._deframer = Deframer()
        self.samples: list[Sample] = []

    def hear(self) -> list[Frame]:
        """All that has come; a terminal gives what was written to it at once."""
        frames = []
        while select.select([self.serial], [], [], 0)[0] and (chunk := self.serial.read(4096)):
            frames += [decode(content) for content in self._deframer.feed(chunk)]
        self.samples += [frame for frame in frames if isinstance(frame, Sample)]
        return frames

    def say(self, frame: Frame) -> None:
        self.serial.write(wrap(encode(frame)))

    def drive(self, left: int, right: int, *, valid_ms: int = 300) -> None:
        self.say(Drive(self.samples[-1].sequence if self.samples else 0, left, right, valid_ms))

    def close(self) -> None:
        self.serial.close()


class Bench:
    """Two robots in a room and a clock that only we move."""

    def __init__(self, folder: Path, stack: ExitStack, pace: Pace, noise: Noise) -> None:
        self.simulator = Simulator(ROOM, 1, 2, orion(), noise=noise)
        self.ports = stack.enter_context(McuPorts(folder, ["r1", "r2"]))
        robots = [Microcontroller(k, orion(), ORION_CHASSIS, 100) for k in range(2)]
        self.emulator = Emulator(self.simulator, robots, self.ports.ports, pace)
        self.now = 1000.0
        self._stack = stack

    def computer(self, robot: str) -> Computer:
        computer = Computer(str(self.ports.links[robot]))
        self._stack.callback(computer.close)
        return computer

    def work(self, seconds: float = 0.0, *, go: bool = True) -> None:
        self.now += seconds
        self.emulator.work(self.now, go=go)


@contextmanager
def bench(folder: Path, pace: Pace, noise: Noise = NO_NOISE) -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(folder, stack, pace, noise)


# Frames


def test_it_says_hello_when_asked(tmp_path: Path) -> None:
    with bench(tmp_path, LockStep()) as it:
        computer = it.computer("r1")
        computer.say(Heartbeat(0, 1, 0, 0))
        it.work(go=False)
        hello = next(frame for frame in computer.hear() if isinstance(frame, Hello))
        assert len(hello.beams) == 5


def test_it_says_hello_when_it_starts(tmp_path: Path) -> None:
    """To whoever has the port open already; no second hello comes unasked, for that would mean another start."""
    with ExitStack() as stack:
        ports = stack.enter_context(McuPorts(tmp_path, ["r1"]))
        computer = Computer(str(ports.links["r1"]))
        stack.callback(computer.close)
        robot = Microcontroller(0, orion(), ORION_CHASSIS, 100)
        emulator = Emulator(Simulator(ROOM, 1, 1, orion()), [robot], ports.ports, LockStep())
        assert computer.hear() == [robot.hello]
        for now in range(5):
            emulator.work(float(now), go=True)
        assert not any(isinstance(frame, Hello) for frame in computer.hear())


def test_samples_come_at_their_period_and_tell_of_the_world(tmp_path: Path) -> None:
    with bench(tmp_path, RealTime(1.0)) as it:
        computer = it.computer("r1")
        for _ in range(51):
            it.work(0.01)
        computer.hear()
        assert [sample.stamp_ms for sample in computer.samples] == [0, 100, 200, 300, 400, 500]
        assert [sample.sequence for sample in computer.samples] == [0, 1, 2, 3, 4, 5]
        front = computer.samples[0].ranges[2]
        assert (front.range_mm, front.status) == (0, 1)  # the other robot stands 1 m away, and 0.8 m are seen


def test_heartbeats_come_once_a_second_even_while_time_stands_still(tmp_path: Path) -> None:
    with bench(tmp_path, LockStep()) as it:
        computer = it.computer("r1")
        beats: list[Frame] = []
        for _ in range(31):
            it.work(0.1, go=False)
            beats += [frame for frame in computer.hear() if isinstance(frame, Heartbeat)]
        assert [beat.sequence for beat in beats if isinstance(beat, Heartbeat)] == [0, 1, 2, 3]
        assert it.simulator.now_ms == 0


def test_heartbeats_tell_what_the_line_did(tmp_path: Path) -> None:
    with bench(tmp_path, LockStep()) as it:
        computer = it.computer("r1")
        computer.drive(0, 0)
        computer.serial.write(b"rubbish\0")
        it.work()
        beat = next(frame for frame in computer.hear() if isinstance(frame, Heartbeat))
        assert (beat.good, beat.damaged) == (1, 1)


# Obedience


def test_wheels_turn_when_told_and_the_others_do_not(tmp_path: Path) -> None:
    with bench(tmp_path, RealTime(1.0)) as it:
        computer = it.computer("r1")
        for _ in range(101):
            computer.hear()
            computer.drive(100, 100)
            it.work(0.01)
        assert it.simulator.poses[0, 0] == pytest.approx(-0.5 + 0.1, abs=0.01)
        assert it.simulator.poses[1].tolist() == [0.5, 0.0, 1.0]


def test_wheels_stop_by_themselves_when_nothing_more_comes(tmp_path: Path) -> None:
    """One command of 300 ms, then silence: 3 cm, whatever the motor's lag (it also runs down)."""
    with bench(tmp_path, RealTime(1.0)) as it:
        computer = it.computer("r1")
        it.work()
        computer.drive(100, 100, valid_ms=300)
        for _ in range(200):
            it.work(0.01)
        assert it.simulator.now_ms == pytest.approx(2000, abs=10)
        assert it.simulator.poses[0, 0] == pytest.approx(-0.5 + 0.03, abs=1e-6)


def test_a_computer_that_leaves_and_comes_back_finds_its_robot(tmp_path: Path) -> None:
    with bench(tmp_path, LockStep()) as it:
        first = it.computer("r1")
        it.work()
        first.hear()
        first.close()
        it.work(1.0)
        stood = it.simulator.now_ms
        it.work(1.0)
        assert it.simulator.now_ms == stood  # nobody listens
        second = it.computer("r1")
        it.work(1.0)
        second.hear()
        assert second.samples[0].stamp_ms == stood + 100


# Pace


def test_time_stands_still_until_somebody_listens_and_until_go(tmp_path: Path) -> None:
    for pace in (RealTime(1.0), LockStep()):
        with bench(tmp_path, pace) as it:
            it.work(1.0)
            assert (it.simulator.now_ms, it.simulator.stamps_ms) == (0, [])
            computer = it.computer("r1")
            it.work(1.0, go=False)
            computer.hear()
            assert computer.samples == []
            it.work()
            computer.hear()
            assert [sample.stamp_ms for sample in computer.samples] == [0]


def test_lock_step_waits_for_everybody_who_listens(tmp_path: Path) -> None:
    with bench(tmp_path, LockStep()) as it:
        both = [it.computer("r1"), it.computer("r2")]
        it.work()
        for computer in both:
            computer.hear()
        both[0].drive(0, 0)
        it.work(0.1)
        assert it.simulator.now_ms == 0
        both[1].drive(0, 0)
        it.work()
        assert it.simulator.now_ms == 100
        assert [len(each.hear()) for each in both] == [1, 1]


def test_lock_step_does_not_wait_for_ever(tmp_path: Path) -> None:
    with bench(tmp_path, LockStep()) as it:
        both = [it.computer("r1"), it.computer("r2")]
        it.work()
        both[0].hear()
        both[0].drive(0, 0)
        it.work(PATIENCE - 0.01)
        assert it.simulator.now_ms == 0
        it.work(0.02)
        assert it.simulator.now_ms == 100


def in_lock_step(folder: Path, delays: Callable[[int], float]) -> list[Sample]:
    """A run in which the computers answer after as many seconds as ``delays`` says."""
    with bench(folder, LockStep(), ORION_NOISE) as it:
        both = [it.computer("r1"), it.computer("r2")]
        it.work()
        for k in range(100):
            for computer in both:
                computer.hear()
                computer.drive(100, 100 + k)
                it.work(delays(k))
        return both[0].samples + both[1].samples


def test_a_run_in_lock_step_does_not_depend_on_how_quick_the_computers_are(tmp_path: Path) -> None:
    quick = in_lock_step(tmp_path, lambda k: 0.0)
    slow = in_lock_step(tmp_path, lambda k: 0.01 * (k % 10))
    assert quick == slow
    assert len({sample.stamp_ms for sample in quick}) == 100


# The whole process


class Script(Control):
    """Opens the ports when they are ready, answers every sample, and stops after so many."""

    def __init__(self, samples: int) -> None:
        self._computers: list[Computer] = []
        self._samples = samples
        self.told: list[str] = []
        super().__init__()

    def tell(self, event: str, **facts: Any) -> None:
        self.told.append(event)
        if event == "ready":
            self._computers = [Computer(port) for port in facts["ports"].values()]

    @property
    def stop(self) -> bool:
        """Asked once a turn of the loop."""
        for computer in self._computers:
            if any(isinstance(frame, Sample) for frame in computer.hear()):
                computer.drive(100, 100)
        done = bool(self._computers) and all(len(each.samples) >= self._samples for each in self._computers)
        if done:
            for computer in self._computers:
                computer.close()
        return done

    @stop.setter
    def stop(self, value: bool) -> None:
        pass


def config(**simulation: Any) -> Config:
    return resolve({"simulation": {"world": "paper", **simulation}, "robots": {"r1": {}, "r2": {}}})


def test_a_simulation_runs_and_sums_up(tmp_path: Path) -> None:
    control = Script(samples=31)
    truth = tmp_path / "truth" / "run.npz"
    summary = run_simulation(config(speed="max", ideal=True), tmp_path, control, truth)
    assert control.told[0] == "ready"
    assert summary["simulated_seconds"] == 3.0
    assert [robot["id"] for robot in summary["robots"]] == ["r1", "r2"]
    assert [robot["collisions"] for robot in summary["robots"]] == [0, 0]
    assert summary["robots"][0]["driven_m"] == pytest.approx(0.3, abs=0.01)
    assert list(tmp_path.iterdir()) == [truth.parent]
    with np.load(truth) as saved:
        assert saved["robots"].tolist() == ["r1", "r2"]
        assert saved["stamps_ms"].tolist() == list(range(0, 3001, 100))
        assert saved["poses"].shape == (31, 2, 3)
        np.testing.assert_allclose(saved["poses"][0, 0], [0, 0, np.pi / 2])
        assert saved["walls"].shape[1] == 4


def test_a_simulation_is_the_same_again(tmp_path: Path) -> None:
    ways = []
    for name in ("a", "b"):
        run_simulation(config(speed="max", seed=5), tmp_path, Script(samples=21), tmp_path / f"{name}.npz")
        with np.load(tmp_path / f"{name}.npz") as saved:
            ways.append(saved["poses"])
    np.testing.assert_array_equal(*ways)


def test_a_swarm_without_robots_or_with_too_many_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="none to simulate"):
        run_simulation(resolve({}), tmp_path, Control())
    many = resolve({"robots": {f"r{k}": {} for k in range(3)}})
    with pytest.raises(UserError, match="has 2 starts"):
        run_simulation(many, tmp_path, Control())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.processes
def test_the_command_lets_time_pass_when_it_is_told_to_and_cleans_up(tmp_path: Path) -> None:
    """As the one who supervises it sees it: words in, JSON lines out."""
    (tmp_path / "orion.toml").write_text('simulation = {speed = "max"}\n[robots.r1]\n')
    command = [sys.executable, "-P", "-m", "agent", "simulate", "-c", str(tmp_path / "orion.toml"), "--supervised"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready == {"event": "ready", "name": "the world", "ports": {"r1": str(tmp_path / "r1.tty")}}
        computer = Computer(ready["ports"]["r1"])
        process.stdin.write("go\n")
        process.stdin.flush()
        while len(computer.samples) < 3:
            select.select([computer.serial], [], [], 10)
            if any(isinstance(frame, Sample) for frame in computer.hear()):
                computer.drive(0, 0)
        computer.close()
        process.stdin.write("finish\n")
        process.stdin.close()
        report = json.loads(process.stdout.read().splitlines()[-1])
    assert process.returncode == 0
    assert report["event"] == "report"
    assert report["simulated_seconds"] >= 0.2
    assert not (tmp_path / "r1.tty").is_symlink()


# Its settings


def test_noise_settings_are_in_degrees_and_default_to_a_well_kept_orion() -> None:
    noise = config().simulation.build_noise()
    for name in Noise.__slots__:
        assert getattr(noise, name) == pytest.approx(getattr(ORION_NOISE, name))
    assert config(noise={"heading_deg": 180}).simulation.build_noise().heading == pytest.approx(np.pi)


def test_a_worlds_file_is_found_beside_the_configuration(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text('simulation = {world = "lab.yaml"}')
    assert load(tmp_path / "lab.toml", {}, {}).simulation.world == str(tmp_path / "lab.yaml")


def test_an_ideal_simulation_has_no_noise() -> None:
    assert config(ideal=True, noise={"slip": 0.5}).simulation.build_noise() == NO_NOISE


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ({"wrld": "paper"}, r"simulation\.wrld.*did you mean world"),
        ({"noise": {"dropot": 0.1}}, r"simulation\.noise\.dropot.*did you mean dropout"),
        ({"noise": {"dropout": 2}}, r"simulation\.noise\.dropout.*less than or equal to 1"),
        ({"speed": 0}, r"simulation\.speed.*greater than 0"),
    ],
)
def test_settings_that_are_wrong_are_told_of(table: dict[str, Any], complaint: str) -> None:
    with pytest.raises(UserError, match=complaint):
        resolve({"simulation": table})
