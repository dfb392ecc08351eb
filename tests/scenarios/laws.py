"""What holds in every swarm at every moment, and what must hold once nothing disturbs it any more.

The laws look at the peers from outside: at the copies they hold against the states that the writers really had, at
their sums, at what their tables hold, at what was given to the network. Breaking one raises `Broken`, which names it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from operator import is_

from swarm.limits import MAX_PART_BYTES, MAX_PENDING, MAX_PENDING_BYTES
from swarm.messages import Control, Mark
from swarm.outbox import Lane
from swarm.peer import Peer
from swarm.replica import CHECKPOINT, Replica
from swarm.session import SessionId
from swarm.state import State
from tests.scenarios import oracle
from tests.scenarios.oracle import Entry, Start, Tile, Tiles


class Broken(AssertionError):  # noqa: N818 - the word says it
    """A law does not hold.

    Attributes:
        law: its name.
    """

    def __init__(self, law: str, how: str) -> None:
        self.law = law
        super().__init__(f"{law}: {how}")


@dataclass
class Chronicle:
    """What really happened in one session.

    Attributes:
        writer: who writes it.
        start: where its robot started, as its descriptor says; None if nobody knew.
        states: its tiles and their marks after every update; the index is n.
    """

    writer: str
    start: Start | None
    states: list[tuple[Tiles, dict[Tile, Mark]]] = field(default_factory=lambda: [({}, {})])


class Laws:
    """The laws of one swarm.

    Attributes:
        chronicles: what really happened in each session.
        controls: what operators really decided, and who.
        updates: how many there were in all.
    """

    def __init__(self) -> None:
        self.updates = 0
        self.controls: list[tuple[str, Control]] = []
        self.chronicles: dict[SessionId, Chronicle] = {}
        self._summands: dict[str, set[SessionId]] = {}
        self._seen: dict[tuple[str, SessionId], tuple[_Seen, _Seen]] = {}  # of a peer's copy and its checkpoint

    # --- what writers do

    def written(self, session: SessionId, n: int, state: State) -> None:
        """A writer has just made its update ``n``."""
        states = self.chronicles[session].states
        if n != len(states) or state.n != n:
            raise Broken("one history", f"update {n} follows state {len(states) - 1}")
        states.append((dict(state.cells), dict(state.marks)))
        self.updates += 1

    def published(self, session: SessionId, journal: Sequence[Entry], withdrawn: Collection[int]) -> None:
        """A writer has published all of its journal: its map is that of what it saw.

        Whoever does not know where it started does not know either what stood in its way: it withdraws nothing yet.
        """
        chronicle = self.chronicles[session]
        right = oracle.integrate(journal, chronicle.start or oracle.ORIGIN, withdrawn if chronicle.start else ())
        if not oracle.equal(chronicle.states[-1][0], right):
            raise Broken("a scan is worth the same everywhere", f"{chronicle.writer} published another map than it saw")

    def kept(self, writer: str, peer: Peer, held: dict[SessionId, int]) -> None:
        """A writer that comes back with its file has of its own sessions all that others ever got.

        Args:
            writer: who comes back.
            peer: what it is now.
            held: how much of each session somebody else holds.
        """
        for session, n in held.items():
            if self.chronicles[session].writer == writer and session not in peer.replaced:
                replica = peer.replicas.get(session)
                if replica is None or replica.state.n < n:
                    raise Broken("what is said is kept", f"{writer} said update {n} of {session.hex()} and lacks it")

    # --- at every moment

    def watch(self, name: str, peer: Peer) -> None:
        """A peer has done something: every copy is one of its writer's true past states, and the sum is their sum."""
        touched: set[Tile] = set()
        for session, replica in peer.replicas.items():
            seen = self._seen.get((name, session))
            if seen is None:
                seen = self._seen[name, session] = _Seen(), _Seen()
            if (changed := seen[0].changes(replica.state)) is not None:
                self._true(f"{name}'s copy of {session.hex()}", session, replica.state, changed)
                touched |= changed
            if (changed := seen[1].changes(replica.checkpoint)) is not None:
                self._true(f"{name}'s checkpoint of {session.hex()}", session, replica.checkpoint, changed)
        summands = {replica.descriptor.session for replica in _summands(peer)}
        for session in summands ^ self._summands.get(name, set()):
            touched |= self._seen[name, session][0].tiles
        self._summands[name] = summands
        self._summed(name, peer, touched)

    def _true(self, what: str, session: SessionId, state: State, changed: set[Tile]) -> None:
        chronicle = self.chronicles.get(session)
        states = [({}, {})] if chronicle is None else chronicle.states
        if state.n >= len(states):
            raise Broken("a true past state", f"{what} is at {state.n}, its writer only at {len(states) - 1}")
        cells, marks = states[state.n]
        if state.cells.keys() != cells.keys() or state.marks != marks:
            raise Broken("a true past state", f"{what} at {state.n} has other tiles or versions than its writer had")
        wrong = [key for key in changed & cells.keys() if not oracle.equal({key: state.cells[key]}, {key: cells[key]})]
        if wrong or state.check != (state.n + sum(mark.hash for mark in marks.values())) % 2**64:
            raise Broken("a true past state", f"{what} at {state.n} differs from its writer's in tiles {wrong}")

    def _summed(self, name: str, peer: Peer, touched: set[Tile]) -> None:
        for key in touched:
            held = [{key: cells} for each in _summands(peer) if (cells := each.state.cells.get(key)) is not None]
            summed = {key: cells} if (cells := peer.fusion.tiles.get(key)) is not None else {}
            if not oracle.equal(summed, oracle.total(held)):
                raise Broken("no evidence is counted twice", f"{name}'s sum in tile {key} is not that of its copies")

    def bounded(self, name: str, peer: Peer, *, peers: int) -> None:
        """What a peer keeps stays within its bounds."""
        bounds = {
            "peers": (len(peer.peers), peers),
            "unfinished messages": (peer._joiner._bytes, MAX_PART_BYTES),
            "pursuits": (len(peer._pursuits), len(self.chronicles) + GHOSTS),
            "copies": (len(peer.replicas), len(self.chronicles)),
        }
        for session, replica in peer.replicas.items():
            own = session.hex()
            bounds |= {
                f"ring of {own}": (len(replica._ring), 2 * CHECKPOINT),
                f"early updates of {own}": (len(replica._pending), MAX_PENDING),
                f"their bytes of {own}": (replica._pending_bytes, MAX_PENDING_BYTES),
            }
            if replica._pending_bytes != sum(len(update.payload) for update in replica._pending.values()):
                raise Broken("memory is bounded", f"{name} miscounts the early updates of {own}")
        for lane, queue in peer.outbox._lanes.items():
            if lane is not Lane.UPDATES:
                bounds[f"bytes to say of {lane.value}"] = (sum(map(len, queue)), peer.outbox._profile.queue)
        for what, (size, most) in bounds.items():
            if size > most:
                raise Broken("memory is bounded", f"{name} keeps {size} {what}, at most {most} are right")

    # --- in the end

    def agreed(self, peers: dict[str, Peer], alive: set[SessionId]) -> None:
        """All have one map, and it is what the robots saw.

        Args:
            peers: all that are there.
            alive: the sessions whose writers are there.
        """
        one = next(iter(peers.values()))
        evicted = self._decided(peers)
        if not alive <= one.replicas.keys():
            raise Broken("all agree", "a session is missing")
        truth = [  # what its writer published and nobody heard died with it
            chronicle.states[replica.state.n][0]
            for session, replica in one.replicas.items()
            if (chronicle := self.chronicles[session]).start is not None and session not in evicted
        ]
        expected = oracle.digest(oracle.total(truth))
        for session in alive & one.replicas.keys():
            if one.replicas[session].state.n != len(self.chronicles[session].states) - 1:
                raise Broken("all agree", f"on an old state of {session.hex()}")
        for name, peer in peers.items():
            if peer.fusion.digest() != expected:
                raise Broken("the map is the sum", f"{name}'s map is not the sum of what the robots saw")
            if not all(replica.state.sound() for replica in peer.replicas.values()):
                raise Broken("a true past state", f"{name} holds a copy whose marks are wrong")

    def forget_decisions_of(self, who: str) -> None:
        """Who decided something died and keeps no state: if nobody had heard of it yet, it died too."""
        self.controls = [("" if by == who else by, control) for by, control in self.controls]

    def _decided(self, peers: dict[str, Peer]) -> set[SessionId]:
        """The evicted sessions: of what was decided about each subject the greatest is in force."""
        evicted: set[SessionId] = set()
        for setting, subject in {(control.setting, control.subject) for _, control in self.controls}:
            said = [each for each in self.controls if (each[1].setting, each[1].subject) == (setting, subject)]
            rank = {control: (control.revision, control.issuer, control.value) for _, control in said}
            heard = max((rank[control] for who, control in said if who in peers), default=(0, b"", b""))
            for name, peer in peers.items():
                force = peer.controls.get(setting, subject)
                if force is None and heard[0] == 0:
                    continue  # whoever decided it died with it
                if force not in rank or rank[force] < heard:
                    raise Broken("the last decision is in force", f"{name} follows {force} about {subject!r}")
                if setting == Control.EVICT and force.value == b"\x01":
                    evicted.add(subject)
        return evicted


def _summands(peer: Peer) -> list[Replica]:
    evicted = {
        control.subject for control in peer.controls if (control.setting, control.value) == (Control.EVICT, b"\x01")
    }
    return [
        replica
        for session, replica in peer.replicas.items()
        if replica.descriptor.start is not None and session not in evicted
    ]


GHOSTS = 256
"""Sessions that nobody has and damaged messages speak of: more pursuits than these at once would be too many."""


class _Seen:
    """What was last seen of one state, so that only news is looked at."""

    def __init__(self) -> None:
        self._n = -1
        self._marks: dict[Tile, Mark] = {}
        self._cells: Tiles = {}

    @property
    def tiles(self) -> set[Tile]:
        """Which there were."""
        return set(self._cells)

    def changes(self, state: State) -> set[Tile] | None:
        """The tiles whose arrays are others than last time (or are gone); None if nothing at all is new."""
        before, now = self._cells, state.cells
        same = len(before) == len(now) and all(map(is_, before.values(), now.values()))
        if same and state.n == self._n and state.marks == self._marks:
            return None
        changed = {key for key, cells in now.items() if before.get(key) is not cells} | (before.keys() - now.keys())
        self._n, self._marks, self._cells = state.n, dict(state.marks), dict(now)
        return changed


def conserved(copies: int, network: Counter[str], under_way: int, received: int) -> None:
    """Every copy of a payload that was given to the network was delivered, lost, cut off, or is under way."""
    ended = network["delivered"] + network["lost"] + network["cut"]
    if copies + network["duplicated"] != ended + under_way or network["delivered"] != received:
        raise Broken("every byte is accounted for", f"{copies} payloads left, {under_way} fly, of the rest {network}")
