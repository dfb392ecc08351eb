"""nano_swarm folders: geometry of the beams, which poses, and that no damage raises anything but a UserError."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.errors import UserError
from agent.nano_swarm import FRAMES, drone, read
from agent.playback import RecordedBody
from agent.recording import Recording

Offsets = tuple[float, float, float]


def node(mm: int = 500, offset: Offsets = (0.0, 0.0, 0.0), frames: int = FRAMES) -> str:
    """A node's hex: every reading the same, every frame's offset a multiple of the given one."""
    content = struct.pack("<HH", 7, 0)
    for k in range(frames):
        content += struct.pack("<32h3f", *[mm] * 32, *(k * part for part in offset))
    return content.hex()


def vicon(x: float, y: float, yaw: float) -> str:
    return f"{x},{y},0.6,{math.cos(yaw / 2)},0.0,0.0,{math.sin(yaw / 2)}"


def write(folder: Path, scans: dict[str, str], truth: dict[str, str], estimates: list[tuple[str, str]]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "scans.csv").write_text("".join(f"{key},{digits}\n" for key, digits in scans.items()))
    (folder / "vicon_poses.csv").write_text("".join(f"{key},{row}\n" for key, row in truth.items()))
    (folder / "poses.csv").write_text("".join(f"{key},{row}\n" for key, row in estimates))
    return folder


@pytest.fixture
def maze(tmp_path: Path) -> Path:
    """Two robots: r0 with nodes 0 and 1, r1 with node 0; poses.csv also knows a node that was never scanned."""
    return write(
        tmp_path / "maze",
        {"0/0": node(), "0/1": node(-1, (0.01, 0.0, 0.02)), "1/0": node(700)},
        {"0/0": vicon(0, 0, 0), "0/1": vicon(1, 2, 0.5), "1/0": vicon(-1, 0, 3)},
        [("0/0", "0,0,0"), ("0/1", "5,5,0.1"), ("1/0", "1,1,1"), ("0/2", "9,9,9"), ("0/1", "6,6,0.2")],
    )


# What a folder holds


def test_each_robot_becomes_a_recording_of_15_frames_a_node(maze: Path) -> None:
    first, second = read(maze)
    assert (first.name, second.name) == ("maze/0", "maze/1")
    assert first.ranges.shape == (30, 32)
    assert second.ranges.shape == (15, 32)


def test_a_frames_pose_is_its_nodes_plus_its_offset(maze: Path) -> None:
    poses = read(maze)[0].poses
    assert poses[:15] == pytest.approx(np.zeros((15, 3)))
    k = np.arange(15)
    assert poses[15:] == pytest.approx(np.column_stack([1 + 0.01 * k, 2 + 0 * k, 0.5 + 0.02 * k]), abs=1e-6)


@pytest.mark.parametrize(
    ("poses", "expected"),
    [(None, (1, 2, 0.5)), ("truth", (1, 2, 0.5)), ("odometry", (5, 5, 0.1)), ("slam", (6, 6, 0.2))],
)
def test_the_trajectory_can_be_chosen(maze: Path, poses: str | None, expected: Offsets) -> None:
    assert read(maze, poses=poses)[0].poses[15] == pytest.approx(expected)


def test_odometry_needs_no_motion_capture(maze: Path) -> None:
    (maze / "vicon_poses.csv").unlink()
    assert len(read(maze, poses="odometry")) == 2
    with pytest.raises(UserError, match=r"vicon_poses\.csv: there is no such file"):
        read(maze)


def test_frames_are_evenly_spaced_in_time(maze: Path) -> None:
    assert read(maze)[0].stamps == pytest.approx(np.arange(30) / 15)


def test_nodes_are_in_order_whatever_the_files(tmp_path: Path) -> None:
    folder = write(
        tmp_path / "maze",
        {"0/10": node(), "0/9": node(), "0/2": node()},
        {f"0/{k}": vicon(k, 0, 0) for k in (9, 10, 2)},
        [],
    )
    assert read(folder)[0].poses[::15, 0].tolist() == [2, 9, 10]


def test_comments_and_blank_lines_are_skipped(maze: Path) -> None:
    scans = maze / "scans.csv"
    scans.write_text("# robot/node,hex\n\n" + scans.read_text())
    assert len(read(maze)) == 2


# Beams


def test_the_beams_look_to_the_front_back_left_and_right_from_the_left_on() -> None:
    bearings = drone(0.8).table[:, 2].reshape(4, 8) / 65536 * 360
    fan = 3.5 * 5.625 - np.arange(8) * 5.625
    for row, axis in zip(bearings, (0, 180, 90, -90), strict=True):
        assert (row - axis - fan + 180) % 360 - 180 == pytest.approx(np.zeros(8), abs=0.003)


def test_the_beams_start_20_and_25_mm_from_the_centre() -> None:
    assert drone(0.8).table[::8, :2].tolist() == [[20, 0], [-20, 0], [0, 25], [0, -25]]


def test_a_reading_is_the_distance_along_the_sensors_axis(maze: Path) -> None:
    """A flat wall ahead gives eight equal values; the beams that reach it are not equally long."""
    ranges = read(maze)[0].ranges[0, :8]
    angles = np.radians((3.5 - np.arange(8)) * 5.625)
    assert ranges * np.cos(angles) == pytest.approx(np.full(8, 0.5))
    assert ranges * np.sin(angles) == pytest.approx(0.5 * np.tan(angles))


def test_a_reading_that_is_not_positive_says_nothing(tmp_path: Path) -> None:
    folder = write(
        tmp_path / "maze", {"0/0": node(0), "0/1": node(-5)}, {"0/0": vicon(0, 0, 0), "0/1": vicon(0, 0, 0)}, []
    )
    assert np.isnan(read(folder)[0].ranges).all()


def test_readings_are_mapped_up_to_80_cm_unless_told_otherwise(maze: Path) -> None:
    assert read(maze)[0].sensor.max_range_mm == 800
    assert read(maze, max_range=2.0)[0].sensor.max_range_mm == 2000
    with pytest.raises(UserError, match="--max-range"):
        read(maze, max_range=0.0)


# What a user can mend


def test_a_folder_without_scans_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"scans\.csv: there is no such file; give a folder with scans\.csv"):
        read(tmp_path)


def test_no_scans_at_all_are_named(maze: Path) -> None:
    (maze / "scans.csv").write_text("# nothing\n")
    with pytest.raises(UserError, match=r"scans\.csv: no scans"):
        read(maze)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0/0", "expected 2288 hex digits, got 0"),
        ("0/0,", "expected 2288 hex digits, got 0"),
        ("0/0," + node()[:-1], "expected 2288 hex digits, got 2287"),
        ("0/0," + node(frames=14), "expected 2288 hex digits, got 2136"),
        ("0/0," + node() + "00", "expected 2288 hex digits, got 2290"),
        ("0/0," + node() + ",1", "expected 2288 hex digits, got 2290"),
        ("0/0," + node()[:-1] + "x", "damaged hex digits"),
        ("0/0," + node()[:-2] + "  ", "blanks among the hex digits"),
        ("0/0," + node(offset=(math.nan, 0, 0)), "the pose"),
        ("0/0," + node(offset=(1e37, 0, 0)), "the pose"),
        ("0/7," + node(), "node 0/7 has no pose"),
        ("1/0," + node(), "node 1/0 comes twice"),
        ("0," + node(), "expected robot/node first, got '0'"),
        ("a/b," + node(), "expected robot/node first, got 'a/b'"),
        ("0/0/0," + node(), "expected robot/node first"),
    ],
)
def test_a_damaged_scan_is_named_with_file_and_line(maze: Path, line: str, message: str) -> None:
    (maze / "scans.csv").write_text(f"1/0,{node()}\n{line}\n")
    with pytest.raises(UserError, match=rf"scans\.csv:2: .*{message}"):
        read(maze)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0/1,1,2", "expected 7 numbers after the node, got 2"),
        ("0/1," + vicon(0, 0, 0) + ",1", "expected 7 numbers after the node, got 8"),
        ("0/1,1,2,3,4,5,6,seven", "not a number .*seven"),
        ("0/1," + vicon(math.nan, 0, 0), "the pose"),
        ("0/1,0,0,0,0,0,0,0", "not of length 1"),
        ("0/1,0,0,0,nan,0,0,0", "not of length 1"),
    ],
)
def test_a_damaged_pose_is_named_with_file_and_line(maze: Path, line: str, message: str) -> None:
    (maze / "vicon_poses.csv").write_text(f"0/0,{vicon(0, 0, 0)}\n{line}\n1/0,{vicon(0, 0, 0)}\n")
    with pytest.raises(UserError, match=rf"vicon_poses\.csv:2: .*{message}"):
        read(maze)


def test_a_damaged_estimate_is_named_with_file_and_line(maze: Path) -> None:
    (maze / "poses.csv").write_text("0/0,0,0,inf\n")
    with pytest.raises(UserError, match=r"poses\.csv:1: the pose"):
        read(maze, poses="slam")


def test_binary_content_is_no_text(maze: Path) -> None:
    (maze / "scans.csv").write_bytes(b"\xff\xfe\0")
    with pytest.raises(UserError, match=r"scans\.csv: this is no text"):
        read(maze)


def test_a_folder_in_a_files_place_is_named(maze: Path) -> None:
    (maze / "scans.csv").unlink()
    (maze / "scans.csv").mkdir()
    with pytest.raises(UserError, match=r"scans\.csv: cannot be read"):
        read(maze)


@st.composite
def damage(draw: st.DrawFn) -> tuple[str, list[tuple[str, int, int]]]:
    """A file and what happens to it: (kind, where in 0 ... 9999, byte or length)."""
    name = draw(st.sampled_from(["scans.csv", "vicon_poses.csv", "poses.csv"]))
    kinds = st.sampled_from(["flip", "hex", "delete", "cut"])
    return name, draw(st.lists(st.tuples(kinds, st.integers(0, 9999), st.integers(1, 255)), min_size=1, max_size=5))


@given(damage(), st.sampled_from(["truth", "odometry", "slam"]))
def test_a_damaged_folder_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, what: tuple[str, list[tuple[str, int, int]]], poses: str
) -> None:
    folder = write(
        tmp_path_factory.getbasetemp() / "damaged",
        {"0/0": node(), "1/0": node(300, (0.1, 0.1, 0.1))},
        {"0/0": vicon(0, 0, 0), "1/0": vicon(1, 2, 0.5)},
        [("0/0", "0,0,0"), ("1/0", "1,1,1")],
    )
    name, steps = what
    content = bytearray((folder / name).read_bytes())
    for kind, where, value in steps:
        at = where * len(content) // 10_000
        match kind:
            case "flip" if content:
                content[at] ^= value
            case "hex" if content:
                content[at] = ord(f"{value:02x}"[0])
            case "delete":
                del content[at : at + value]
            case "cut":
                del content[at:]
    (folder / name).write_bytes(content)
    try:
        recordings = read(folder, poses=poses)
    except UserError:
        return
    for recording in recordings:
        assert np.isfinite(recording.poses).all()
        assert not (recording.ranges <= 0).any()
        assert len(RecordedBody(recording).read(math.inf)) == len(recording)


def test_a_signalling_nan_is_refused_like_any_other(maze: Path) -> None:
    """Its mere conversion raised a warning once."""
    content = bytearray(bytes.fromhex(node()))
    content[4 + 64 : 4 + 68] = bytes.fromhex("0100a07f")
    (maze / "scans.csv").write_text(f"0/0,{content.hex()}\n")
    with pytest.raises(UserError, match=r"scans\.csv:1: the pose \(nan"):
        read(maze)


# Real recordings


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "nodes"),
    [("exp2_two-drones", [15, 15]), ("exp3_two-drones", [9, 9]), ("exp4_0_2", [17]), ("exp4_0_8", [25])],
)
def test_a_real_folder_has_all_its_frames(recordings_dir: Path, name: str, nodes: list[int]) -> None:
    for poses in ("truth", "odometry", "slam"):
        recordings = read(recordings_dir / "nano_swarm" / name, poses=poses)
        assert [recording.ranges.shape for recording in recordings] == [(15 * count, 32) for count in nodes]


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["exp2_two-drones", "exp3_two-drones", "exp4_0_2", "exp4_0_8"])
def test_near_readings_end_on_the_true_walls(recordings_dir: Path, name: str) -> None:
    """With the motion capture's poses most of what is read within 80 cm lies within 7.5 cm of a wall."""
    folder = recordings_dir / "nano_swarm" / name
    walls = np.loadtxt(folder / "walls.csv", delimiter=",")
    ends = np.concatenate([hits(recording) for recording in read(folder)])
    assert (distance(ends, walls) <= 0.075).mean() > 0.85


def hits(recording: Recording) -> np.ndarray:
    """The points, shape (K, 2), where a recording's readings of at most 80 cm end."""
    x, y, bearing = (recording.sensor.table[:, :3] / [1000, 1000, 65536 / math.tau]).T
    beam_x, beam_y = x + recording.ranges * np.cos(bearing), y + recording.ranges * np.sin(bearing)
    c, s = np.cos(recording.poses[:, 2:]), np.sin(recording.poses[:, 2:])
    points = np.stack([c * beam_x - s * beam_y, s * beam_x + c * beam_y], axis=-1) + recording.poses[:, None, :2]
    return np.asarray(points[recording.ranges <= 0.8])


def distance(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """From each point to the nearest wall, metres."""
    start, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    share = ((points[:, None] - start) * along).sum(-1) / (along * along).sum(-1)
    foot = start + np.clip(share, 0, 1)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - foot, axis=-1).min(axis=1))
