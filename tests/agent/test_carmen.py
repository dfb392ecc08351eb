"""CARMEN logs: what a line means, what says nothing, and that no damage raises anything but a UserError."""

from __future__ import annotations

import gzip
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from agent.carmen import read
from agent.errors import UserError
from agent.playback import RecordedBody

HEADER = (
    "# message formats defined: PARAM SYNC ODOM FLASER RLASER TRUEPOS\nPARAM robot_frontlaser_offset 0.0 nohost 0\n"
)
ODOM = "ODOM 0 0 0 0 0 0 0.5 pippo 0.5\n"

WriteLog = Callable[[str | bytes], Path]


@pytest.fixture
def write_log(tmp_path: Path) -> WriteLog:
    def write(content: str | bytes) -> Path:
        path = tmp_path / "run.log"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def flaser(readings: list[float], pose: tuple[float, float, float] = (0, 0, 0), stamp: float = 0.5) -> str:
    numbers = " ".join(str(reading) for reading in readings)
    x, y, yaw = pose
    return f"FLASER {len(readings)} {numbers} {x} {y} {yaw} 9 9 9 {stamp} pippo {stamp}\n"


def robotlaser1(readings: list[float], maximum: float = 30.0, remissions: int = 0) -> str:
    numbers = " ".join(str(reading) for reading in readings)
    tail = "1 2 0.5 9 9 9 0.3 0.1 0.2 0.2 1e6 7.5 pippo 7.6"
    extras = " 0.5" * remissions
    return f"ROBOTLASER1 0 -1.0 2.0 0.5 {maximum} 0.01 0 {len(readings)} {numbers} {remissions}{extras} {tail}\n"


# What a line means


def test_a_scan_is_its_readings_the_lasers_pose_and_the_time_since_the_first(write_log: WriteLog) -> None:
    log = flaser([1.0, 2.0], (1, 2, 0.5), 100.25) + ODOM + flaser([3.0, 4.0], (3, 4, -7.0), 99.75)
    recording = read(write_log(HEADER + log))
    assert recording.ranges.tolist() == [[1, 2], [3, 4]]
    assert recording.poses.tolist() == [[1, 2, 0.5], [3, 4, -7]]
    assert recording.stamps.tolist() == [0, -0.5]
    assert recording.name == "run"


@pytest.mark.parametrize(("beams", "step"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (2, 90.0), (3, 90.0)])
def test_the_first_beam_looks_right_and_the_others_follow_to_the_left(
    write_log: WriteLog, beams: int, step: float
) -> None:
    bearings = read(write_log(flaser([1.0] * beams))).sensor.table[:, 2]
    degrees = (bearings + 32768) % 65536 / 65536 * 360 - 180
    assert degrees == pytest.approx(-90 + step * np.arange(beams), abs=0.003)


def test_the_laser_is_at_the_robots_centre_and_sees_20_m(write_log: WriteLog) -> None:
    sensor = read(write_log(flaser([1.0, 2.0]))).sensor
    assert not sensor.table[:, :2].any()
    assert sensor.max_range_mm == 20_000


def test_a_robotlaser_line_brings_its_own_angles_and_maximum(write_log: WriteLog) -> None:
    recording = read(write_log(robotlaser1([1.0, 29.0, 30.0], remissions=3)))
    assert recording.ranges.tolist() == [[1.0, math.inf, pytest.approx(math.nan, nan_ok=True)]]
    assert recording.poses.tolist() == [[1, 2, 0.5]]
    degrees = (recording.sensor.table[:, 2] + 32768) % 65536 / 65536 * 360 - 180
    assert degrees == pytest.approx(np.degrees([-1.0, -0.5, 0.0]), abs=0.003)


def test_the_first_kind_of_laser_line_is_the_logs(write_log: WriteLog) -> None:
    recording = read(write_log(flaser([1.0, 2.0]) + robotlaser1([1.0, 2.0, 3.0])))
    assert recording.ranges.tolist() == [[1, 2]]


def test_gzip_is_known_by_content_not_by_name(tmp_path: Path) -> None:
    content = flaser([1.0, 2.0]).encode()
    squeezed, plain = tmp_path / "squeezed.log", tmp_path / "plain.log.gz"
    squeezed.write_bytes(gzip.compress(content))
    plain.write_bytes(content)
    assert read(squeezed).ranges.tolist() == read(plain).ranges.tolist() == [[1, 2]]
    assert read(plain).name == "plain"


def test_line_ends_of_windows_and_words_far_apart_are_read(write_log: WriteLog) -> None:
    log = HEADER + flaser([1.0, 2.0]).replace(" ", "\t ")
    assert read(write_log(log.replace("\n", "\r\n"))).ranges.tolist() == [[1, 2]]


def test_a_comment_may_be_in_any_alphabet(write_log: WriteLog) -> None:
    assert len(read(write_log("# Gebäude 079\n" + flaser([1.0, 2.0])))) == 1


# What says nothing, and what frees its ray


def test_a_reading_at_the_maximum_says_nothing_and_one_beyond_the_limit_frees_its_ray(write_log: WriteLog) -> None:
    ranges = read(write_log(flaser([1.0, 20.0, 20.01, 40.0, 81.83, 81.83]))).ranges
    np.testing.assert_array_equal(ranges, [[1.0, 20.0, np.inf, np.inf, np.nan, np.nan]])


def test_a_sicks_error_codes_all_say_nothing(write_log: WriteLog) -> None:
    """In the Seattle log the top readings are 81.87, 81.89 and 81.91 m; there is no wall between them."""
    ranges = read(write_log(flaser([35.0, 81.83, 81.87, 81.87, 81.89, 81.91, 81.91]))).ranges
    np.testing.assert_array_equal(ranges, [[np.inf] + [np.nan] * 6])


def test_a_glitch_does_not_hide_the_maximum(write_log: WriteLog) -> None:
    ranges = read(write_log(flaser([1.0, 30.0, 30.0, 655.35]))).ranges
    np.testing.assert_array_equal(ranges, [[1.0, np.nan, np.nan, np.nan]])


def test_in_a_small_room_the_farthest_wall_is_a_wall(write_log: WriteLog) -> None:
    assert read(write_log(flaser([7.0, 7.0, 7.0]))).ranges.tolist() == [[7, 7, 7]]


def test_a_declared_maximum_is_believed(write_log: WriteLog) -> None:
    log = "PARAM robot_front_laser_max 5.6 nohost 0\n" + flaser([1.0, 5.0, 5.6])
    np.testing.assert_array_equal(read(write_log(log)).ranges, [[1.0, 5.0, np.nan]])


def test_readings_that_are_no_distance_say_nothing(write_log: WriteLog) -> None:
    ranges = read(write_log(flaser([1.0, 0.0, -1.0, math.nan, math.inf, -math.inf]))).ranges
    np.testing.assert_array_equal(ranges, [[1.0] + [np.nan] * 5])


def test_the_limit_can_be_chosen(write_log: WriteLog) -> None:
    recording = read(write_log(flaser([1.0, 3.0])), max_range=2.5)
    assert recording.ranges.tolist() == [[1.0, math.inf]]
    assert recording.sensor.max_range_mm == 2500


# What a user can mend


@pytest.mark.parametrize("max_range", [0.0, -1.0, 0.0009, 65.1, 1e300, math.inf, math.nan])
def test_a_limit_that_cannot_be_is_refused(write_log: WriteLog, max_range: float) -> None:
    with pytest.raises(UserError, match=r"--max-range: .* out of bounds; choose"):
        read(write_log(flaser([1.0, 2.0])), max_range=max_range)


def test_the_poses_are_a_slams_and_no_others(write_log: WriteLog) -> None:
    path = write_log(flaser([1.0, 2.0]))
    assert len(read(path, poses="slam")) == 1
    for poses in ("odometry", "truth"):
        with pytest.raises(UserError, match="corrected poses only"):
            read(path, poses=poses)


DAMAGED = {
    "nothing": ("", r"run\.log: the file is empty"),
    "blank": ("\n \n", r"run\.log: the file is empty"),
    "prose": ("Dear reader,\nthis is a letter.\n", r"run\.log: no FLASER line"),
    "a word": ("hello", r"run\.log: no FLASER line"),
    "no scans": (HEADER + ODOM, r"run\.log: no FLASER line"),
    "a word too few": (ODOM + flaser([1.0, 2.0]).replace(" 2.0", ""), r"run\.log:2: .*expected 13 words, got 12"),
    "a word too many": (flaser([1.0, 2.0]).replace(" 2.0", " 2.0 2.0"), r"run\.log:1: .*expected 13 words, got 14"),
    "no number": (flaser([1.0, 2.0]).replace("2.0", "2,0"), r"run\.log:1: .*2,0"),
    "no count": ("FLASER many 1 2\n", r"run\.log:1: .*many"),
    "only the name": ("FLASER\n", r"run\.log:1: a damaged FLASER line"),
    "pose NaN": (flaser([1.0, 2.0], (math.nan, 0, 0)), r"run\.log:1: the pose \(nan"),
    "pose inf": (flaser([1.0, 2.0], (0, math.inf, 0)), r"run\.log:1: the pose"),
    "pose afar": (flaser([1.0, 2.0], (0, 1e9, 0)), r"run\.log:1: the pose"),
    "pose dizzy": (flaser([1.0, 2.0], (0, 0, 1e300)), r"run\.log:1: the pose"),
    "stamp NaN": (flaser([1.0, 2.0], stamp=math.nan), r"run\.log:1: the stamp nan"),
    "stamp afar": (flaser([1.0, 2.0], stamp=1e300), r"run\.log:1: the stamp"),
    "one beam": (flaser([1.0]), r"run\.log:1: 1 readings in a scan"),
    "many beams": (flaser([1.0] * 5000), r"run\.log:1: 5000 readings in a scan"),
    "two lasers": (flaser([1.0, 2.0]) + flaser([1.0] * 180), r"run\.log:2: 180 beams .*, after 2 beams"),
    "maximum missing": (
        "PARAM robot_front_laser_max \n" + flaser([1.0, 2.0]),
        r"run\.log:1: the laser's maximum is no number",
    ),
    "maximum NaN": (
        "PARAM robot_front_laser_max nan host 0\n" + flaser([1.0, 2.0]),
        r"run\.log:1: a laser that sees nan m far",
    ),
    "robotlaser blind": (robotlaser1([1.0, 2.0], maximum=0.0), r"run\.log:1: .*sees 0\.0 m far"),
    "robotlaser askew": (robotlaser1([1.0, 2.0]).replace("-1.0", "1e308"), r"run\.log:1: no laser has"),
    "robotlaser negative": (robotlaser1([]).replace(" 0  0 ", " 0 -3  0 "), r"run\.log:1: a damaged"),
}


@pytest.mark.parametrize(("content", "message"), DAMAGED.values(), ids=DAMAGED.keys())
def test_damage_is_named_with_file_and_line(write_log: WriteLog, content: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        read(write_log(content))


@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\0\0", b"FLASER 2\n\xff\xfe\n", b"ODOM \0\0"])
def test_binary_content_is_no_log(write_log: WriteLog, content: bytes) -> None:
    with pytest.raises(UserError, match=r"run\.log:[12]: this is no text: not a CARMEN log"):
        read(write_log(content))


def test_gzip_cut_off_or_damaged_is_named(write_log: WriteLog) -> None:
    squeezed = gzip.compress(flaser([1.0, 2.0]).encode() * 9)
    with pytest.raises(UserError, match=r"run\.log: the gzip file is cut off; fetch"):
        read(write_log(squeezed[:-9]))
    with pytest.raises(UserError, match=r"run\.log: the gzip file is damaged"):
        read(write_log(squeezed[:-8] + b"\0" * 8))


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be read"):
        read(tmp_path)


@pytest.mark.parametrize("last", [flaser([1.0, 2.0], stamp=12.75), ODOM, "PARAM robot_mass 60 nohost 0\n"])
def test_a_last_line_cut_anywhere_is_a_truncated_recording(write_log: WriteLog, last: str) -> None:
    for stop in range(1, len(last) - 1):
        with pytest.raises(UserError, match=r"run\.log:2: the recording is cut off in its last line; delete that line"):
            read(write_log(flaser([1.0, 2.0]) + last[:stop]))


@pytest.mark.parametrize("last", [flaser([1.0, 2.0], stamp=12.75), ODOM, "  "])
def test_a_last_line_that_is_complete_needs_no_end(write_log: WriteLog, last: str) -> None:
    assert len(read(write_log(flaser([1.0, 2.0]) + last.rstrip("\n")))) >= 1


# Whatever the damage

VALID = (
    HEADER
    + "PARAM robot_front_laser_max 81.9 nohost 0\n"
    + flaser([1.25, 81.83, 0.5], (1.5, -2.25, 0.75), 10.5)
    + ODOM
    + flaser([2.5, 33.0, 1e-3], (1.75, -2.5, 3.125), 9.75)
    + robotlaser1([1.0, 2.0, 3.0])
).encode()
ROBOTLASERS = (robotlaser1([1.0, 2.0, 3.0], remissions=1) * 3).encode()


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A valid log, perhaps squeezed, with bytes flipped, deleted, repeated or cut off."""
    content = bytearray(draw(st.sampled_from([VALID, ROBOTLASERS, gzip.compress(VALID, mtime=0)])))
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, max(len(content) - 1, 0)))
        length = draw(st.integers(1, 12))
        match draw(st.sampled_from(["flip", "delete", "repeat", "cut", "digit"])):
            case "flip" if content:
                content[at] ^= draw(st.integers(1, 255))
            case "digit" if content:
                content[at] = draw(st.sampled_from(b"0123456789-.e \n"))
            case "delete":
                del content[at : at + length]
            case "repeat":
                content[at:at] = content[at : at + length]
            case "cut":
                del content[at:]
    return bytes(content)


@given(damaged())
@example(VALID)
def test_a_damaged_log_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.log"
    path.write_bytes(content)
    try:
        recording = read(path)
    except UserError:
        return
    assert np.isfinite(recording.poses).all()
    assert np.isfinite(recording.stamps).all()
    assert not (recording.ranges <= 0).any()
    body = RecordedBody(recording)
    assert len(body.read(math.inf)) == len(recording)


# Real recordings


@pytest.mark.recordings
@pytest.mark.parametrize(("name", "scans", "beams", "nothing"), [("intel", 910, 180, 4172), ("seattle", 241, 361, 707)])
def test_a_real_log_has_all_its_scans(recordings_dir: Path, name: str, scans: int, beams: int, nothing: int) -> None:
    recording = read(recordings_dir / f"carmen/{name}-corrected.log.gz")
    assert recording.ranges.shape == (scans, beams)
    assert np.isnan(recording.ranges).sum() == nothing  # the readings from 81.83 m on
    assert recording.stamps[0] == 0


@pytest.mark.recordings
def test_intels_clock_steps_back_and_its_due_times_do_not(recordings_dir: Path) -> None:
    recording = read(recordings_dir / "carmen/intel-corrected.log.gz")
    assert np.diff(recording.stamps).min() == pytest.approx(-0.86)
    assert np.diff(recording.due).min() >= 0


@pytest.mark.recordings
def test_intel_is_read_well_within_a_second(recordings_dir: Path) -> None:
    before = time.process_time()
    read(recordings_dir / "carmen/intel-corrected.log.gz")
    assert time.process_time() - before < 0.5
