"""Scans into an update's bytes and back."""

from __future__ import annotations

from benchmarks.inputs import ORION, logs, orion_walk
from benchmarks.table import Row, compared, cpu_seconds, interleaved
from mapping.scan import Scans
from mapping.sensor import Sensor
from swarm.messages import Update, decode, encode
from swarm.scan_block import decode_scans, encode_scans


def measure() -> list[Row]:
    """Microseconds a scan, both ways, and bytes a scan."""
    log = logs()[0]
    rows = []
    for name, scans, sensor in (
        ("Orion, 1 scan", orion_walk(1, 1), ORION),
        ("Orion, 10 scans", orion_walk(10, 1), ORION),
        (f"{log.name}, 10 scans", log.scans[:10], log.sensor),
    ):
        rows += _of(name, scans, sensor)
    return rows


def _of(name: str, scans: Scans, sensor: Sensor) -> list[Row]:
    def write() -> bytes:
        return encode(Update(b"8 bytes.", 1, Update.SCANS, encode_scans(scans), b"", 0))

    def read() -> Scans:
        update = decode(message)
        assert isinstance(update, Update)
        return decode_scans(update.payload, len(sensor.beams), sensor.max_range_mm)

    message = write()
    assert (read().ranges == scans.ranges).all()
    figures = interleaved(
        {f"{name}: encode": lambda: cpu_seconds(write, 50), f"{name}: decode": lambda: cpu_seconds(read, 50)}, 15
    )
    rows = compared(figures, "us a scan", scale=1e6 / len(scans))
    return [row._replace(note=f"{len(message) / len(scans):.1f} bytes a scan") for row in rows]
