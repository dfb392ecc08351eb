"""A log: what is written is read again by us and by others, also when its end was torn off."""

from __future__ import annotations

import errno
import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from agent.config import Config
from agent.errors import UserError
from agent.log_reader import LogReader
from agent.log_tools import recover, told_again
from agent.log_writer import LogWriter
from agent.recorder import Recorder
from mapping.evidence import probability
from mapping.grid import Grid
from mapping.pose import QuantisedPose
from mapping.scan import quantise
from mapping.sensor import orion
from swarm.messages import Hello, Session, encode
from swarm.peer import Peer
from swarm.session import Descriptor

CONFIG = Config(cell=0.05)
BEGAN_NS = 1_700_000_000_000_000_000


class Run:
    """A robot that drives along a wall, a peer that hears it, and that peer's log; a turn is 0.1 s."""

    def __init__(self, folder: Path, name: str = "run.mcap") -> None:
        self.path = folder / name
        self.now = 0.0
        self.recorder = Recorder(self.path, CONFIG.toml().decode(), lambda: BEGAN_NS + round(self.now * 1e9))
        rules = CONFIG.rules()
        self.robot = Peer(Hello(Hello.ROBOT, b"r1", b"test"), rules, seed=b"r1", mtu=32_768, now=0.0)
        self.peer = Peer(
            Hello(Hello.OBSERVER, b"o", b"test"), rules, seed=b"o", mtu=32_768, now=0.0, listener=self.recorder
        )
        self.writer = self.robot.open_session(Descriptor("r1", b"\x01" * 8, rules, orion(), QuantisedPose(0, 0, 0)))
        self.peer.receive("r1", encode(Session(self.writer.replica.descriptor.encode())), 0.0)
        self.watch = self.recorder.watch(self.peer)

    def turns(self, count: int) -> None:
        for _ in range(count):
            self.now += 0.1
            ranges = [[0.5, math.inf, math.nan, 0.3, 0.2]]
            self.writer.sense(quantise([self.now], [[0.01 * self.now, 0.2, 0.1 * self.now]], ranges, orion()))
            self.robot.flush(self.now)
            for update in self.writer.replica.updates_after(self.peer.replicas[b"\x01" * 8].state.n):
                self.peer.receive("r1", encode(update), self.now)
            self.watch(self.now)

    def ends(self) -> Path:
        facts = self.recorder.close()["log"]
        assert facts["status"] == ""
        return self.path


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    run = Run(tmp_path)
    yield run
    run.recorder.abandon()


def test_the_swarm_comes_out_of_the_log_as_it_was(run: Run) -> None:
    run.turns(35)
    again, poses = told_again(LogReader(run.ends()))
    assert again.fusion.digest() == run.peer.fusion.digest()
    assert {s: (r.state.n, r.state.root()) for s, r in again.replicas.items()} == {
        s: (r.state.n, r.state.root()) for s, r in run.peer.replicas.items()
    }
    assert len(poses.of(b"\x01" * 8)) == 35


def test_the_mcap_library_and_rosbags_read_what_we_wrote(run: Run) -> None:
    run.turns(25)
    path = run.ends()
    ours = list(LogReader(path))
    with path.open("rb") as file:
        theirs = [
            (channel.topic, message.log_time, message.data) for _, channel, message in make_reader(file).iter_messages()
        ]
    assert [(each.topic, each.log_ns, each.data) for each in ours] == theirs
    assert all(a.log_ns < b.log_ns for a, b in pairwise(ours))
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as bag:  # the definitions are in the file
        found = [
            (connection.topic, bag.deserialize(data, connection.msgtype)) for connection, _, data in bag.messages()
        ]
    assert [topic for topic, _ in found] == [each.topic for each in ours]
    poses = [message for topic, message in found if topic == "/r1/pose"]
    assert [(pose.header.stamp.sec, pose.header.stamp.nanosec) for pose in poses] == [
        divmod(round(100 * (k + 1)) * 1_000_000, 1_000_000_000) for k in range(25)
    ]
    assert {pose.header.frame_id for pose in poses} == {"map"}
    chart = [message for topic, message in found if topic == "/map"][-1]
    grid = Grid.of(run.peer.fusion.tiles, run.peer.rules.lattice)
    assert (chart.info.height, chart.info.width) == grid.evidence.shape
    assert (chart.info.origin.position.x, chart.info.origin.position.y) == grid.origin
    expected = np.where(grid.evidence == 0, -1, np.rint(100 * probability(grid.evidence)))
    assert np.array_equal(chart.data.reshape(grid.evidence.shape), expected)
    assert {topic for topic, _ in found} == {"/map", "/orion", "/r1/hits", "/r1/pose", "/r1/scan", "/tf"}


def test_wherever_a_log_is_torn_all_before_it_is_there(run: Run, tmp_path: Path) -> None:
    """Flushed each second: what is missing is younger than a second when the process is killed."""
    head = run.path.stat().st_size
    run.turns(10)
    sizes = []
    for _ in range(4):
        run.turns(10)
        sizes.append(run.path.stat().st_size)
    assert sizes == sorted(set(sizes))  # every second something reaches the file
    whole = run.path.read_bytes()  # nobody closed it
    original = [(each.topic, each.data) for each in LogReader(run.path)]
    for size in [*range(head, len(whole), 977), len(whole)]:
        torn = tmp_path / f"torn-{size}.mcap"
        torn.write_bytes(whole[:size])
        out = tmp_path / f"out-{size}.mcap"
        count, why = recover(torn, out)
        assert why.startswith("torn off")
        back = LogReader(out)
        assert [(each.topic, each.data) for each in back] == original[:count]
        assert back.torn == ""
        assert back.configuration == CONFIG.toml().decode()
        told_again(back)
    again, _ = told_again(LogReader(run.path))
    assert 0 <= run.peer.replicas[b"\x01" * 8].state.n - again.replicas[b"\x01" * 8].state.n <= 10


def test_a_flipped_bit_ends_the_log_before_it(run: Run, tmp_path: Path) -> None:
    run.turns(30)
    data = bytearray(run.ends().read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "bad.mcap").write_bytes(data)
    log = LogReader(tmp_path / "bad.mcap")
    found = [each.data for each in log]
    assert log.torn
    assert found == [each.data for each in LogReader(run.path)][: len(found)]


def test_a_log_is_never_overwritten(run: Run) -> None:
    with pytest.raises(UserError, match="is there already"):
        Recorder(run.path, "")


@pytest.mark.parametrize("content", [b"", b"MCAP", b"\x89PNG\r\n\x1a\n"])
def test_another_file_is_no_log(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(UserError, match="is no MCAP file"):
        LogReader(tmp_path / "x.mcap")


def test_a_full_disk_stops_the_log_and_not_the_swarm(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(log: LogWriter) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    run.turns(15)
    monkeypatch.setattr(LogWriter, "flush", full)
    run.turns(15)
    assert run.peer.replicas[b"\x01" * 8].state.n == 30
    status = run.recorder.close()["log"]["status"]
    assert status == f"{run.path}: cannot be written: No space left on device; nothing more is recorded"
    assert len(told_again(LogReader(run.path))[1].of(b"\x01" * 8)) >= 5
