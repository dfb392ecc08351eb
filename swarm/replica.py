"""A copy of one session: its state, what is kept to serve others, and updates that came too early.

Laws kept here: a copy is always one of the session's true past states; every peer that holds a state can serve it,
whether its writer lives or not. All copies take their checkpoints at the same n, so that all give the same answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from mapping.lattice import Cells, TileKey
from mapping.raster import Raster
from swarm.drops import Drop
from swarm.limits import MAX_PENDING, MAX_PENDING_BYTES
from swarm.messages import Manifest, Message, Need, Session, TilesMessage, Update, Want
from swarm.session import Descriptor
from swarm.state import Change, State, Step, changed_tiles
from swarm.tile_block import HARDEST, encode_tile

CHECKPOINT = 20
"""A state is kept every so many updates; the ring holds at least the updates since the one before."""

WINDOW = 32
"""The most updates that answer one want."""


class Replica:
    """One session's copy at one peer.

    Args:
        descriptor: whose session it is.
        kernel: see ``mapping.raster``.
        deflate: zlib's level for the tiles that others ask for.

    Attributes:
        descriptor: whose session it is.
        state: the newest state here.
        checkpoint: the state at the last multiple of ``CHECKPOINT`` that this copy passed or was given. It moves on by
            what changed: a map's size costs nothing.
    """

    def __init__(self, descriptor: Descriptor, kernel: Raster, *, deflate: int = HARDEST) -> None:
        self.descriptor = descriptor
        self.state = State()
        self.checkpoint = State()
        self._kernel = kernel
        self._news: set[TileKey] = set()  # the tiles that changed since the checkpoint
        self._deflate = deflate
        self._ring: dict[int, Update] = {}  # every update after some n up to state.n, in order
        self._pending: dict[int, Update] = {}
        self._pending_bytes = 0
        self._entries: dict[TileKey, tuple[int, bytes]] = {}  # the hash of each tile that was asked for, and its entry

    # --- following the writer

    def offer(self, update: Update) -> Iterator[tuple[Update, Change]]:
        """Take an update; gives every update that is applied now, with what it changed.

        Raises:
            Drop: ``stale``, ``too_far_ahead``, ``bad_payload``, ``too_many``, or ``bad_check``: then this copy or the
                update is wrong, nothing was applied, and the state should be fetched anew.
        """
        if update.n <= self.state.n or update.n in self._pending:
            raise Drop("stale")
        if update.n > self.state.n + 1:
            self._keep(update)
            return
        yield update, self._apply(update)
        yield from self.drain()

    def drain(self) -> Iterator[tuple[Update, Change]]:
        """Apply the updates that came early and whose turn it is.

        Raises:
            Drop: as ``offer``.
        """
        while (following := self._pending.pop(self.state.n + 1, None)) is not None:
            self._pending_bytes -= len(following.payload)
            yield following, self._apply(following)

    def _keep(self, update: Update) -> None:
        """Hold an early update; the nearest ones are worth most."""
        self._pending[update.n] = update
        self._pending_bytes += len(update.payload)
        if len(self._pending) > MAX_PENDING or self._pending_bytes > MAX_PENDING_BYTES:
            farthest = self._pending.pop(max(self._pending))
            self._pending_bytes -= len(farthest.payload)
            raise Drop("too_far_ahead")

    def _apply(self, update: Update) -> Change:
        step = self.state.step(changed_tiles(self.state, update, self.descriptor, self._kernel))
        if step.check != update.check:
            raise Drop("bad_check")
        return self._commit(update, step)

    def write(
        self, form: int, payload: bytes, changed: Mapping[TileKey, Cells], trail: bytes = b""
    ) -> tuple[Update, Change]:
        """Make, apply and give the session's next update; only the session's own robot may.

        Args:
            form: of the payload, see ``Update``.
            payload: the update's content.
            changed: the same content as the tiles that it leaves behind.
            trail: poses, where the payload has none.
        """
        step = self.state.step(changed)
        update = Update(self.descriptor.session, step.n, form, payload, trail, step.check)
        return update, self._commit(update, step)

    def _commit(self, update: Update, step: Step) -> Change:
        change = self.state.apply(step)
        self._ring[update.n] = update
        self._news.update(step.cells)
        if update.n % CHECKPOINT == 0:
            self.checkpoint.follow(self.state, self._news)
            self._news.clear()
            for n in [n for n in self._ring if n <= update.n - CHECKPOINT]:
                del self._ring[n]
        return change

    @property
    def first_pending(self) -> int | None:
        """The earliest update that waits for those before it."""
        return min(self._pending, default=None)

    def updates_after(self, n: int) -> list[Update]:
        """The updates after ``n`` as far as they are kept: all of them, if ``n`` is not before the checkpoint."""
        return [update for number, update in self._ring.items() if number > n]

    # --- jumping to a checkpoint

    def install(self, state: State) -> Change:
        """Become a later state of the same session, verified by whoever fetched it."""
        before, self.state, self.checkpoint = self.state, state.copy(), state.copy()
        self._news.clear()
        self._ring.clear()
        self._entries.clear()
        for n in [n for n in self._pending if n <= state.n]:
            self._pending_bytes -= len(self._pending.pop(n).payload)
        return _difference(before.cells, state.cells)

    def restart(self) -> None:
        """Go back to the empty state, a true past one, because this copy proved wrong."""
        self._pending.clear()
        self._pending_bytes = 0
        self.install(State())

    # --- serving others

    def answer(self, want: Want) -> Iterator[Message]:
        """What helps somebody at ``want.n`` along: updates from the ring, or else a manifest of the checkpoint."""
        if want.n < 0:
            yield Session(self.descriptor.encode())
        since = max(want.n, 0)
        last = min(want.through or self.state.n, since + WINDOW, self.state.n)
        if since + 1 in self._ring:
            for n in range(since + 1, last + 1):
                yield self._ring[n]
        elif since < self.checkpoint.n:
            yield self.manifest(since)

    def manifest(self, since: int) -> Manifest:
        """The checkpoint for somebody at state ``since``."""
        newer = {key: mark for key, mark in self.checkpoint.marks.items() if mark.version > since}
        entries = Manifest.pack(newer)
        return Manifest(self.descriptor.session, self.checkpoint.n, since, self.checkpoint.root(), entries)

    def supply(self, need: Need, mtu: int) -> Iterator[Message]:
        """The tiles that were asked for, as far as they are here, several a message; else the own manifest."""
        batch = b""
        short = False
        for key, check in dict.fromkeys(need.wanted()):
            entry = self._entry(key, check)
            if entry is None:
                short = True
                continue
            if batch and len(batch) + len(entry) > mtu - 24:
                yield TilesMessage(self.descriptor.session, batch)
                batch = b""
            batch += entry
        if batch:
            yield TilesMessage(self.descriptor.session, batch)
        if short and self.checkpoint.n > max(need.n, need.since):
            yield self.manifest(need.since)

    def _entry(self, key: TileKey, check: int) -> bytes | None:
        """A tile as messages carry it; deflated once, however many ask for it."""
        known, entry = self._entries.get(key, (None, b""))
        if known == check:
            return entry
        cells = self._content(key, check)
        if cells is None:
            return None
        entry = encode_tile(key, cells, self._deflate)
        self._entries[key] = check, entry
        return entry

    def _content(self, key: TileKey, check: int) -> Cells | None:
        for state in (self.checkpoint, self.state):
            mark = state.marks.get(key)
            if mark is not None and mark.hash == check:
                return state.cells[key]
        return None


def _difference(before: Mapping[TileKey, Cells], after: Mapping[TileKey, Cells]) -> Change:
    return {key: (before.get(key), cells) for key, cells in after.items() if before.get(key) is not cells}
