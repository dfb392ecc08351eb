"""The link on real pseudo-terminals and sockets, under a clock that the tests turn."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial
import serial.rfc2217

from transport.framing import wrap
from transport.mcu_frames import Drive, Frame, Heartbeat, Hello, Range, Sample, encode
from transport.mcu_link import Event, LinkBack, LinkLost, McuLink, Stalled
from transport.mcu_port import McuPort

PATIENCE = 15.0
"""Seconds after which what should have come counts as lost; a test that passes never waits that long."""

HELLO = Hello(1, 10_000, 90_000, 20, 1200, 3, 0, ())
RETRY = (0.001, 0.01)


def sample(number: int, *, stamp_ms: int | None = None) -> Sample:
    """Sample number n, sensed 20 ms after the one before; its values follow from its number."""
    ranges = tuple(Range((number * 7 + beam) % 1200, 0) for beam in range(5))
    return Sample(
        number % 2**16, number * 20 if stamp_ms is None else stamp_ms, number, -number, number % 2**16, 1, ranges
    )


def samples(events: list[Event]) -> list[Sample]:
    return [event for event in events if isinstance(event, Sample)]


class FakeClock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Bench:
    """A link, and the microcontroller's end of its cable, which can be pulled and put back."""

    def __init__(self, folder: Path, **options: object) -> None:
        self.clock = FakeClock()
        self.device = folder / "ttyACM0"
        self.mcu: McuPort | None = None
        self.plug()
        self.link = McuLink(str(self.device), clock=self.clock, retry=RETRY, **options)

    def plug(self) -> None:
        self.mcu = McuPort.open_pty()
        self.device.symlink_to(self.mcu.path)

    def pull(self) -> None:
        self.device.unlink()
        self.mcu.close()

    def until(self, enough: Callable[[list[Event]], bool]) -> list[Event]:
        """What the link gives until it is enough."""
        deadline = time.monotonic() + PATIENCE
        events: list[Event] = []
        while not enough(events):
            assert time.monotonic() < deadline, f"waited in vain, got only {events[-10:]}"
            events += self.link.receive(0.05)
        return events

    def until_came(self, event: object) -> list[Event]:
        """What the link gives up to an event of that type, or that equals it."""
        if isinstance(event, type):
            return self.until(lambda events: any(isinstance(one, event) for one in events))
        return self.until(lambda events: event in events)

    def heard(self, number: int) -> list[Drive | Heartbeat]:
        """The next frames that the microcontroller hears, at least so many."""
        deadline = time.monotonic() + PATIENCE
        frames: list[Drive | Heartbeat] = []
        while len(frames) < number:
            assert time.monotonic() < deadline, f"waited in vain, heard only {frames}"
            frames += self.mcu.receive()
        return frames

    def say(self, *frames: Frame) -> list[Event]:
        """The microcontroller says these; what the link gives up to the last of them."""
        for frame in frames:
            assert self.mcu.send(frame)
        return self.until_came(frames[-1])

    def flowing(self) -> None:
        """Bring the link up, with samples 0 and 1 received and all small talk done."""
        self.until_came(LinkBack)
        self.say(HELLO, sample(0), sample(1))
        self.heard(2)

    def close(self) -> None:
        self.link.close()
        self.mcu.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def test_a_sample_arrives(bench):
    bench.until_came(LinkBack)
    assert bench.say(sample(3)) == [sample(3)]


def test_the_first_words_are_a_stop_and_asking_for_a_hello(bench):
    bench.until_came(LinkBack)
    stop, heartbeat = bench.heard(2)
    assert stop == Drive(0, 0, 0, 0)
    assert heartbeat == Heartbeat(0, 1, 0, 0)


def test_hello_is_asked_for_once_a_second_until_it_comes(tmp_path):
    bench = Bench(tmp_path, stall=1e9)
    bench.until_came(LinkBack)
    bench.heard(2)
    for beat in (1, 2, 3):
        bench.clock.now += 0.99
        bench.link.receive()
        assert bench.mcu.receive() == []
        bench.clock.now += 0.01
        bench.link.receive()
        assert bench.heard(1) == [Heartbeat(beat, 1, 0, 0)]
    assert bench.link.hello is None
    bench.say(HELLO)
    assert bench.link.hello == HELLO
    bench.clock.now += 1.0
    bench.link.receive()
    assert bench.heard(1) == [Heartbeat(4, 0, 1, 0)]
    bench.close()


def test_a_drive_arrives_and_names_the_sample_it_answers(bench):
    bench.flowing()
    assert bench.link.drive(120, -80, valid_ms=250)
    assert bench.link.drive(1, 2, answers=77)
    assert bench.heard(2) == [Drive(1, 120, -80, 250), Drive(77, 1, 2, 300)]


def test_a_speed_that_no_field_holds_is_our_mistake(bench):
    with pytest.raises(ValueError, match=r"drive\.left_mm_s: expected -32768 to 32767, got 40000"):
        bench.link.drive(40_000, 0)


def test_before_the_first_sample_a_drive_is_a_stop(bench):
    bench.until_came(LinkBack)
    bench.heard(2)
    assert not bench.link.drive(100, 100)
    assert bench.heard(1) == [Drive(0, 0, 0, 0)]
    assert bench.link.counters["refused"] == 1


def test_a_stall_is_told_once_and_stops_the_wheels(bench):
    bench.flowing()
    assert bench.link.drive(100, 100)
    bench.clock.now += 0.5
    assert bench.link.receive() == []
    bench.clock.now += 0.01
    (stalled,) = bench.link.receive()
    assert stalled == Stalled(pytest.approx(0.51))
    assert bench.link.receive() == []
    assert bench.heard(2) == [Drive(1, 100, 100, 300), Drive(1, 0, 0, 0)]
    assert not bench.link.is_flowing


def test_a_stall_is_noticed_by_a_drive_too(bench):
    bench.flowing()
    bench.clock.now += 0.51
    assert not bench.link.drive(100, 100)
    assert bench.heard(1) == [Drive(1, 0, 0, 0)]


def test_after_a_stall_a_sample_makes_the_wheels_free_again(bench):
    bench.flowing()
    bench.clock.now += 0.6
    assert bench.link.receive() == [Stalled(pytest.approx(0.6))]
    bench.say(sample(31))
    assert bench.link.drive(100, 100)
    bench.clock.now += 0.6
    bench.until_came(Stalled)
    assert bench.link.counters["stalls"] == 2


def test_a_port_that_opens_and_says_nothing_is_stalled(bench):
    bench.until_came(LinkBack)
    bench.clock.now += 0.6
    bench.until_came(Stalled)


def test_a_pulled_cable_is_told_once_and_found_again(bench):
    bench.flowing()
    bench.pull()
    (lost,) = bench.until_came(LinkLost)
    assert lost.reason
    assert not bench.link.drive(100, 100)
    assert bench.link.receive(0.05) == []  # several attempts later
    bench.plug()
    assert bench.until_came(LinkBack) == [LinkBack()]
    assert bench.heard(2) == [Drive(1, 0, 0, 0), Heartbeat(1, 1, 3, 0)]
    assert not bench.link.drive(100, 100)  # nothing is known yet of how things are now
    bench.say(sample(10))
    assert bench.link.drive(100, 100)
    assert bench.link.counters["outages"] == 1
    assert bench.link.counters["lost"] == 8


def test_a_port_that_is_not_there_yet_is_told_once_and_found(tmp_path):
    device = tmp_path / "ttyACM0"
    with McuLink(str(device), retry=RETRY) as link, McuPort.open_pty() as mcu:
        (lost,) = link.receive(PATIENCE)
        assert isinstance(lost, LinkLost)
        assert "ttyACM0" in lost.reason
        assert link.receive(0.05) == []
        device.symlink_to(mcu.path)
        assert link.receive(PATIENCE) == [LinkBack()]


def test_a_port_that_another_agent_has_is_refused(bench):
    bench.until_came(LinkBack)
    with McuLink(str(bench.device), retry=RETRY) as second:
        (lost,) = second.receive(PATIENCE)
        assert "lock" in lost.reason


def test_an_url_that_nothing_can_open_is_our_mistake():
    with pytest.raises(ValueError, match="nonsense"):
        McuLink("nonsense://x")


def test_damage_costs_its_frame_only(bench):
    bench.flowing()
    damaged = bytearray(wrap(encode(sample(2))))
    damaged[5] ^= 0x40
    bench.mcu.write(bytes(damaged))
    assert bench.say(sample(3)) == [sample(3)]
    assert bench.link.counters["damaged"] == 1
    assert bench.link.counters["lost"] == 1


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\x02\x01", "length"),
        (b"\x02\x02" + bytes(20), "version"),
        (b"\x63\x01", "kind"),
        (encode(sample(2))[:-1] + b"\x03", "value"),
        (encode(Drive(0, 1, 1, 1)), "direction"),
    ],
)
def test_what_is_none_of_ours_is_counted_under_its_reason(bench, content, reason):
    bench.flowing()
    bench.mcu.write(wrap(content))
    assert bench.say(sample(2)) == [sample(2)]
    assert bench.link.counters[f"unknown_{reason}"] == 1


def test_lost_samples_are_counted_across_the_wrap(bench):
    bench.until_came(LinkBack)
    bench.say(HELLO, sample(2**16 - 3), sample(2**16 - 1), sample(2**16), sample(2**16 + 4))
    assert bench.link.counters["lost"] == 4
    assert bench.link.counters["restarts"] == 0


def test_a_restart_seen_by_its_stamps_is_no_loss_and_asks_for_a_hello(bench):
    bench.flowing()
    bench.say(sample(500))
    bench.say(sample(3))
    assert bench.link.counters["lost"] == 498
    assert bench.link.counters["restarts"] == 1
    bench.clock.now += 1.0
    bench.link.receive()
    assert any(isinstance(frame, Heartbeat) and frame.ask_hello for frame in bench.heard(2))


def test_a_restart_seen_by_its_hello_is_no_loss(bench):
    bench.flowing()
    bench.clock.now += 10.0
    bench.say(HELLO, sample(40), sample(41))
    assert bench.link.counters["lost"] == 0
    assert bench.link.counters["restarts"] == 1


def test_an_answered_hello_is_no_restart(bench):
    bench.until_came(LinkBack)
    bench.say(sample(0))
    bench.say(HELLO, HELLO, sample(2))
    assert bench.link.counters["restarts"] == 0
    assert bench.link.counters["lost"] == 1


def test_a_late_sample_is_counted_and_still_given(bench):
    bench.flowing()
    bench.clock.now += 0.2
    assert bench.say(sample(2)) == [sample(2)]
    assert bench.link.counters["late"] == 1
    bench.say(sample(11))
    assert bench.link.counters["late"] == 1


def test_an_owner_that_does_not_read_loses_the_oldest_and_knows_it(tmp_path):
    bench = Bench(tmp_path, max_frames=10)
    bench.until_came(LinkBack)
    for number in range(50):
        bench.mcu.send(sample(number))
    deadline = time.monotonic() + PATIENCE
    while bench.link.counters["good"] < 50:
        assert time.monotonic() < deadline
    last = [sample(number) for number in range(40, 50)]
    assert samples(bench.until_came(sample(49))) == last
    assert bench.link.counters["dropped_queue_full"] == 40
    assert bench.link.counters["lost"] == 0
    bench.close()


def test_receive_waits_for_what_comes_later(bench):
    bench.until_came(LinkBack)
    later = threading.Timer(0.05, bench.mcu.send, [sample(1)])
    later.start()
    assert bench.link.receive(PATIENCE) == [sample(1)]
    later.join()


def test_a_microcontroller_that_does_not_read_stops_nobody(tmp_path):
    bench = Bench(tmp_path, write_timeout=0.01)
    bench.flowing()
    started = time.monotonic()
    while bench.link.counters["unsent"] < 3:
        bench.link.drive(100, 100)
        assert time.monotonic() - started < PATIENCE
    before = bench.link.counters["sent"]
    heard = bench.heard(before - 2)
    assert bench.link.drive(5, 5)
    assert (heard + bench.heard(1))[-1] == Drive(1, 5, 5, 300)  # not glued to what was cut off
    bench.close()


def test_the_last_words_are_a_stop(bench):
    bench.flowing()
    bench.link.drive(100, 100)
    bench.link.close()
    assert bench.heard(2) == [Drive(1, 100, 100, 300), Drive(1, 0, 0, 0)]


def test_close_leaves_nothing_behind(tmp_path):
    threads, files = threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))
    for pulled in (False, True):
        folder = tmp_path / str(pulled)
        folder.mkdir()
        bench = Bench(folder)
        bench.flowing()
        if pulled:
            bench.pull()
            bench.until_came(LinkLost)
        bench.link.close()
        bench.link.close()
        assert bench.link.receive(1.0) == []
        with pytest.raises(RuntimeError):
            bench.link.drive(0, 0)
        bench.mcu.close()
    assert threading.active_count() == threads
    assert len(list(Path("/proc/self/fd").iterdir())) == files


def test_garbage_never_raises(bench):
    bench.until_came(LinkBack)
    for seed in range(50):
        bench.mcu.write(random.Random(seed).randbytes(700))
        bench.mcu.write(b"\0")
        bench.say(Heartbeat(seed, 0, 0, 0))
    assert bench.link.counters["damaged"] > 100


def test_on_a_loop_a_link_hears_itself():
    with McuLink("loop://", clock=FakeClock()) as link:
        events: list[Event] = []
        while not any(isinstance(event, Heartbeat) for event in events):
            received = link.receive(PATIENCE)
            assert received
            events += received
        assert events == [LinkBack(), Heartbeat(0, 1, 0, 0)]
        assert link.counters["unknown_direction"] == 1  # its own stop


def test_over_a_socket_and_when_the_other_side_hangs_up():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE)
        with McuLink(f"socket://127.0.0.1:{server.getsockname()[1]}", retry=RETRY, clock=FakeClock()) as link:
            for _ in range(2):
                connection, _ = server.accept()
                with connection:
                    connection.settimeout(PATIENCE)
                    assert link.receive(PATIENCE) == [LinkBack()]
                    connection.sendall(wrap(encode(sample(1))))
                    assert link.receive(PATIENCE) == [sample(1)]
                    assert link.drive(10, 20)
                    said = b""
                    while wrap(encode(Drive(1, 10, 20, 300))) not in said:
                        said += connection.recv(1000)
                (lost,) = link.receive(PATIENCE)
                assert isinstance(lost, LinkLost)


def rfc2217_loop(server: socket.socket) -> None:
    """A serial port on the net, whose pins for sending and receiving are joined; serves once."""
    connection, _ = server.accept()
    with connection, serial.serial_for_url("loop://", timeout=0) as port:
        writer = SimpleNamespace(write=connection.sendall)
        manager = serial.rfc2217.PortManager(port, writer)
        while data := connection.recv(1000):
            port.write(b"".join(manager.filter(data)))
            connection.sendall(b"".join(manager.escape(port.read(1000))))


@pytest.mark.filterwarnings("ignore::DeprecationWarning:serial.rfc2217")  # setDaemon, setName
def test_over_rfc2217():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE)
        serving = threading.Thread(target=rfc2217_loop, args=[server])
        serving.start()
        with McuLink(f"rfc2217://127.0.0.1:{server.getsockname()[1]}", clock=FakeClock()) as link:
            assert link.receive(PATIENCE) == [LinkBack()]
            assert link.receive(PATIENCE) == [Heartbeat(0, 1, 0, 0)]
        serving.join(PATIENCE)
        assert not serving.is_alive()


def noisy(stream: bytes, noise: random.Random) -> bytes:
    """The stream with one byte in a thousand changed, and now and then a chunk missing."""
    line = bytearray(stream)
    for at in range(len(line)):
        if noise.random() < 1e-3:
            line[at] ^= noise.randrange(1, 256)
    if noise.random() < 0.01:
        start = noise.randrange(len(line))
        del line[start : start + noise.randrange(1, 120)]
    return bytes(line)


def test_ten_minutes_over_a_bad_line_and_a_pulled_cable(tmp_path, record_property):
    """30,000 samples at 50 Hz in compressed time: none is taken that was not sent so, each missing one is counted."""
    count, batch = 30_000, 20  # so many come at once, as if a buffer held them back for 0.4 s
    bench = Bench(tmp_path, late_after=1.0)
    noise = random.Random(20)
    bench.until_came(LinkBack)
    taken: list[Sample] = []
    events: Counter[type] = Counter()
    started = time.monotonic()
    for first in range(0, count, batch):
        if first == count // 2:
            bench.pull()
            bench.until_came(LinkLost)
        if first == count // 2 + 500:
            bench.plug()
            bench.until_came(LinkBack)
        bench.clock.now += batch * 0.02
        if count // 2 <= first < count // 2 + 500:
            assert not bench.link.drive(100, 100)  # the cable is out
            continue
        stream = b"".join(wrap(encode(sample(number))) for number in range(first, first + batch))
        line = stream if first in {0, count - batch} else noisy(stream, noise)
        bench.mcu.write(line + b"\0")
        came = bench.say(Heartbeat(first // batch, 0, 0, 0))  # undamaged: all before it has been read
        taken += samples(came)
        events.update(map(type, came))
        bench.link.drive(100, 100)
        bench.mcu.receive()
    counters = bench.link.counters
    figures = {"seconds": round(time.monotonic() - started, 1), "samples": count, "taken": len(taken), **counters}
    record_property("figures", figures)
    print(figures)
    assert taken == [sample(one.left_ticks) for one in taken]  # nothing but what was sent
    assert len({one.left_ticks for one in taken}) == len(taken)
    assert counters["lost"] == count - len(taken)
    assert 28_000 < len(taken) < 29_000
    assert counters["damaged"] > 1000
    assert (counters["restarts"], counters["late"], counters["dropped_queue_full"], events[Stalled]) == (0, 0, 0, 0)
    assert (counters["outages"], events[LinkLost], events[LinkBack]) == (1, 0, 0)  # told once, and read above
    bench.close()
