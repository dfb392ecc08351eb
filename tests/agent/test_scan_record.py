"""Scans that came by, kept and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.errors import UserError
from agent.scan_record import Recorded, ScanRecord, load_scans, save_scans
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.scan import Scans, quantise
from mapping.sensor import laser, orion
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor, Rules

RULES = Rules(Lattice.of(0.02), EvidenceModel())


def scans(count: int, beams: int = 5) -> Scans:
    turn = np.arange(count)
    poses = np.column_stack([turn * 0.1, -turn * 0.2, turn * 0.3])
    sensor = orion() if beams == 5 else laser(beams, first=0.0, step=0.1, max_range=20.0)
    return quantise(turn * 0.1, poses, np.full((count, beams), 0.5), sensor)


def same(a: Recorded, b: Recorded) -> bool:
    return (a.robot, a.session, a.sensor) == (b.robot, b.session, b.sensor) and all(
        np.array_equal(getattr(a.scans, name), getattr(b.scans, name)) for name in ("stamps_ms", "poses", "ranges")
    )


def test_what_is_written_is_read_again_whatever_the_sensors(tmp_path: Path) -> None:
    wide = laser(7, first=0.0, step=0.1, max_range=20.0)
    written = [Recorded("r1", "aa", orion(), scans(3)), Recorded("r2", "bb", wide, scans(4, 7))]
    save_scans(tmp_path / "scans.npz", written)
    assert all(map(same, load_scans(tmp_path / "scans.npz"), written))


def test_no_sessions_are_a_file_too(tmp_path: Path) -> None:
    save_scans(tmp_path / "scans.npz", [])
    assert load_scans(tmp_path / "scans.npz") == []


@pytest.mark.parametrize("content", [b"", b"PK", b"no archive"])
def test_a_damaged_file_is_told_so(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "scans.npz").write_bytes(content)
    with pytest.raises(UserError, match=r"scans.npz: holds no scans"):
        load_scans(tmp_path / "scans.npz")


def test_an_archive_of_something_else_is_told_so(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", walls=np.zeros(3))
    with pytest.raises(UserError, match="holds no scans"):
        load_scans(tmp_path / "other.npz")


def test_a_record_keeps_every_scan_that_is_published() -> None:
    record = ScanRecord()
    peer = Peer(Hello(Hello.ROBOT, b"r1", b"test"), RULES, seed=b"r1", mtu=60_000, now=0.0, listener=record)
    descriptor = Descriptor("r1", bytes(8), RULES, orion(), None)
    writer = peer.open_session(descriptor, "scans")
    for now, batch in ((1.0, scans(6)[:4]), (2.0, scans(6)[4:])):
        writer.sense(batch)
        peer.poll(now)
    (kept,) = record.sessions()
    assert same(kept, Recorded("r1", bytes(8).hex(), orion(), scans(6)))
