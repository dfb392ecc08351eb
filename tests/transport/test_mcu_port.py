"""The microcontroller's end, against a plain pyserial port."""

from __future__ import annotations

import errno
import random
import time
from collections.abc import Iterator

import pytest
import serial

from transport.framing import Deframer, wrap
from transport.mcu_frames import Drive, Heartbeat, Hello, encode
from transport.mcu_port import McuPort

PATIENCE = 15.0
"""Seconds after which what should have come counts as lost; a test that passes never waits that long."""

BEAT = Heartbeat(1, 0, 0, 0)
HELLO = Hello(1, 10_000, 90_000, 20, 1200, 3, 0, ())


@pytest.fixture
def mcu() -> Iterator[McuPort]:
    with McuPort.open_pty() as mcu:
        yield mcu


def open_port(mcu: McuPort) -> serial.Serial:
    return serial.Serial(mcu.path, timeout=PATIENCE, write_timeout=PATIENCE)


def test_every_byte_goes_through_as_it_is(mcu):
    """No echo, no end-of-line translation, no control characters."""
    every = bytes(range(256))
    with open_port(mcu) as port:
        assert mcu.write(every)
        assert port.read(256) == every
        port.write(wrap(encode(Drive(0x0D0A, 0x0304, 0x1113, 0x1A1C))))
        assert received(mcu, 1) == [Drive(0x0D0A, 0x0304, 0x1113, 0x1A1C)]
        assert mcu.send(BEAT)
        assert port.read(len(wrap(encode(BEAT)))) == wrap(encode(BEAT))  # and not what the port itself said


def received(mcu: McuPort, number: int) -> list[Drive | Heartbeat]:
    frames: list[Drive | Heartbeat] = []
    deadline = time.monotonic() + PATIENCE
    while len(frames) < number:
        assert time.monotonic() < deadline, f"waited in vain, received only {frames}"
        frames += mcu.receive()
    return frames


def test_receiving_nothing_does_not_wait(mcu):
    assert mcu.receive() == []
    with open_port(mcu):
        assert mcu.receive() == []


def test_what_is_said_while_nobody_listens_is_dropped_and_counted(mcu):
    assert not mcu.is_heard
    assert not mcu.send(BEAT)
    with open_port(mcu) as port:
        assert mcu.is_heard
        assert mcu.send(HELLO)
        assert port.read(len(wrap(encode(HELLO)))) == wrap(encode(HELLO))
    assert not mcu.send(BEAT)
    assert mcu.counters == {"dropped_unheard": 2, "sent": 1}


def test_who_listens_and_does_not_read_costs_whole_frames_only(mcu):
    with open_port(mcu) as port:
        while mcu.counters["dropped_full"] < 10:
            mcu.send(HELLO)
        sent = mcu.counters["sent"]
        deframer = Deframer()
        while deframer.counters["good"] < sent - 1:  # the last one may be waiting for room
            deframer.feed(port.read(1))
        assert mcu.send(BEAT)
        contents: list[bytes] = []
        while encode(BEAT) not in contents:
            contents += deframer.feed(port.read(1))
        assert deframer.counters == {"good": sent + 1}


def test_the_other_side_may_come_and_go(mcu):
    for number in range(5):
        with open_port(mcu) as port:
            port.write(wrap(encode(Drive(number, 0, 0, 0))))
            assert received(mcu, 1) == [Drive(number, 0, 0, 0)]
            assert mcu.send(BEAT)
            assert port.read(len(wrap(encode(BEAT)))) == wrap(encode(BEAT))
        assert mcu.receive() == []


def test_the_last_words_of_one_who_left_are_heard(mcu):
    with open_port(mcu) as port:
        port.write(wrap(encode(Drive(1, 0, 0, 0))))
    assert received(mcu, 1) == [Drive(1, 0, 0, 0)]


def test_what_only_a_microcontroller_says_is_none_of_a_computers(mcu):
    with open_port(mcu) as port:
        port.write(wrap(encode(HELLO)) + wrap(encode(BEAT)))
        assert received(mcu, 1) == [BEAT]
    assert mcu.counters["unknown_direction"] == 1


def test_garbage_never_raises(mcu):
    with open_port(mcu) as port:
        for seed in range(20):
            port.write(random.Random(seed).randbytes(500) + b"\0" + wrap(encode(BEAT)))
            assert received(mcu, 1) == [BEAT]
    assert mcu.counters["damaged"] > 20


def test_a_pulled_cable_is_gone(mcu):
    mcu.close()
    mcu.close()
    with pytest.raises(serial.SerialException) as error:
        open_port(mcu)
    assert error.value.errno == errno.ENOENT
    with pytest.raises(RuntimeError):
        mcu.send(BEAT)
    with pytest.raises(RuntimeError):
        mcu.receive()
