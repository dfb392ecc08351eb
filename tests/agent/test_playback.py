"""Recordings as values: the way in, splitting, and playing back."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.body import BATCH, Body
from agent.errors import UserError
from agent.playback import RecordedBody, read, split
from agent.readings import Readings
from agent.recording import Recording
from mapping.pose import Pose, QuantisedPose
from mapping.scan import Scans
from mapping.sensor import laser

SENSOR = laser(3, first=-0.5, step=0.5, max_range=5.0)
AT_ORIGIN = QuantisedPose(0, 0, 0)


def run(stamps: list[float], x: list[float] | None = None) -> Recording:
    """A run along the x axis, 1 m a scan unless told otherwise."""
    count = len(stamps)
    poses = np.zeros((count, 3))
    poses[:, 0] = np.arange(count) if x is None else x
    ranges = np.tile([1.0, np.nan, np.inf], (count, 1))
    return Recording("run", np.array(stamps, np.float64), poses, ranges, SENSOR)


def drain(body: RecordedBody, until: float = math.inf) -> list[Readings]:
    batches = []
    while len(batch := body.read(until)):
        assert len(batch) <= BATCH
        batches.append(batch)
    return batches


def positions(batches: list[Readings]) -> list[float]:
    return [x for batch in batches for x in batch.poses[:, 0].tolist()]


def scans(recording: Recording, start: QuantisedPose) -> Scans:
    return Scans.join([batch.scans(start, recording.sensor) for batch in drain(RecordedBody(recording))])


# A value


def test_shapes_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ValueError, match=r"poses \(2, 3\)"):
        Recording("run", np.zeros(2), np.zeros((1, 3)), np.zeros((2, 3)), SENSOR)
    with pytest.raises(ValueError, match="at least 1 stamp"):
        Recording("run", np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), SENSOR)


# The way in


def test_a_path_that_leads_nowhere_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"nowhere\.log: there is no such file"):
        read(tmp_path / "nowhere.log")


def test_a_path_that_no_file_can_have_is_refused(tmp_path: Path) -> None:
    for name in ("x" * 5000, "nul\0byte"):
        with pytest.raises(UserError):
            read(tmp_path / name)


def test_poses_of_an_unknown_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--poses: 'gps' is unknown; choose one of truth, odometry, slam"):
        read(tmp_path, poses="gps")


def test_a_folder_is_read_as_nano_swarm_and_a_file_as_carmen(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"scans\.csv: there is no such file"):
        read(tmp_path)
    log = tmp_path / "run.log"
    log.write_text("FLASER 2 1.0 2.0 0 0 0 0 0 0 7.5 host 7.5\n")
    (recording,) = read(log)
    assert recording.name == "run"
    assert recording.poses.shape == (1, 3)


# Splitting


def test_pieces_have_equal_path_length() -> None:
    pieces = split(run([0.0] * 10), 3)
    assert [piece.poses[:, 0].tolist() for piece in pieces] == [[0, 1, 2], [3, 4, 5], [6, 7, 8, 9]]


def test_waiting_does_not_count_as_path() -> None:
    pieces = split(run([0.0] * 8, x=[0, 0, 0, 0, 0, 0, 1, 2]), 2)
    assert [len(piece) for piece in pieces] == [6, 2]


def test_one_piece_is_the_recording_itself() -> None:
    whole = run([0.0, 1.0])
    assert split(whole, 1) == [whole]


def test_each_piece_has_its_own_clock_and_name() -> None:
    pieces = split(run([0.0, 1.0, 2.0, 1.5]), 2)
    assert [piece.stamps.tolist() for piece in pieces] == [[0.0, 1.0], [0.0, -0.5]]
    assert [piece.name for piece in pieces] == ["run 1/2", "run 2/2"]


@pytest.mark.parametrize("parts", [-1, 0, 4])
def test_a_number_of_pieces_that_cannot_be_is_refused(parts: int) -> None:
    with pytest.raises(UserError, match="3 scans cannot become"):
        split(run([0.0, 1.0, 2.0]), parts)


def test_a_piece_without_a_scan_is_refused() -> None:
    with pytest.raises(UserError, match=r"piece 1 of 2 of its 0\.00 m of path has no scan"):
        split(run([0.0] * 3, x=[0, 0, 0]), 2)
    with pytest.raises(UserError, match="piece 2 of 3"):
        split(run([0.0] * 3, x=[0, 0.1, 9]), 3)


@given(steps=st.lists(st.floats(0, 10), min_size=1, max_size=40), parts=st.integers(1, 6))
def test_every_scan_is_in_exactly_one_piece(steps: list[float], parts: int) -> None:
    whole = run([0.0] * len(steps), x=np.cumsum(steps).tolist())
    try:
        pieces = split(whole, parts)
    except UserError:
        return
    assert len(pieces) == parts
    assert np.array_equal(np.concatenate([piece.poses for piece in pieces]), whole.poses)
    assert sum(len(piece.ranges) for piece in pieces) == len(whole)


# Playing back


def test_a_recorded_body_is_a_body() -> None:
    body: Body = RecordedBody(run([0.0]))
    assert body.sensor is SENSOR


def test_scans_come_when_they_are_due_and_once() -> None:
    body = RecordedBody(run([10.0, 11.0, 12.0]))
    assert len(body.read(0.0)) == 0  # the first is sensed at 0, not before
    assert len(body.read(1.0)) == 1
    assert len(body.read(1.0)) == 0
    assert len(body.read(0.5)) == 0
    assert body.progress == (1, 3)
    assert not body.done
    assert len(body.read(2.5)) == 2
    assert body.done
    assert body.progress == (3, 3)


def test_a_clock_that_steps_back_delays_nothing_and_reorders_nothing() -> None:
    recording = run([0.0, 1.0, 0.2, 0.9, 1.1])
    assert recording.due.tolist() == [0.0, 1.0, 1.0, 1.0, 1.1]
    (batch,) = drain(RecordedBody(recording))
    assert batch.poses[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert batch.stamps_ms.tolist() == [0, 1000, 1000, 1000, 1100]


def test_batches_are_bounded() -> None:
    body = RecordedBody(run([0.0] * (2 * BATCH + 1)))
    assert [len(body.read(math.inf)) for _ in range(4)] == [BATCH, BATCH, 1, 0]


def test_readings_are_the_recorded_ones_wherever_the_robot_is_placed() -> None:
    recording = run([0.0, 1.0])
    body = RecordedBody(recording)
    body.place(QuantisedPose(1000, 2000, 16384))
    (batch,) = drain(body)
    assert np.array_equal(batch.poses, recording.poses)
    assert np.array_equal(batch.ranges, recording.ranges, equal_nan=True)


@given(
    stamps=st.lists(st.floats(-5, 5), min_size=1, max_size=200),
    untils=st.lists(st.floats(-1, 12), max_size=20),
)
def test_however_it_is_asked_a_body_gives_every_scan_once_in_order(stamps: list[float], untils: list[float]) -> None:
    recording = run(stamps)
    body = RecordedBody(recording)
    batches = []
    for until in untils:
        batches.append(body.read(until))
        assert (batches[-1].stamps_ms <= round(until * 1000)).all()
    assert positions([*batches, *drain(body)]) == list(range(len(stamps)))


# Real recordings


@pytest.mark.recordings
@pytest.mark.parametrize("robots", [2, 3])
def test_intel_splits_as_its_published_parts_do(recordings_dir: Path, robots: int) -> None:
    carmen = recordings_dir / "carmen"
    (whole,) = read(carmen / "intel-corrected.log.gz")
    published = json.loads((carmen / f"intel_{robots}robots.json").read_text())["robots"]
    pieces = split(whole, robots)
    assert [len(piece) for piece in pieces] == [robot["scans"] for robot in published]


@pytest.mark.recordings
@pytest.mark.parametrize("robots", [2, 3])
def test_parts_with_their_start_poses_are_the_whole(recordings_dir: Path, robots: int) -> None:
    carmen = recordings_dir / "carmen"
    (whole,) = read(carmen / "intel-corrected.log.gz")
    published = json.loads((carmen / f"intel_{robots}robots.json").read_text())["robots"]
    for piece, robot in zip(split(whole, robots), published, strict=True):
        (part,) = read(carmen / robot["file"])
        apart = Pose(*robot["start_pose"]).compose(part.poses) - piece.poses
        assert np.abs(apart[:, :2]).max() <= 0.002
        assert np.abs(np.angle(np.exp(1j * apart[:, 2]))).max() <= 1e-4
        assert np.array_equal(part.ranges, piece.ranges, equal_nan=True)


@pytest.mark.recordings
@pytest.mark.parametrize("robots", [2, 3])
def test_played_back_with_quantised_starts_parts_are_the_whole(recordings_dir: Path, robots: int) -> None:
    """Two roundings lie between them, the start's and the scan's: 1 mm each way and, far from the start, its yaw's."""
    carmen = recordings_dir / "carmen"
    (whole,) = read(carmen / "intel-corrected.log.gz")
    published = json.loads((carmen / f"intel_{robots}robots.json").read_text())["robots"]
    for piece, robot in zip(split(whole, robots), published, strict=True):
        (part,) = read(carmen / robot["file"])
        start = QuantisedPose.of(Pose(*robot["start_pose"]))
        apart = scans(part, start).poses - scans(piece, AT_ORIGIN).poses
        assert np.abs(apart[:, :2]).max() <= 3
        assert np.abs((apart[:, 2] + 32768) % 65536 - 32768).max() <= 2
