"""What ``orion doctor`` asks a robot over its serial line: who it is, what its samples are worth, whether it hears us.

First listen (``listen``), then judge what was heard (``judge`` and the checks below it, pure functions). Law kept here:
no wheel turns; all that is said are heartbeats, and to stop.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from agent.finding import Finding, ok, problem, warning
from agent.heading import wrapped
from agent.odometry import ticks_between
from agent.scanner import sensor_of
from mapping.pose import from_turn16
from transport.mcu_frames import RANGE_INVALID, RANGE_NOTHING, RANGE_VALID, Beam, Heartbeat, Hello, Sample
from transport.mcu_link import LinkBack, LinkLost, McuLink

_HEARTBEAT = 0.25
"""Seconds between two of our heartbeats, so that each of the robot's can tell of some."""

_UNCALIBRATED = 2
"""Below this of 3 the BNO055's heading wanders."""


@dataclass
class Heard:
    """What came over the line.

    Attributes:
        opened: whether the port could be opened.
        reason: why it could not, or why it closed; empty if it is open.
        hello: the newest.
        samples: those that came while we listened.
        heartbeats: all that came.
        counters: of the link (``transport.mcu_link.McuLink``), while we listened; without a hello, from the beginning.
        seconds: how long we listened.
    """

    opened: bool = False
    reason: str = ""
    hello: Hello | None = None
    samples: list[Sample] = field(default_factory=list)
    heartbeats: list[Heartbeat] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0


def link(port: str, baudrate: int) -> Iterator[Finding]:
    """All that concerns the robot at a port.

    Args:
        port: a device, a pseudo-terminal or a URL as pyserial takes it.
        baudrate: bits a second.
    """
    try:
        heard = listen(port, baudrate)
    except ValueError as error:
        yield problem(port, str(error), "give a device or a URL as pyserial takes it")
        return
    yield from judge(port, baudrate, heard)


def listen(port: str, baudrate: int, *, patience: float = 3.0, seconds: float = 2.0) -> Heard:
    """Open the port, wait for the hello, then listen.

    Args:
        port: as ``link`` takes it.
        baudrate: bits a second.
        patience: seconds to wait at most for the port and the hello, and then for proof that the robot hears us.
        seconds: how long to listen to samples.

    Raises:
        ValueError: nothing could ever be opened under that port's name.
    """
    heard = Heard()
    with McuLink(port, baudrate=baudrate, heartbeat=_HEARTBEAT) as line:
        _listen_until(line, heard, time.monotonic() + patience, lambda: heard.hello is not None)
        if heard.hello is None:
            heard.counters = Counter(line.counters)
            return heard
        before = Counter(line.counters)  # what was cut in two when we opened the port is no damage
        heard.samples.clear()
        began = time.monotonic()
        _listen_until(line, heard, began + seconds, lambda: False)
        heard.counters = Counter(line.counters)  # a copy at once: the line's thread may count something new
        heard.counters.subtract(before)
        heard.seconds = time.monotonic() - began
        samples = list(heard.samples)
        _listen_until(line, heard, began + patience, lambda: _reached(heard.heartbeats) > 0)
        heard.samples = samples
    return heard


def _listen_until(line: McuLink, heard: Heard, deadline: float, enough: Callable[[], bool]) -> None:
    """Take in what comes until it is enough, the port is gone, or the deadline is over."""
    while not heard.reason and not enough() and (left := deadline - time.monotonic()) > 0:
        for event in line.receive(min(left, 0.1)):
            match event:
                case LinkBack():
                    heard.opened = True
                case LinkLost(reason):
                    heard.reason = reason
                case Hello():
                    heard.hello = event
                case Sample():
                    heard.samples.append(event)
                case Heartbeat():
                    heard.heartbeats.append(event)
                case _:
                    pass  # a stall is seen by the samples that are missing


def judge(port: str, baudrate: int, heard: Heard) -> Iterator[Finding]:
    """What is to be thought of what was heard."""
    if not heard.opened:
        yield _not_opened(port, heard.reason)
        return
    if heard.hello is None:
        yield _no_hello(port, baudrate, heard)
        return
    if heard.reason:
        yield problem(port, f"closed while we listened: {heard.reason}", "check cable and plug")
    yield identity(port, heard.hello)
    yield calibration(port, heard.hello)
    if not heard.samples:
        yield problem(
            port, f"a hello, and no sample in {heard.seconds:.1f} s", "check the firmware's timer and sensors"
        )
    else:
        yield rate(port, heard)
        yield headings(port, heard)
        yield from ranges(port, heard)
        yield wheels(port, heard)
    yield frames(port, heard)
    yield heartbeats(port, heard)


def _not_opened(port: str, reason: str) -> Finding:
    """Why, and what to do about it, after the words that pyserial and the system use."""
    remedies = {
        "No such file": "check the cable and the name: ls -l /dev/serial/by-id/",
        "Permission denied": "sudo usermod -aG dialout $USER, then log in again",
        "exclusively lock": "another program has it: end the robot's agent",
        "Connection refused": "start what is to serve that address",
    }
    remedy = next((remedies[words] for words in remedies if words in reason), "check the cable and the name")
    if Path(port).is_symlink() and not Path(port).exists():
        remedy = "what its link points at is gone: plug the robot in, or start its orion simulate"
    return problem(port, f"cannot be opened: {reason or 'it takes too long'}", remedy)


def _no_hello(port: str, baudrate: int, heard: Heard) -> Finding:
    counters = heard.counters
    if heard.reason:
        return problem(port, f"closed before a hello came: {heard.reason}", "check cable, plug and power")
    if counters["unknown_direction"]:
        return problem(port, "what we say comes back, and no hello", "the line is bridged: check the wires RX and TX")
    if counters["unknown_version"]:
        remedy = "flash firmware made from this version: python -m transport.firmware DIR"
        return problem(port, "it speaks another version of the protocol", remedy)
    if heard.samples or heard.heartbeats:
        remedy = "check the wire to the robot's RX; the firmware must answer a heartbeat that asks for a hello"
        return problem(port, f"{_many(len(heard.samples), 'sample')} came, and no hello", remedy)
    if counters["damaged"]:
        remedy = "check the baud rate, the ground wire, and that this is the robot's port"
        found = f"{_many(counters['damaged'], 'damaged frame')} at {baudrate} baud, and not a whole one"
        return problem(port, found, remedy)
    remedy = "check power, the wires RX and TX, the baud rate, and that this is the robot's port"
    return problem(port, "opens, and nothing comes over it that ends like a frame", remedy)


def identity(port: str, hello: Hello) -> Finding:
    """What the robot says it is."""
    try:
        sensor_of(hello, hello.max_range_mm / 1000)
    except ValueError as error:
        return problem(port, f"its hello makes no sense: {error}", "mend the sensor's description in the firmware")
    beams = ", ".join(_beam(beam) for beam in hello.beams)
    time_known = "knows" if hello.clock_ms else "does not know"
    return ok(
        port,
        f"firmware {hello.firmware}; {_many(len(hello.beams), 'beam')} at {beams} degrees, "
        f"up to {hello.max_range_mm / 1000:g} m; {hello.ticks_per_metre} ticks/m, "
        f"wheels {hello.wheel_base_um / 1000:g} mm apart; "
        f"a sample each {hello.sample_period_ms} ms; {time_known} swarm time",
    )


def calibration(port: str, hello: Hello) -> Finding:
    """Whether its compass can be trusted."""
    found = f"compass calibrated {hello.heading_calibration} of 3"
    if hello.heading_calibration >= _UNCALIBRATED:
        return ok(port, found)
    return warning(port, found, "turn the robot by hand, a full turn about each axis, until it says 3")


def rate(port: str, heard: Heard) -> Finding:
    """Whether samples come as often as the hello says, by their stamps and by our clock."""
    assert heard.hello is not None
    period = heard.hello.sample_period_ms / 1000
    found = f"{_many(len(heard.samples), 'sample')} in {heard.seconds:.1f} s"
    if len(heard.samples) < 3:
        return warning(port, f"{found}, one expected each {period * 1000:.0f} ms", "check the firmware's timer")
    stamped = [(b.stamp_ms - a.stamp_ms) % 2**32 / 1000 for a, b in pairwise(heard.samples)]
    missing = [(b.sequence - a.sequence) % 2**16 for a, b in pairwise(heard.samples)]
    each = sum(stamped) / max(1, sum(missing))
    found += f", stamped {each * 1000:.0f} ms apart"
    if not 0.9 * period <= each <= 1.1 * period:
        return warning(port, f"{found}, its hello says {period * 1000:.0f}", "mend the hello, or the firmware's timer")
    pace = sum(stamped) / heard.seconds
    if not 0.8 <= pace <= 1.25:
        remedy = "mend the firmware's clock; of a simulated robot it is the simulation's speed"
        return warning(port, f"{found}: its clock runs {pace:.2g} times as fast as ours", remedy)
    return ok(port, found)


def headings(port: str, heard: Heard) -> Finding:
    """Whether its heading is to be trusted, and stands as still as the robot."""
    trusted = [sample for sample in heard.samples if sample.heading_valid]
    stale = len(heard.samples) - len(trusted)
    if not trusted:
        return warning(port, "no sample has a valid heading: odometry will be the wheels' alone", "check the compass")
    angles = [from_turn16(sample.heading_turn16) for sample in trusted]
    middle = math.atan2(sum(map(math.sin, angles)), sum(map(math.cos, angles)))
    spread = max(abs(wrapped(angle - middle)) for angle in angles)
    found = f"heading {math.degrees(middle) % 360:.1f} degrees, within {math.degrees(spread):.1f}"
    if stale:
        return warning(port, f"{found}; stale in {stale} of {len(heard.samples)} samples", "check the compass's wires")
    return ok(port, found)


def ranges(port: str, heard: Heard) -> Iterator[Finding]:
    """What each beam reads."""
    assert heard.hello is not None
    beams = heard.hello.beams
    if wrong := {len(sample.ranges) for sample in heard.samples} - {len(beams)}:
        found = f"samples of {', '.join(map(str, sorted(wrong)))} ranges, its hello has {_many(len(beams), 'beam')}"
        yield problem(port, found, "mend the firmware: one range a beam, in the hello's order")
        return
    for number, beam in enumerate(beams):
        readings = [sample.ranges[number] for sample in heard.samples]
        counts = Counter(reading.status for reading in readings)
        found = f"beam {number} at {_beam(beam)} degrees: " + (
            f"{counts[RANGE_VALID]} valid, {counts[RANGE_NOTHING]} nothing in range, {counts[RANGE_INVALID]} invalid"
        )
        if valid := [reading.range_mm for reading in readings if reading.status == RANGE_VALID]:
            found += f"; {min(valid)} to {max(valid)} mm"
        if counts[RANGE_INVALID] == len(readings):
            yield warning(port, found, "check that sensor's wires, address and cover glass")
        else:
            yield ok(port, found)


def wheels(port: str, heard: Heard) -> Finding:
    """Whether the wheels stood still, as they were told."""
    first, last = heard.samples[0], heard.samples[-1]
    left = ticks_between(first.left_ticks, last.left_ticks)
    right = ticks_between(first.right_ticks, last.right_ticks)
    if left or right:
        remedy = "was it pushed? else the firmware must stop the wheels when told, and when a drive has run out"
        return warning(port, f"wheels turned by {left} and {right} ticks, told to stop", remedy)
    return ok(port, "wheels stand still")


def frames(port: str, heard: Heard) -> Finding:
    """What the line did to frames."""
    counters = heard.counters
    unknown = sum(number for name, number in counters.items() if name.startswith("unknown_"))
    found = (
        f"{counters['good']} good frames, {counters['damaged']} damaged, {unknown} unknown; "
        f"samples: {counters['lost']} lost, {counters['late']} late; {_many(counters['restarts'], 'restart')}"
    )
    if counters["restarts"]:
        return warning(port, found, "a robot that restarts lacks power, or its watchdog bites")
    if unknown:
        return warning(port, found, "flash firmware made from this version: python -m transport.firmware DIR")
    if counters["damaged"] or counters["lost"]:
        return warning(port, found, "a shorter cable, a ground wire, a lower baud rate or fewer samples")
    if counters["late"]:
        return warning(port, found, "is this computer too busy, or the baud rate too low for the samples?")
    return ok(port, found)


def heartbeats(port: str, heard: Heard) -> Finding:
    """Whether the robot hears us: its heartbeats count the frames of ours that reached it."""
    if not heard.heartbeats:
        return warning(port, "it sends no heartbeat", "the firmware is to send one a second")
    damaged = (heard.heartbeats[-1].damaged - heard.heartbeats[0].damaged) % 2**32
    reached = _reached(heard.heartbeats)
    if not reached:
        return problem(port, "its heartbeats say that it hears nothing of us", "check the wire to the robot's RX")
    if damaged:
        return warning(port, f"of our frames it heard {reached}, and {damaged} damaged", "check cable and ground wire")
    return ok(port, f"it hears us: {_many(reached, 'frame')} of ours arrived, none damaged")


def _reached(heartbeats: list[Heartbeat]) -> int:
    """How many of our frames arrived from the first heartbeat to the last."""
    return (heartbeats[-1].good - heartbeats[0].good) % 2**32 if heartbeats else 0


def _many(number: int, what: str) -> str:
    return f"{number} {what}" + "s" * (number != 1)


def _beam(beam: Beam) -> str:
    """Where it looks, degrees from forward."""
    return f"{math.degrees(wrapped(from_turn16(beam.bearing_turn16))):.0f}"
