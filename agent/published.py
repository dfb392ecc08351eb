"""What a robot published: the scans that an update carries."""

from __future__ import annotations

from mapping.scan import Scans
from swarm.messages import Update
from swarm.scan_block import decode_scans
from swarm.session import Descriptor


def published_scans(descriptor: Descriptor, update: Update) -> Scans | None:
    """The scans that an update carries; poses with no ranges, if that is all; None if there are none."""
    if update.form == Update.SCANS:
        return decode_scans(update.payload, len(descriptor.sensor.beams), descriptor.sensor.max_range_mm)
    return decode_scans(update.trail, 0, 0) if update.trail else None
