"""CARMEN text logs: laser scans with the pose each was taken from, plain or gzip.

Two kinds of line are read, whichever a log has first; all others are skipped:

    FLASER n r1 ... rn  lx ly lth  rx ry rth  stamp host logger_stamp
    ROBOTLASER1 type start fov step max accuracy remission  n r1 ... rn  m e1 ... em  lx ly lth  rx ry rth
                tv rv forward side turn_axis  stamp host logger_stamp

Laws kept here: the laser's pose is the robot's pose (so the beams start at its centre); a reading at the laser's
maximum says nothing (it is an error code as often as an empty room), one beyond the limit to map with frees its ray.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.errors import UserError
from agent.recording import Recording, check_pose, check_stamp, range_limit
from mapping.sensor import laser

MAX_RANGE = 20.0
"""Metres mapped by default: far enough for any room, near enough that a beam is still thin."""

_GZIP = b"\x1f\x8b"
_LONGEST_ROOM = 25.0  # metres: a top reading below this is taken for a wall, not for the laser's maximum
_AT_MAXIMUM = 0.99  # a SICK reports 81.83 to 81.91 m (8183 ... 8191 cm) for its various reasons to see nothing
_MEND = "mend or delete the line"
_RESTORE = "fetch the file again"


class _Fan(NamedTuple):
    """Where a laser looks: how many beams, the first one's bearing, and the step, in radians."""

    beams: int
    first: float
    step: float

    def __str__(self) -> str:
        first, step = math.degrees(self.first), math.degrees(self.step)
        return f"{self.beams} beams from {first:.4g} degrees, {step:.4g} apart"


class _Scan(NamedTuple):
    """One line, parsed; ``maximum`` is the laser's, metres, where the line tells."""

    fan: _Fan
    readings: list[float]
    pose: tuple[float, float, float]
    stamp: float
    maximum: float | None


def read(path: Path, *, poses: str | None = None, max_range: float | None = None) -> Recording:
    """One robot's run out of a CARMEN log.

    The log's maximum is what ``PARAM robot_front_laser_max`` or ROBOTLASER1 declare. Undeclared, it is the largest
    reading that occurs more than once (or the largest), if that is 25 m or more; readings from 1 % below it on say
    nothing. Readings that are not positive or not finite say nothing either.

    Args:
        path: the log.
        poses: ``None`` or "slam": the poses in these logs are a SLAM's, and there are no others.
        max_range: metres; a reading beyond it, but below the log's maximum, is "nothing in range".

    Raises:
        UserError: the file cannot be read or is not such a log.
    """
    if poses not in {None, "slam"}:
        raise UserError(
            path, f"a CARMEN log holds corrected poses only, no {poses!r}", "leave --poses out or use --poses slam"
        )
    limit = range_limit(max_range, MAX_RANGE)
    scans, declared = _parse(path)
    fan = scans[0].fan
    readings = np.array([scan.readings for scan in scans], np.float64)
    stamps = np.array([scan.stamp for scan in scans], np.float64)
    return Recording(
        name=path.name.removesuffix(".gz").removesuffix(".log"),
        stamps=stamps - stamps[0],
        poses=np.array([scan.pose for scan in scans], np.float64),
        ranges=_ranges(readings, limit, scans[0].maximum or declared),
        sensor=laser(fan.beams, first=fan.first, step=fan.step, max_range=limit),
    )


def _parse(path: Path) -> tuple[list[_Scan], float | None]:
    """The scans of a log and the laser's maximum in metres, where a PARAM line declares it."""
    lines = _lines(path)
    kind = next((word for line in lines if (word := _word(line)) in _KINDS), None)
    if kind is None:
        raise UserError(path, "no FLASER line: not a CARMEN log, or one without scans", "give a CARMEN log with scans")
    if not lines[-1].endswith((b"\n", b"\r")) and not _is_whole(lines[-1].split()):
        raise UserError(f"{path}:{len(lines)}", "the recording is cut off in its last line", "delete that line")
    scans: list[_Scan] = []
    declared = None
    for number, line in enumerate(lines, start=1):
        where = f"{path}:{number}"
        if _word(line) == kind:
            scans.append(_scan(where, line.split()))
            if scans[-1].fan != scans[0].fan:
                raise UserError(where, f"{scans[-1].fan}, after {scans[0].fan}", "give a log of one laser")
        elif line.startswith(b"PARAM robot_front_laser_max "):
            declared = _maximum(where, line.split()[2:3])
    return scans, declared


def _lines(path: Path) -> list[bytes]:
    """The log's lines with their ends, known to be text."""
    lines = _content(path).splitlines(keepends=True)
    if not any(line.strip() for line in lines):
        raise UserError(path, "the file is empty", _RESTORE)
    for number, line in enumerate(lines, start=1):
        if b"\0" in line or not (line.isascii() or line.startswith(b"#")):
            raise UserError(f"{path}:{number}", "this is no text: not a CARMEN log, or a damaged one", _RESTORE)
    return lines


def _word(line: bytes) -> bytes:
    """A line's first word, if it is a short one."""
    return next(iter(line[:12].split()), b"")


def _content(path: Path) -> bytes:
    """The log's bytes, inflated if they are gzip, by whatever name."""
    try:
        content = path.read_bytes()
        return gzip.decompress(content) if content.startswith(_GZIP) else content
    except EOFError as error:
        raise UserError(path, "the gzip file is cut off", _RESTORE) from error
    except (gzip.BadGzipFile, zlib.error) as error:
        raise UserError(path, f"the gzip file is damaged ({error})", _RESTORE) from error
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the path and its permissions") from error


def _is_whole(words: list[bytes]) -> bool:
    """Whether a last line without an end is complete: all its values, logged no earlier than they were sent."""
    if not words:
        return True
    try:
        if words[0] in _KINDS:
            _KINDS[words[0]](words)
        elif words[0] != b"ODOM" or len(words) != 10:
            return False
        return float(words[-1]) >= float(words[-3])
    except (ValueError, IndexError):
        return False


def _scan(where: str, words: list[bytes]) -> _Scan:
    """A laser line's values, checked."""
    try:
        scan = _KINDS[words[0]](words)
    except (ValueError, IndexError) as error:
        raise UserError(where, f"a damaged {words[0].decode()} line ({error})", _MEND) from error
    if not 2 <= scan.fan.beams <= 4096:
        raise UserError(where, f"{scan.fan.beams} readings in a scan", "2 to 4096 can be mapped")
    if not (abs(scan.fan.first) <= math.tau and abs(scan.fan.step) <= math.pi):  # NaN compares false
        raise UserError(where, f"no laser has {scan.fan}", _MEND)
    check_pose(where, *scan.pose)
    check_stamp(where, scan.stamp)
    return scan


def _flaser(words: list[bytes]) -> _Scan:
    count = int(words[1])
    _expect(words, count + 11)
    readings, pose = _floats(words[2 : count + 2]), _floats(words[count + 2 : count + 5])
    # CARMEN's convention: 180 and 181 readings are 1 degree apart, 360 and 361 half a degree, all from the right.
    step = math.pi / max(count if count % 2 == 0 else count - 1, 1)
    return _Scan(_Fan(count, -math.pi / 2, step), readings, (pose[0], pose[1], pose[2]), float(words[count + 8]), None)


def _robotlaser1(words: list[bytes]) -> _Scan:
    first, step, maximum = float(words[2]), float(words[4]), float(words[5])
    count = int(words[8])
    remissions = int(words[9 + count])
    if min(count, remissions) < 0:
        raise ValueError(f"{count} readings and {remissions} remissions")
    rest = 10 + count + remissions
    _expect(words, rest + 14)
    readings, pose = _floats(words[9 : count + 9]), _floats(words[rest : rest + 3])
    if not (math.isfinite(maximum) and maximum > 0):
        raise ValueError(f"a laser that sees {maximum} m far")
    return _Scan(_Fan(count, first, step), readings, (pose[0], pose[1], pose[2]), float(words[rest + 11]), maximum)


_KINDS: dict[bytes, Callable[[list[bytes]], _Scan]] = {b"FLASER": _flaser, b"ROBOTLASER1": _robotlaser1}


def _expect(words: list[bytes], count: int) -> None:
    if len(words) != count:
        raise ValueError(f"expected {count} words, got {len(words)}")


def _floats(words: list[bytes]) -> list[float]:
    return list(map(float, words))


def _maximum(where: str, words: list[bytes]) -> float:
    """The laser's maximum in metres from a PARAM line."""
    try:
        (value,) = _floats(words)
    except ValueError as error:
        raise UserError(where, f"the laser's maximum is no number ({error})", _MEND) from error
    if not (math.isfinite(value) and value > 0):
        raise UserError(where, f"a laser that sees {value} m far", _MEND)
    return value


def _ranges(readings: NDArray[np.float64], limit: float, declared: float | None) -> NDArray[np.float64]:
    """Readings, shape (N, B), as a recording's ranges: NaN where they say nothing, infinity beyond the limit."""
    says = np.isfinite(readings) & (readings > 0)
    maximum = declared or _observed_maximum(readings[says])
    says &= readings < _AT_MAXIMUM * maximum
    return np.where(says, np.where(readings > limit, np.inf, readings), np.nan)


def _observed_maximum(readings: NDArray[np.float64]) -> float:
    """The laser's maximum in metres, judged by its readings; infinity if none of them looks like one.

    One reading beyond all others is a glitch, and one that recurs at the top is a code.
    """
    values, counts = np.unique(readings[readings >= _LONGEST_ROOM], return_counts=True)
    if len(values) == 0:
        return math.inf
    recurring = values[counts > 1]
    return float(recurring[-1] if len(recurring) else values[-1])
