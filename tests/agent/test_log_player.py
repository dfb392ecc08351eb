"""A log at any time: the same as a peer that heard only what had been recorded until then, however one came there."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agent import log_player
from agent.config import Config
from agent.errors import UserError
from agent.log_player import LogPlayer
from agent.log_reader import LogReader
from agent.overview import Overview
from agent.page_orders import Evict, Play, Seek
from agent.page_tracks import Tracks
from agent.recorder import Recorder
from mapping.pose import QuantisedPose
from mapping.tiles import map_digest
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor

CONFIG = Config(cell=0.05)


@pytest.fixture
def log(tmp_path, watched, straight) -> Path:
    """Two robots map, one is evicted, readmitted, and replaced by a session of its own."""
    path = tmp_path / "run.mcap"
    recorder = Recorder(path, CONFIG.toml().decode(), lambda: 10**18 + round(watched.now * 1e9))
    watched.listeners.append(recorder)
    turn = recorder.watch(watched.observer)

    def go(name: str, first: int, count: int) -> None:
        for k in range(first, first + count):
            watched.sense(name, straight(4, y_mm=60 * k, first_ms=1000 * k))
            turn(watched.now)

    first = watched.robot("r1")
    watched.robot("r2", QuantisedPose(500, 0, 9000))
    go("r1", 0, 12)
    go("r2", 0, 12)
    watched.observer.evict(first, watched.now)
    go("r2", 12, 6)
    watched.observer.readmit(first, watched.now)
    go("r1", 12, 6)
    robot = watched._robots["r1"]
    again = Descriptor("r1", b"again-r1", watched.RULES, robot.writer.replica.descriptor.sensor, None, first)
    robot.open_session(again)
    go("r1", 20, 8)
    assert recorder.close()["log"]["status"] == ""
    return path


@pytest.fixture
def player(log, monkeypatch) -> LogPlayer:
    """Has read it all, and has kept as few states as it may."""
    monkeypatch.setattr(log_player, "KEEP_EVERY", 5)
    monkeypatch.setattr(log_player, "MOST_TILES", 20)
    player = LogPlayer(log)
    assert not player.read(math.inf)
    assert player._keep_every > 5
    assert len(player._kept) > 2
    return player


def truth(log: Path, seconds: float) -> tuple[Peer, Tracks]:
    """A peer that has heard only what was recorded until then."""
    tracks = Tracks()
    peer = Peer(Hello(0, b"t", b""), CONFIG.rules(), seed=b"t", mtu=32_768, now=0.0, listener=tracks)
    began = None
    for log_ns, told in LogReader(log).told():
        began = log_ns if began is None else began
        if (log_ns - began) / 1e9 <= seconds:
            peer.repeat(told, 0.0)
    return peer, tracks


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(shares=st.lists(st.floats(0, 1.1), min_size=1, max_size=4))
def test_wherever_one_jumps_it_is_as_it_was_then(log, player, shares) -> None:
    for share in shares:
        player.obey(Seek(share * player.duration), 0.0)
        shown = player.take(0.0)
        peer, tracks = truth(log, shown.timeline.seconds)
        assert map_digest(shown.fused) == peer.fusion.digest()
        assert {view.session for view in shown.sessions} == peer.descriptors.keys()
        for view in shown.sessions:
            standing, replica = view.contribution, peer.replicas.get(view.session)
            assert standing.n == (0 if replica is None else replica.state.n)
            assert map_digest(view.tiles) == map_digest({} if replica is None else replica.state.cells)
            assert standing.summed == (
                replica is not None
                and standing.descriptor.start is not None
                and view.session not in peer.controls.evicted
            )
            if replica is not None:
                assert (view.track.trail == tracks.of(view.session).trail).all()
                assert view.track.hits_in_all == tracks.of(view.session).hits_in_all


def test_what_is_told_of_a_time_does_not_depend_on_the_way_there(log, player, monkeypatch) -> None:
    monkeypatch.setattr(log_player, "KEEP_EVERY", 10**9)
    from_the_beginning = LogPlayer(log)
    from_the_beginning.read(math.inf)
    for share in np.linspace(0, 1, 15):
        told = []
        for each in (player, from_the_beginning):
            each.obey(Seek(share * player.duration), 0.0)
            told.append(Overview("lab", []).of(each.take(0.0), exact=True))
        assert told[0] == told[1]


def test_it_begins_at_the_end_and_plays_from_the_beginning(log, player) -> None:
    shown = player.take(50.0)
    assert shown.timeline.seconds == shown.timeline.duration == player.duration > 0
    assert map_digest(shown.fused) == truth(log, math.inf)[0].fusion.digest()
    player.obey(Play(2.0), 50.0)
    assert player.take(50.0).timeline.seconds == 0.0
    assert player.take(51.5).timeline.seconds == 3.0
    player.obey(Play(0.0), 51.5)
    assert player.take(60.0).timeline.seconds == 3.0
    player.obey(Play(1.0), 60.0)
    assert player.take(60.5).timeline.seconds == 3.5
    end = player.take(1000.0).timeline
    assert (end.seconds, end.speed) == (player.duration, 0.0)


def test_whoever_goes_to_the_end_that_he_is_told_of_is_there(player) -> None:
    player._times[-1] += 0.0004  # no log ends with a whole millisecond
    player.obey(Seek(0.0), 0.0)
    told = Overview("lab", []).of(player.take(0.0))["timeline"]
    player.obey(Seek(told["duration"]), 0.0)
    assert player._at_end


def test_what_has_been_read_can_be_shown_while_the_rest_is_read(log, player) -> None:
    reading = LogPlayer(log)
    assert reading.take(0.0).timeline.duration == 0.0
    for _ in range(20):
        reading._hear_next()
    shown = reading.take(0.0).timeline
    assert 0 < shown.seconds == shown.duration < player.duration
    assert not shown.whole
    assert not reading.read(math.inf)
    assert reading.take(0.0).timeline.seconds == player.duration


def test_the_history_is_that_of_the_whole_log(player) -> None:
    rows = player.take(0.0).timeline.history
    assert [row.seconds for row in rows] == sorted({row.seconds for row in rows})
    assert rows[-1].seconds == pytest.approx(player.duration, abs=0.1)
    assert rows[0].known_m2 <= max(row.known_m2 for row in rows) > 0


def test_in_a_log_nothing_can_be_decided(player) -> None:
    with pytest.raises(ValueError, match="this is a log"):
        player.obey(Evict(b"r1r1r1r1", readmit=False), 0.0)


def test_a_torn_log_is_shown_up_to_the_tear(log, tmp_path) -> None:
    data = log.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: len(data) * 2 // 3])
    player = LogPlayer(torn)
    assert not player.read(math.inf)
    timeline = player.take(0.0).timeline
    assert timeline.torn.startswith("torn off")
    assert timeline.duration > 0


def test_what_is_no_log_is_refused(tmp_path) -> None:
    (tmp_path / "x.mcap").write_text("no")
    with pytest.raises(UserError, match="is no MCAP file"):
        LogPlayer(tmp_path / "x.mcap")
