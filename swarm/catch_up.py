"""Closing the gap in one session's copy: whom to ask, for what, and what to do when nobody answers.

Pull only. Whoever hears of more than it has waits a little (most gaps close by themselves), asks one peer, and is
answered from that peer's ring of updates or, for a large gap, with a manifest; then it fetches just the tiles whose
content it does not hold, from whoever has them. Tiles are kept by content, so neither a retry nor a change of provider
loses progress, nor that nobody answers for a while.
"""

from __future__ import annotations

from collections import Counter

from mapping.lattice import Cells, TileKey
from swarm.drops import Drop
from swarm.jitter import Jitter
from swarm.limits import MAX_TILES
from swarm.messages import Manifest, Mark, Need, TilesMessage, Want
from swarm.replica import WINDOW, Replica
from swarm.session import SessionId
from swarm.state import State, tile_hash
from swarm.tile_block import decode_tiles
from swarm.timers import Timers

_NEVER = float("inf")
_FETCH = 64
"""Tiles that are asked for at once: whoever gives them for the first time is busy with them for some milliseconds."""

_PATIENCE = 3  # unanswered requests for tiles after which a manifest is asked for anew


class CatchUp:
    """The pursuit of one session.

    Attributes:
        wake_at: when ``poll`` wants to be called next.
    """

    def __init__(self, session: SessionId, timers: Timers, jitter: Jitter, mtu: int) -> None:
        self._session = session
        self._timers = timers
        self._jitter = jitter
        self._tiles_per_need = min(_FETCH, Need.fitting(mtu))
        self._held: dict[str, int] = {}  # peer -> the n it said it holds
        self._failures: Counter[str] = Counter()
        self._asked: str | None = None
        self._asked_ever: set[str] = set()  # since it rested: their answers may be late
        self._asked_through = 0
        self._tries = 0
        self._manifest: Manifest | None = None
        self._listed: dict[TileKey, Mark] = {}
        self._missing: dict[TileKey, int] = {}
        self._requested: set[TileKey] = set()
        self._got: dict[tuple[TileKey, int], Cells] = {}
        self.wake_at = _NEVER

    # --- what is known of others

    def heard(self, peer: str, n: int, mine: int, now: float) -> None:
        """A peer holds state ``n``; ours is at ``mine`` (-1: not even the descriptor)."""
        self._held[peer] = max(n, self._held.get(peer, -1))
        self._failures.pop(peer, None)
        if n > mine and self.resting:
            self.wake_at = now + self._jitter.between(*self._timers.jitter)

    def gone(self, peer: str, now: float) -> None:
        """A peer has left: do not wait for it."""
        self._held.pop(peer, None)
        if self._asked == peer:
            self._asked = None
            self.wake_at = now

    @property
    def resting(self) -> bool:
        """Whether nobody who would answer is known to hold more than we do."""
        return self.wake_at == _NEVER

    @property
    def idle(self) -> bool:
        """Whether it rests and has nothing either that would be of use when somebody speaks again."""
        return self.resting and self._manifest is None and not self._got

    @property
    def most(self) -> int:
        """The latest state that anybody is known to hold, -1 if nobody is."""
        return max(self._held.values(), default=-1)

    # --- asking

    def poll(self, replica: Replica | None, now: float) -> tuple[str, Want | Need] | None:
        """The next request, and to whom, if it is time for one."""
        self.expire(now)
        if now < self.wake_at:
            return None
        mine = -1 if replica is None else replica.state.n
        provider = self._provider(mine)
        if provider is None:
            self._rest()
            return None
        self._asked = provider
        self._asked_ever.add(provider)
        delay = self._timers.retry * self._timers.backoff**self._tries
        self.wake_at = now + min(delay, self._timers.retry_max)
        if self._manifest is not None:
            some = list(self._missing.items())[: self._tiles_per_need]
            self._requested = {key for key, _ in some}
            return provider, Need(self._session, self._manifest.n, self._manifest.since, Need.pack(some))
        first = replica.first_pending if replica is not None else None
        window = max(mine, 0) + self._timers.window
        self._asked_through = window if first is None else min(first - 1, window)
        needless = first is None and self._timers.window >= WINDOW  # nobody gives more at once
        return provider, Want(self._session, mine, 0 if needless else self._asked_through)

    @property
    def asking(self) -> bool:
        """Whether an answer is waited for."""
        return self._asked is not None

    def expire(self, now: float) -> None:
        """Wait no longer for an answer that is overdue."""
        if self._asked is not None and now >= self.wake_at:
            self._unanswered(self._asked)

    def _unanswered(self, peer: str) -> None:
        self._asked = None
        self._tries += 1
        self._failures[peer] += 1
        if self._failures[peer] >= self._timers.give_up:
            self._held.pop(peer, None)
        if self._tries % _PATIENCE == 0:
            self._drop_manifest()

    def _provider(self, mine: int) -> str | None:
        """Among those who hold more, one who failed us least; which of them is left to chance."""
        able = sorted(peer for peer, n in self._held.items() if n > mine)
        if not able:
            return None
        fewest = min(self._failures[peer] for peer in able)
        best = [peer for peer in able if self._failures[peer] == fewest]
        return best[int(self._jitter.fraction() * len(best))]

    def _rest(self) -> None:
        self._asked = None
        self._tries = 0
        self._failures.clear()
        self.wake_at = _NEVER

    def _drop_manifest(self) -> None:
        self._manifest = None
        self._listed = {}
        self._missing = {}
        self._requested = set()

    # --- answers

    def advanced(self, mine: int, now: float) -> None:
        """The copy has just moved on to ``mine``."""
        if self._manifest is not None and self._manifest.n <= mine:
            self._drop_manifest()
        if self.most <= mine and self._manifest is None:
            self._got.clear()
            self._asked_ever.clear()
            self._rest()
        if self.resting:
            return
        self._tries = 0
        if self._asked is not None and self._manifest is None:
            answered = mine >= self._asked_through
            self._asked = None if answered else self._asked
            self.wake_at = now if answered else now + self._timers.retry

    def keep(self, content: dict[tuple[TileKey, int], Cells]) -> None:
        """Tiles at hand by (key, hash), from a copy that has to be fetched anew."""
        self._got.update(content)

    def offer(self, peer: str, message: Manifest | TilesMessage, mine: State, now: float) -> State | None:
        """Take an answer; gives a later state once all its tiles are here and add up to its root.

        A manifest counts only from a peer that was asked; tiles prove themselves, whoever sends them.

        Raises:
            Drop: ``not_asked``, ``stale``, ``bad_payload``, ``bad_hash``, ``too_many`` or ``bad_root``.
        """
        if isinstance(message, Manifest):
            self._take_manifest(peer, message, mine)
        elif not self._take_tiles(message):
            return None
        self._tries = 0
        if self._requested:
            self.wake_at = now + self._timers.retry
            return None
        self._asked = None
        self.wake_at = now
        return None if self._missing else self._completed(mine)

    def _take_manifest(self, peer: str, manifest: Manifest, mine: State) -> None:
        if peer not in self._asked_ever:
            raise Drop("not_asked")
        newest = 0 if self._manifest is None else self._manifest.n
        if manifest.n <= max(mine.n, newest) or manifest.since > mine.n:
            raise Drop("stale")
        listed = manifest.marks()
        if any(not manifest.since < mark.version <= manifest.n for mark in listed.values()):
            raise Drop("bad_payload")
        if len(mine.marks | listed) > MAX_TILES:
            raise Drop("too_many")
        self._manifest = manifest
        self._listed = listed
        self._requested = set()
        self._got |= {(key, mark.hash): mine.cells[key] for key, mark in mine.marks.items() if key in listed}
        self._missing = {key: mark.hash for key, mark in listed.items() if (key, mark.hash) not in self._got}

    def _take_tiles(self, message: TilesMessage) -> bool:
        """Keep the tiles that are missing; gives whether there was one."""
        if self._manifest is None:
            raise Drop("not_asked")
        before = len(self._missing)
        wrong = False
        for key, cells in decode_tiles(message.payload).items():
            check = tile_hash(key, cells)
            if self._missing.get(key) == check:
                del self._missing[key]
                self._requested.discard(key)
                self._got[key, check] = cells
            elif key in self._missing:
                wrong = True
        if wrong:
            raise Drop("bad_hash")
        return len(self._missing) < before

    def _completed(self, mine: State) -> State:
        """The state at the manifest's checkpoint: what it lists, and all else as we have it, for it did not change."""
        assert self._manifest is not None
        n, root = self._manifest.n, self._manifest.root
        marks = mine.marks | self._listed
        cells = mine.cells | {key: self._got[key, mark.hash] for key, mark in self._listed.items()}
        self._drop_manifest()
        return State.verified(n, marks, cells, root)
