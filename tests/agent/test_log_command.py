"""``orion log`` on a log of two robots, one of which was corrected."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from agent.config import Config
from agent.errors import UserError
from agent.log_command import app
from agent.log_reader import LogReader
from agent.recorder import Recorder
from agent.repeater import Repeater, log_config
from mapping.pose import QuantisedPose
from mapping.scan import quantise
from mapping.sensor import orion
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor
from swarm.told import Told

CONFIG = Config.model_validate({"cell": 0.05, "swarm": "lab", "robots": {"r2": {}, "r1": {}}})


@pytest.fixture
def made(tmp_path: Path) -> tuple[Path, Peer]:
    """The log of a peer that wrote sessions of r1, of r2, and one in place of r1's."""
    rules = CONFIG.rules()
    recorder = Recorder(tmp_path / "run.mcap", CONFIG.toml().decode())
    peer = Peer(Hello(Hello.ROBOT, b"r1", b"test"), rules, seed=b"r1", mtu=32_768, now=0.0, listener=recorder)
    watch = recorder.watch(peer)
    for robot, session, replaces in (("r1", b"\1", None), ("r2", b"\2", None), ("r1", b"\3", b"\1")):
        start = QuantisedPose(0, 0, 0)
        writer = peer.open_session(Descriptor(robot, session * 8, rules, orion(), start, replaces and replaces * 8))
        for k in range(5):
            writer.sense(quantise([0.1 * k], [[0.1 * k, 0.0, 0.1]], [[0.5] * 5], orion()))
            peer.flush(0.0)
    peer.evict(b"\2" * 8, 0.0)
    watch(0.0)
    assert recorder.close()["log"]["status"] == ""
    return tmp_path / "run.mcap", peer


def run(*words: object, status: int = 0) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    if isinstance(result.exception, UserError):
        raise result.exception
    assert result.exit_code == status, result.output
    return result.stdout


def test_info_tells_what_is_in_it(made: tuple[Path, Peer]) -> None:
    path, peer = made
    facts = json.loads(run("info", path, "--json"))
    assert (facts["swarm"], facts["torn"]) == ("lab", "")
    assert facts["map_digest"] == peer.fusion.digest().hex()
    assert facts["sessions"] == [
        {"robot": "r2", "session": "02" * 8, "updates": 5},
        {"robot": "r1", "session": "03" * 8, "updates": 5},
    ]
    assert {"topic": "/orion", "type": "std_msgs/msg/UInt8MultiArray", "messages": 3 + 15 + 1} in facts["topics"]
    assert "whole" in run("info", path)
    path.write_bytes(path.read_bytes()[:-40])
    assert "recover" in run("info", path)


def test_a_rosbag2_folder_holds_every_message(made: tuple[Path, Peer], tmp_path: Path) -> None:
    path, _ = made
    run("export", path, "--rosbag2", tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as bag:
        found = [(connection.topic, stamp, bytes(data)) for connection, stamp, data in bag.messages()]
    assert found == [(each.topic, each.log_ns, each.data) for each in LogReader(path)]
    (database,) = (tmp_path / "bag").glob("*.db3")
    with sqlite3.connect(database) as tables:  # ros2 bag's own tables
        assert tables.execute("SELECT count(*) FROM messages").fetchone() == (len(found),)
    tables.close()
    with pytest.raises(UserError, match="give a new folder"):
        run("export", path, "--rosbag2", tmp_path / "bag")


def test_trajectories_are_those_of_the_sessions_that_count(made: tuple[Path, Peer], tmp_path: Path) -> None:
    path, _ = made
    np.savez(
        tmp_path / "truth.npz",
        robots=["r1"],
        stamps_ms=np.array([0, 100]),
        poses=np.array([[[1, 2, 0]], [[3, 4, np.pi]]]),
    )
    run("export", path, "--tum", tmp_path / "tum", "--truth", tmp_path / "truth.npz")
    assert sorted(each.name for each in (tmp_path / "tum").iterdir()) == ["r1-truth.tum", "r1.tum", "r2.tum"]
    table = np.loadtxt(tmp_path / "tum" / "r1.tum")
    assert table[:, 0].tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert table[:, 1].tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert np.allclose(2 * np.arctan2(table[:, 6], table[:, 7]), 0.1, atol=1e-4)
    truth = np.loadtxt(tmp_path / "tum" / "r1-truth.tum")
    assert truth[:, :3].tolist() == [[1.0, 1.0, 2.0], [1.1, 3.0, 4.0]]


@pytest.fixture(params=["ros2msg", "protobuf", ""])
def strange(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """An MCAP file of somebody else."""
    with (tmp_path / "strange.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foo/msg/Bar", request.param, b"\xff\x00") if request.param else 0
        channel = writer.register_channel("/bar", "cdr", schema)
        writer.add_message(channel, 1, b"....", 1)
        writer.finish()
    return tmp_path / "strange.mcap"


@pytest.mark.parametrize(
    "words", [["info"], ["show"], ["recover", "out.mcap"], ["export", "--tum", "tum"], ["export", "--rosbag2", "bag"]]
)
def test_a_file_of_somebody_else_is_refused_in_words(strange: Path, tmp_path: Path, words: list[str]) -> None:
    run_in = [str(tmp_path / word) if "." in word or word in {"tum", "bag"} else word for word in words[1:]]
    with pytest.raises(UserError, match="holds no configuration"):
        run(words[0], strange, *run_in)
    assert [each.name for each in tmp_path.iterdir()] == ["strange.mcap"]


def test_what_is_no_truth_is_refused_in_words(made: tuple[Path, Peer], tmp_path: Path) -> None:
    np.save(tmp_path / "poses.npy", np.zeros(3))
    (tmp_path / "text.npz").write_text("no")
    np.savez(tmp_path / "map.npz", cells=np.zeros(3))
    for name in ("poses.npy", "text.npz", "map.npz"):
        with pytest.raises(UserError, match="holds no true ways"):
            run("export", made[0], "--tum", tmp_path / "tum", "--truth", tmp_path / name)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["export", "run.mcap"], "has nothing to write"),
        (["export", "run.mcap", "--truth", "t.npz", "--rosbag2", "bag"], "give --tum"),
        (["export", "none.mcap", "--tum", "tum"], "cannot be read"),
        (["recover", "run.mcap", "run.mcap"], "is there already"),
    ],
)
def test_what_cannot_be_done_is_told(
    made: tuple[Path, Peer], monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(made[0].parent)
    with pytest.raises(UserError, match=message):
        run(*words)


def test_repeaters_say_together_what_the_log_holds(made: tuple[Path, Peer]) -> None:
    path, peer = made
    config = log_config(Config(base_port=9000), path, "max")
    assert config.roster == ["r2", "r1"]
    assert (config.cell, config.swarm, config.base_port) == (0.05, "lab", 9000)
    again = Peer(Hello(Hello.ROBOT, b"x", b"test"), config.rules(), seed=b"x", mtu=32_768, now=0.0)

    def say(told: Told) -> None:
        again.repeat(told, 0.0)

    for robot, scans in (("r1", 10), ("r2", 5)):
        body = Repeater(path, robot, say)
        assert body.scans == scans
        body.read(0.0)
        assert body.progress[0] == 0
        while not body.done:
            body.read(float("inf"))
    assert again.fusion.digest() == peer.fusion.digest()
    assert again.controls.check == peer.controls.check
    assert again.descriptors.keys() == peer.descriptors.keys()
    with pytest.raises(UserError, match="holds no session of robot r3"):
        Repeater(path, "r3", say)


def test_messages_are_due_when_they_were_recorded(tmp_path: Path) -> None:
    rules, clock = CONFIG.rules(), [10**18]
    recorder = Recorder(tmp_path / "run.mcap", CONFIG.toml().decode(), lambda: clock[0])
    peer = Peer(Hello(Hello.ROBOT, b"r1", b"test"), rules, seed=b"r1", mtu=32_768, now=0.0, listener=recorder)
    recorder.watch(peer)
    writer = peer.open_session(Descriptor("r1", b"\1" * 8, rules, orion(), QuantisedPose(0, 0, 0)))
    for k in range(5):
        clock[0] = 10**18 + 2 * k * 10**9
        writer.sense(quantise([0.1 * k], [[0.1 * k, 0.0, 0.1]], [[0.5] * 5], orion()))
        peer.flush(0.0)
    recorder.close()
    said: list[Told] = []
    body = Repeater(tmp_path / "run.mcap", "r1", said.append)
    counts = []
    for until in (0.0, 1.0, 3.0, 4.5, 100.0):
        body.read(until)
        counts.append(len(said))
    assert counts == [0, 2, 3, 4, 6]


def test_a_robots_agent_needs_none_of_the_packages_of_logs() -> None:
    modules = "import sys, agent.robot, agent.observer, agent.launch, agent.cli, agent.node, agent.keeper, agent.links"
    test = "sys.exit(str({'mcap', 'rosbags', 'zstandard', 'lz4'} & sys.modules.keys()) if "
    test += "{'mcap', 'rosbags'} & sys.modules.keys() else 0)"
    subprocess.run([sys.executable, "-c", f"{modules}; {test}"], check=True)


def test_what_is_no_log_is_not_shown(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_text("no")
    result = CliRunner().invoke(app, ["show", str(tmp_path / "x.mcap"), "--no-open"])
    assert isinstance(result.exception, UserError)
    assert "is no MCAP file" in str(result.exception)
