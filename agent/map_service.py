"""The map for whoever asks and is no peer: its tiles, plain, as a script of twenty lines can read them.

Laws kept here: what is read while the map changes is never written, for its arrays are replaced (``swarm.fusion``). So
every tile is whole; of an update that is just being applied some tiles may be there and others not yet.
"""

from __future__ import annotations

from collections.abc import Iterator

from swarm.peer import Peer
from transport.bus import Bus

TOPIC = "map"


def serve_map(bus: Bus, peer: Peer) -> None:
    """Show the peer's map to whoever asks the bus for it: ``cell_mm``, and each tile by ``<ty>/<tx>``."""

    def answers() -> Iterator[tuple[str, bytes]]:
        yield "cell_mm", str(peer.rules.lattice.cell_mm).encode()
        for key, cells in peer.fusion.tiles.copy().items():  # one step of the interpreter, whatever others do
            yield f"{key.ty}/{key.tx}", cells.astype("<i4").tobytes()

    bus.serve(TOPIC, answers)
