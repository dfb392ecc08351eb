"""What a peer knows, as a value that another thread may read: made by the peer's loop, which goes on meanwhile.

Laws kept here: nothing that a snapshot holds is ever written again. Tiles are copy on write, so a snapshot costs the
loop a copy of each dictionary that has changed, and no cell.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from agent.page_tracks import Track, Tracks
from mapping.lattice import Cells, TileKey
from mapping.pose import QuantisedPose
from mapping.tiles import Tiles
from swarm.contributions import Contribution, contributions
from swarm.messages import REFUSED, Digest, Hello
from swarm.peer import Peer
from swarm.session import Rules, SessionId
from swarm.state import State

_RATE_WINDOW = 5.0
"""Seconds over which rates are taken."""

Lost = Callable[[], dict[str, int]]
"""What the bus had to drop, in messages by reason; called by the peer's loop."""


@dataclass(frozen=True, slots=True, eq=False)
class SessionView:
    """One session.

    Attributes:
        contribution: how it stands.
        known_n: the latest update that anybody is known to hold, -1 if nobody is.
        age: seconds since its writer, or news of it, was heard; None if never.
        tiles: its evidence; empty if it is not held.
        track: where its robot went.
        updates_rate: updates a second.
        bytes_rate: payload bytes a second that its writer sent, whatever they were about; None if it is not there.
        start: where its robot is decided or said to have started, or None.
    """

    contribution: Contribution
    known_n: int
    age: float | None
    tiles: Tiles
    track: Track
    updates_rate: float
    bytes_rate: float | None
    start: QuantisedPose | None

    @property
    def session(self) -> SessionId:
        """Its id."""
        return self.contribution.descriptor.session


class HistoryRow(NamedTuple):
    """What was so at one time.

    Attributes:
        seconds: since the beginning.
        known_m2: area that was known, in square metres.
        bytes_rate: payload bytes a second.
    """

    seconds: float
    known_m2: float
    bytes_rate: int


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """Where in a log one is.

    Attributes:
        seconds: since it began.
        duration: of as much of it as has been read.
        whole: whether all has been read.
        torn: why it ends early, in words; empty if it does not, as far as is known.
        speed: times real time; 0 if it stands still.
        history: of the whole log, as far as it has been read.
    """

    seconds: float
    duration: float
    whole: bool
    torn: str
    speed: float
    history: Sequence[HistoryRow]


class PeerView(NamedTuple):
    """Another peer that is there.

    Attributes:
        name: as it calls itself.
        robot: whether it is one.
        same: whether it last said that it holds what we hold; None if it has not said anything.
        bytes_rate: payload bytes a second that came from it.
    """

    name: str
    robot: bool
    same: bool | None
    bytes_rate: int


class Traffic(NamedTuple):
    """What a peer itself did so far.

    Attributes:
        dropped: messages that it, or its bus, had to drop, by reason.
        sent: payload bytes given to the bus, by topic.
        spent: the same by class (``swarm.outbox.Lane``).
    """

    dropped: dict[str, int]
    sent: dict[str, int]
    spent: dict[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What a peer knew at one time.

    Attributes:
        now: seconds since whenever.
        rules: the lattice and the evidence model.
        fused: the global map.
        sessions: in order of robot and session.
        peers: who else is there, by name.
        bytes_rate: payload bytes a second that came in.
        traffic: what we sent and dropped.
        timeline: of a log; None of a peer at work.
    """

    now: float
    rules: Rules
    fused: Tiles
    sessions: tuple[SessionView, ...]
    peers: tuple[PeerView, ...]
    bytes_rate: float
    traffic: Traffic
    timeline: Timeline | None = None


class Rate:
    """How fast a count grows, over the last seconds."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, int]] = deque()

    def __call__(self, now: float, count: int) -> float:
        """The rate a second with the count as it is now."""
        if self._samples and self._samples[-1][0] == now:
            self._samples.pop()
        self._samples.append((now, count))
        while len(self._samples) > 2 and self._samples[1][0] <= now - _RATE_WINDOW:
            self._samples.popleft()
        first, base = self._samples[0]
        return max(0.0, (count - base) / (now - first)) if now - first > 0.5 else 0.0


class Snapshots:
    """Makes them, one after the other.

    Args:
        peer: of whom.
        tracks: what its updates told.
        heard_bytes: payload bytes heard from each other peer.
        lost: what the bus had to drop.
    """

    def __init__(self, peer: Peer, tracks: Tracks, heard_bytes: Mapping[str, int], lost: Lost = dict) -> None:
        self._peer = peer
        self._tracks = tracks
        self._heard = heard_bytes
        self._lost = lost
        self._tiles: dict[SessionId, tuple[State, int, dict[TileKey, Cells]]] = {}
        self._rates: dict[object, Rate] = {}
        self._counted: dict[str, int] = {}
        self._heard_in_all = 0

    def take(self, now: float) -> Snapshot:
        """What the peer knows now."""
        peer = self._peer
        self._tracks.keep_only(set(peer.replicas))
        self._tiles = {session: held for session, held in self._tiles.items() if session in peer.replicas}
        known = peer.descriptors.keys() | set(self._heard) | {None}
        self._rates = {key: rate for key, rate in self._rates.items() if key in known}
        rates = {name: self._rate(name, now, self._heard.get(name, 0)) for name in peer.peers}
        writers = {hello.session: rates[name] for name, hello in peer.peers.items() if hello.session}
        return Snapshot(
            now=now,
            rules=peer.rules,
            fused=peer.fusion.tiles.copy(),
            sessions=tuple(self._session(each, writers, now) for each in contributions(peer, now)),
            peers=tuple(self._peers(rates)),
            bytes_rate=self._rate(None, now, self._in_all()),
            traffic=Traffic({**peer.dropped, **self._lost()}, dict(peer.sent_bytes), dict(peer.outbox.spent)),
        )

    def _session(self, contribution: Contribution, writers: Mapping[bytes, float], now: float) -> SessionView:
        peer, descriptor = self._peer, contribution.descriptor
        session = descriptor.session
        heard_at = peer.heard_at.get(session)
        decided = peer.controls.start_pose(descriptor.robot)
        return SessionView(
            contribution=contribution,
            known_n=peer.known_n(session),
            age=None if heard_at is None else now - heard_at,
            tiles=self._held(session),
            track=self._tracks.of(session),
            updates_rate=self._rate(session, now, contribution.n),
            bytes_rate=writers.get(session),
            start=descriptor.start if decided is None else decided.pose,
        )

    def _held(self, session: SessionId) -> dict[TileKey, Cells]:
        """A copy of the session's dictionary; the same one for as long as nothing changes."""
        replica = self._peer.replicas.get(session)
        if replica is None:
            return {}
        state = replica.state
        known = self._tiles.get(session)
        if known is not None and known[0] is state and known[1] == state.n:
            return known[2]
        tiles = state.cells.copy()
        self._tiles[session] = state, state.n, tiles
        return tiles

    def _in_all(self) -> int:
        """Payload bytes heard so far, also from those who have left."""
        before, self._counted = self._counted, dict(self._heard)
        self._heard_in_all += sum(max(0, count - before.get(name, 0)) for name, count in self._counted.items())
        return self._heard_in_all

    def _peers(self, rates: Mapping[str, float]) -> list[PeerView]:
        views = []
        for peer, hello in self._peer.peers.items():
            told = self._peer.told.get(peer)
            same = None if told is None else self._is_ours(told)
            views.append(PeerView(hello.name.decode("latin-1"), hello.role == Hello.ROBOT, same, round(rates[peer])))
        return sorted(views, key=lambda view: view.name)

    def _is_ours(self, told: Digest) -> bool:
        """Whether a peer that said so holds the same updates and decisions, hence the same map."""
        held = {session: replica.state.n for session, replica in self._peer.replicas.items()}
        known, theirs = self._peer.descriptors, told.positions()
        strange = any(n not in {0, REFUSED} for session, n in theirs.items() if session not in known)
        shared = {session: n for session, n in theirs.items() if session in held}
        ours = held if told.complete else {session: held[session] for session in shared}
        return told.controls == self._peer.controls.check and shared == ours and not strange

    def _rate(self, of: object, now: float, count: int) -> float:
        return self._rates.setdefault(of, Rate())(now, count)
