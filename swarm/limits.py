"""Limits on everything that comes in. Whatever exceeds one is dropped and counted before it costs memory or time."""

MAX_MESSAGE = 8 << 20
"""Bytes of one whole message (a manifest of a very large map); on the wire it travels in parts."""

MAX_SESSIONS = 4096
"""Sessions a peer holds."""

MAX_CONTROLS = 4096
"""Control records a peer holds."""

MAX_REVISION = 2**32 - 1
"""Of one control record."""

MAX_TILES = 65_536
"""Tiles of one session: 256 MiB, or 67 km2 at 1 m, 0.17 km2 at 5 cm."""

MAX_N = 2**31 - 1
"""Updates of one session."""

MAX_SCANS = 4096
"""Scans in one update."""

MAX_VISITS = 2**22
"""Cells that the rays of one update's scans may visit, reckoned with all rays at full length. One scan is always
allowed. Without it a few bytes would cost every peer seconds."""

MAX_COORDINATE_MM = 1_000_000_000
"""A pose lies within 1000 km of the origin."""

MAX_TILE_COORDINATE = 2**26
"""Beyond what 1000 km at 1 mm a cell can reach."""

MAX_NEED = 4096
"""Tiles asked for by one message."""

MIN_MTU = 64
"""Payload bytes that a bus must carry at least."""

MAX_PARTS = 65_535
MAX_PART_BYTES = 16 << 20
"""Bytes of unfinished long messages that a peer keeps."""

MAX_PENDING = 256
MAX_PENDING_BYTES = 4 << 20
"""Updates of one session, and their bytes, that wait for an earlier one."""
