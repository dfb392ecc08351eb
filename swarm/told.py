"""What a peer came to hold, told in the protocol's own messages, so that a log of them makes every session again.

Laws kept here: whoever hears the messages in their order has, after each of them, a true past state of each session;
nothing is missing at the end, however the peer itself came by it. A peer that caught up by manifest has no updates for
the jump: then the manifest of its checkpoint and all its tiles are told, which need nothing that came before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from mapping.lattice import Cells, TileKey
from swarm.drops import Drop
from swarm.limits import MAX_NEED
from swarm.messages import Control, Manifest, Message, Need, Session, TilesMessage, Update
from swarm.replica import Replica
from swarm.session import SessionId
from swarm.state import State, tile_hash
from swarm.tile_block import decode_tiles

if TYPE_CHECKING:
    from swarm.peer import Peer

_TILES_BYTES = 32_768
"""The most of a message with tiles."""


class Jump(NamedTuple):
    """A later state of a session, as a whole."""

    session: SessionId
    state: State


Told = Session | Update | Control | Jump
"""What can be heard again."""


class Teller:
    """Tells what a peer has come to hold.

    Args:
        peer: whose news is told, all that it holds already to begin with.
    """

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._positions: dict[SessionId, int] = {}
        self._controls: set[Control] = set()

    def applied(self, update: Update) -> Iterator[Message]:
        """What an update adds that the peer has just applied (``swarm.peer.Listener``)."""
        yield from self._sessions()
        if update.n == self._positions[update.session] + 1:
            self._positions[update.session] = update.n
            yield update

    def news(self) -> Iterator[Message]:
        """All else that is new since it was asked last."""
        yield from self._sessions()
        for control in self._peer.controls:
            if control not in self._controls:
                self._controls.add(control)
                yield control
        for session, replica in self._peer.replicas.items():
            while self._positions[session] < replica.state.n:
                yield from self._following(replica, self._positions[session])

    def _sessions(self) -> Iterator[Message]:
        """Descriptors, each after that of the session that it replaces, as the peer came to know them."""
        for session, descriptor in self._peer.descriptors.items():
            if session not in self._positions:
                self._positions[session] = 0
                yield Session(descriptor.encode())

    def _following(self, replica: Replica, n: int) -> Iterator[Message]:
        """Updates after state n as far as they are there, or else a checkpoint."""
        updates = replica.updates_after(n)
        if not updates or updates[0].n != n + 1:
            yield from _checkpoint(replica)
            self._positions[replica.descriptor.session] = replica.checkpoint.n
            return
        for update in updates:
            self._positions[update.session] = update.n
            yield update


def _checkpoint(replica: Replica) -> Iterator[Message]:
    """The manifest of a whole checkpoint, and all its tiles."""
    manifest = replica.manifest(0)
    yield manifest
    wanted = [(key, mark.hash) for key, mark in sorted(replica.checkpoint.marks.items())]
    for first in range(0, len(wanted), MAX_NEED):
        entries = Need.pack(wanted[first : first + MAX_NEED])
        yield from replica.supply(Need(manifest.session, manifest.n, 0, entries), _TILES_BYTES)


class Retelling:
    """Takes the messages of a ``Teller`` in their order."""

    def __init__(self) -> None:
        self._manifests: dict[SessionId, Manifest] = {}
        self._cells: dict[SessionId, dict[TileKey, Cells]] = {}

    def hear(self, message: Message) -> Told | None:
        """What a message tells; None if others belong to it that are still to come.

        Raises:
            Drop: it is none of a teller's, or a state does not prove true.
        """
        match message:
            case Session() | Update() | Control():
                return message
            case Manifest(session=session):
                self._manifests[session] = message
                self._cells[session] = {}
                return self._completed(session)
            case TilesMessage(session, payload) if session in self._manifests:
                self._cells[session] |= decode_tiles(payload)
                return self._completed(session)
            case _:
                raise Drop("not_asked")

    def _completed(self, session: SessionId) -> Jump | None:
        manifest, cells = self._manifests[session], self._cells[session]
        marks = manifest.marks()
        if cells.keys() != marks.keys():
            return None
        if any(tile_hash(key, content) != marks[key].hash for key, content in cells.items()):
            raise Drop("bad_hash")
        del self._manifests[session], self._cells[session]
        return Jump(session, State.verified(manifest.n, marks, cells, manifest.root))


def retold(messages: Iterable[Message]) -> Iterator[Told]:
    """What many messages tell.

    Raises:
        Drop: as ``Retelling.hear``.
    """
    retelling = Retelling()
    for message in messages:
        if (told := retelling.hear(message)) is not None:
            yield told
