"""A robot's body behind a serial line: samples become readings, and every sample is answered by a drive.

sample -> odometry and heading -> the pose in the start frame -> readings -> journal, published by the node;
the same pose in the common frame -> the driver -> wheel speeds. The body is the same whether a real robot is at the
other end or a simulated one.

Laws kept here: wheels turn only in answer to a sample, so a robot that says nothing is told nothing and stops by
itself; nothing that comes over the line raises; what a microcontroller forgets when it restarts is not forgotten here.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agent.body import BATCH
from agent.control import Stopped
from agent.driver import Driver, NoDriver
from agent.errors import UserError
from agent.odometry import HEADING_WINDOW, Odometry, Ticks, Wheels
from agent.readings import REACH, Readings
from agent.scanner import in_metres, points_seen, sensor_of
from agent.swarm_time import SwarmTime
from mapping.pose import Pose, QuantisedPose, from_turn16
from mapping.sensor import ORION_RANGE
from transport.mcu_frames import Hello, Sample
from transport.mcu_link import Event, LinkBack, LinkLost, Stalled

_FASTEST = 1.5
"""Metres a second that no wheel of such a robot rolls: encoders that say so have begun anew."""

_JOLT = 0.05
"""Metres that are forgiven on top."""

_LONGEST_DRIVE_MS = 1000
"""However seldom a robot senses, it goes no farther than this unseen: 10 cm at 0.1 m/s."""

_ANSWER_TIME = 0.2


class Link(Protocol):
    """What the body needs of ``transport.mcu_link.McuLink``."""

    def receive(self, timeout: float = 0.0) -> Sequence[Event]:
        """Everything that came in, oldest first."""
        ...

    def drive(self, left_mm_s: int, right_mm_s: int, *, valid_ms: int = 300, answers: int | None = None) -> bool:
        """Turn the wheels for a while."""
        ...

    def close(self) -> None:
        """Stop the wheels and let go of the line."""
        ...


def greet(
    link: Link, timeout: float, *, where: str = "the serial line", stopped: Callable[[], bool] = lambda: False
) -> Hello:
    """Wait until the microcontroller has said what it is made of.

    Args:
        link: the line to it.
        timeout: seconds to wait.
        where: names the line in the error.
        stopped: whether we are to end.

    Raises:
        UserError: it says nothing in time.
        Stopped: we are to end.
    """
    deadline = time.monotonic() + timeout
    trouble = "nothing came over it"
    while (left := deadline - time.monotonic()) > 0:
        if stopped():
            raise Stopped
        for event in link.receive(min(left, _ANSWER_TIME)):
            match event:
                case Hello():
                    return event
                case LinkLost(reason):
                    trouble = reason
                case Sample():
                    trouble = "samples come, but no hello"
                case _:
                    pass
    raise UserError(where, f"no robot answered within {timeout:g} s: {trouble}", "check the port, cable and firmware")


class SerialBody:
    """One robot (implements ``agent.body.Body``).

    Args:
        link: the line to its microcontroller.
        hello: what that said (``greet``).
        driver: where it goes.
        max_range: metres up to which its sensors are trusted.
        heading_window: samples in the heading's moving average.
        unix_ms: the computer's clock, for robots that do not know swarm time.
        monotonic: seconds, the computer's steady clock.

    Attributes:
        sensor: what its scans' ranges mean.
        patience: seconds that whoever reads may sleep at most.
        status: what is wrong, in words; empty if nothing is.
        counters: ``samples``; ``restarts`` of the microcontroller; ``other_sensor``: samples that were dropped because
            the robot has become another one; ``bad_pose``: scans from farther away than a robot gets.

    Raises:
        ValueError: the hello describes no robot.
    """

    patience = 0.005

    def __init__(
        self,
        link: Link,
        hello: Hello,
        *,
        driver: Driver | None = None,
        max_range: float = ORION_RANGE,
        heading_window: int = HEADING_WINDOW,
        unix_ms: Callable[[], int] = lambda: time.time_ns() // 1_000_000,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.sensor = sensor_of(hello, max_range)
        self.status = ""
        self.counters: Counter[str] = Counter()
        self._link = link
        self._hello = hello
        self._start = Pose()
        self._driver: Driver = NoDriver() if driver is None else driver
        self._max_range = max_range
        self._wheels = Wheels(hello.ticks_per_metre, hello.wheel_base_um / 1e6)
        self._window = heading_window
        self._time = SwarmTime(unix_ms, monotonic)
        self._odometry: Odometry | None = None
        self._waiting: deque[tuple[int, Pose, NDArray[np.float64]]] = deque()
        self._given = 0

    @property
    def pose(self) -> Pose:
        """``T_common_robot`` at the newest sample (eq. 8). It started where it stood at its first one."""
        return self._start if self._odometry is None else self._start @ self._odometry.pose

    # --- agent.body.Body

    def place(self, start: QuantisedPose) -> None:
        """The start frame lies there from now on; the driver is told how far that moved the robot."""
        before, self._start = self._start, start.pose()
        self._driver.placed(self._start @ before.inverse())

    def read(self, until: float) -> Readings:
        """The scans that have come in (at most ``BATCH``). ``until`` is not looked at: a robot has its own time."""
        newest = None
        for event in self._link.receive():
            match event:
                case Sample():
                    newest = self._sense(event) or newest
                case Hello():
                    self._meet(event)
                case LinkBack():
                    self._time.interrupted()
                    self.status = "waits for the robot's first sample"
                case LinkLost(reason):
                    self.status = f"the robot is not connected: {reason}"
                case Stalled(seconds):
                    self.status = f"the robot has sent no sample for {seconds:.1f} s"
                case _:
                    pass
        if newest is not None:
            self._drive(newest)
        batch = [self._waiting.popleft() for _ in range(min(BATCH, len(self._waiting)))]
        self._given += len(batch)
        if not batch:
            return Readings.empty(len(self.sensor.beams))
        stamps_ms, poses, ranges = zip(*batch, strict=True)
        in_rows = np.array([(pose.x, pose.y, pose.yaw) for pose in poses])
        return Readings(np.array(stamps_ms, np.int64), in_rows, np.array(ranges))

    @property
    def progress(self) -> tuple[int, int]:
        """Scans read so far; nobody knows of how many."""
        return self._given, 0

    @property
    def done(self) -> bool:
        """Whether the driver is done and all scans are read; a robot that does not drive itself is never done."""
        return self._driver.done and not self._waiting

    def close(self) -> None:
        """Stop the wheels and let go of the line."""
        self._link.close()

    # --- what comes in

    def _meet(self, hello: Hello) -> None:
        """The microcontroller says what it is made of, perhaps because it restarted."""
        if hello.clock_ms != self._hello.clock_ms:
            self._time.begin_anew()
        self._hello = hello

    @property
    def _is_another(self) -> bool:
        """Whether the robot at the other end is not made like the one that the session's descriptor describes."""
        try:
            wheels = Wheels(self._hello.ticks_per_metre, self._hello.wheel_base_um / 1e6)
            return wheels != self._wheels or sensor_of(self._hello, self._max_range) != self.sensor
        except ValueError:
            return True

    def _sense(self, sample: Sample) -> Sample | None:
        """Take a sample in: a pose, a scan. Gives it back if it was any good."""
        if len(sample.ranges) != len(self.sensor.beams) or self._is_another:
            self.counters["other_sensor"] += 1
            self.status = "the robot has other sensors or wheels than before: start its agent again"
            return None
        self.counters["samples"] += 1
        pose = self._moved(sample)
        if not max(abs(pose.x), abs(pose.y)) <= REACH:  # NaN compares false
            self.counters["bad_pose"] += 1
            return None
        self._waiting.append((self._time.now_ms, pose, in_metres(sample.ranges)))
        self.status = self._driver.status
        return sample

    def _moved(self, sample: Sample) -> Pose:
        """Where the robot is now, ``T_start_robot``."""
        ticks = Ticks(sample.left_ticks, sample.right_ticks)
        heading = from_turn16(sample.heading_turn16) if sample.heading_valid else None
        passed_ms = self._time.hear(sample.stamp_ms, self._hello.clock_ms)
        if self._odometry is None:
            self._odometry = Odometry.start(self._wheels, ticks, self._window)
        elif passed_ms is None or self._is_jump(self._odometry.ticks, ticks, passed_ms / 1000):
            self.counters["restarts"] += 1
            self._odometry = self._odometry.recounted(ticks)
        self._odometry = self._odometry.moved(ticks, heading)
        return self._odometry.pose

    def _is_jump(self, before: Ticks, after: Ticks, seconds: float) -> bool:
        return max(map(abs, self._wheels.rolled(before, after))) > _FASTEST * seconds + _JOLT

    # --- what goes out

    def _drive(self, sample: Sample) -> None:
        """Answer a sample."""
        seen = points_seen(in_metres(sample.ranges), self.sensor)
        motion = self._driver.drive(self._time.now_ms / 1000, self.pose, seen)
        left, right = (_in_mm_s(speed) for speed in motion.wheels(self._wheels.base))
        # Long enough to bridge two lost samples, short enough to stop before it is where it has not looked.
        valid_ms = min(max(300, 3 * self._hello.sample_period_ms), _LONGEST_DRIVE_MS)
        self._link.drive(left, right, valid_ms=valid_ms, answers=sample.sequence)


def _in_mm_s(speed: float) -> int:
    """Whole millimetres a second, as far as the frame holds them."""
    return round(max(-32.0, min(32.0, speed)) * 1000)
