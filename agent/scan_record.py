"""The scans that came by on the bus, kept and written to one file: what a swarm's robots published, to work on later.

A session whose robot publishes tiles has none, and one that was caught up with only has those since.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.errors import UserError
from agent.files import read_bytes, write_whole
from mapping.scan import Scans
from mapping.sensor import Beam, Sensor
from swarm.messages import Update
from swarm.scan_block import decode_scans
from swarm.session import Descriptor, SessionId


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """One session's scans.

    Attributes:
        robot: whose they are.
        session: its id, in hex.
        sensor: what their ranges mean.
        scans: as published, in their order.
    """

    robot: str
    session: str
    sensor: Sensor
    scans: Scans


class ScanRecord:
    """Listens to a swarm (``swarm.peer.Listener``) and keeps all scans."""

    def __init__(self) -> None:
        self._descriptors: dict[SessionId, Descriptor] = {}
        self._batches: dict[SessionId, list[Scans]] = {}

    def __call__(self, descriptor: Descriptor, update: Update) -> None:
        """Take an applied update."""
        if update.form == Update.SCANS:
            sensor = descriptor.sensor
            scans = decode_scans(update.payload, len(sensor.beams), sensor.max_range_mm)
            self._descriptors[update.session] = descriptor
            self._batches.setdefault(update.session, []).append(scans)

    def sessions(self) -> list[Recorded]:
        """What was kept, in the order of robots and sessions."""
        found = [
            Recorded(descriptor.robot, session.hex(), descriptor.sensor, Scans.join(self._batches[session]))
            for session, descriptor in self._descriptors.items()
        ]
        return sorted(found, key=lambda recorded: (recorded.robot, recorded.session))


def save_scans(path: Path, sessions: list[Recorded]) -> None:
    """Write an npz.

    It holds ``robots`` and ``sessions``, shape (K,); and, under each session's id in hex and a slash, ``stamps_ms``
    (N,), ``poses`` (N, 3) and ``ranges`` (N, B) as in ``mapping.scan.Scans``, ``beams`` (B, 4) as in ``Sensor.table``,
    and ``max_range_mm``.

    Raises:
        UserError: the file cannot be written.
    """
    arrays: dict[str, Any] = {
        "robots": np.array([each.robot for each in sessions], np.str_),
        "sessions": np.array([each.session for each in sessions], np.str_),
    }
    for each in sessions:
        scans, sensor = each.scans, each.sensor
        parts = {"stamps_ms": scans.stamps_ms, "poses": scans.poses, "ranges": scans.ranges}
        parts |= {"beams": sensor.table, "max_range_mm": np.array(sensor.max_range_mm)}
        arrays |= {f"{each.session}/{name}": array for name, array in parts.items()}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_whole(path, content.getvalue())


def load_scans(path: Path) -> list[Recorded]:
    """What ``save_scans`` wrote.

    Raises:
        UserError: the file is missing or damaged.
    """
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as file:
            return [
                Recorded(
                    robot,
                    session,
                    Sensor(
                        tuple(Beam(*beam) for beam in file[f"{session}/beams"].tolist()),
                        int(file[f"{session}/max_range_mm"]),
                    ),
                    Scans(*(file[f"{session}/{name}"] for name in ("stamps_ms", "poses", "ranges"))),
                )
                for robot, session in zip(file["robots"].tolist(), file["sessions"].tolist(), strict=True)
            ]
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UserError(path, f"holds no scans: {error}", "give a file that orion observe --scans wrote") from None
