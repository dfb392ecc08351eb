"""A log as it was at any time: the peer that had heard as much of it as had been recorded until then.

Laws kept here: what is shown at a time follows from the messages that were recorded until then and from nothing else,
however one came there; a jump costs no more than ``KEEP_EVERY`` messages at first, for states are kept on the way
(tiles are copy on write, so that one costs its dictionaries and the tiles that changed since the one before).
"""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from agent.config import Config, resolve
from agent.control import Control as Starter
from agent.log_reader import LogReader
from agent.page import Page
from agent.page_history import History
from agent.page_orders import Order, Play, Seek
from agent.page_snapshot import Snapshot, Snapshots, Timeline, Traffic
from agent.page_tracks import Tracks
from swarm.messages import Control, Hello, Session, Update
from swarm.peer import Peer
from swarm.session import Descriptor, Rules, SessionId
from swarm.state import State
from swarm.told import Told

KEEP_EVERY = 250
"""Messages between two states that are kept, at first; a message takes a fraction of a millisecond."""

MOST_TILES = 1_000_000
"""Tiles that kept states name in all, at some 200 bytes; then every other state goes, and they come half as often."""

_RATE_WINDOW = 5.0
"""Seconds over which rates are taken."""

_TURN = 0.02
"""Seconds from one look at what a person wants to the next."""

_NONE = Traffic({}, {}, {})
"""What the recorded peer sent and dropped is in no log; what is said when one is heard, nobody hears."""


class Moment:
    """A peer that has heard the first messages of a log.

    Attributes:
        peer: it.
        tracks: where the robots went until then.
        count: how many messages it has heard.
    """

    def __init__(self, rules: Rules, tracks: Tracks) -> None:
        self.tracks = tracks
        self.count = 0
        hello = Hello(Hello.OBSERVER, b"log", b"")
        self.peer = Peer(hello, rules, seed=b"log", mtu=32_768, now=0.0, listener=tracks)

    def hear(self, told: Told, seconds: float) -> None:
        """The next message, recorded so many seconds after the log began."""
        self.peer.repeat(told, seconds)
        self.peer.poll(seconds)  # nobody listens to what it says
        self.count += 1


@dataclass(frozen=True, slots=True)
class Kept:
    """What it takes to make a ``Moment`` again."""

    rules: Rules
    count: int
    descriptors: tuple[Descriptor, ...]
    states: dict[SessionId, State]
    heard_at: dict[SessionId, float]
    controls: tuple[Control, ...]
    tracks: Tracks

    @property
    def tiles(self) -> int:
        """How many tiles it names."""
        return sum(len(state.cells) for state in self.states.values())

    @classmethod
    def of(cls, moment: Moment) -> Self:
        """What a moment is made of."""
        peer = moment.peer
        return cls(
            rules=peer.rules,
            count=moment.count,
            descriptors=tuple(peer.descriptors.values()),
            states={session: replica.state.copy() for session, replica in peer.replicas.items()},
            heard_at=peer.heard_at.copy(),
            controls=tuple(peer.controls),
            tracks=moment.tracks.copy(),
        )

    def again(self) -> Moment:
        """That moment, to go on from."""
        moment = Moment(self.rules, self.tracks.copy())
        for control in self.controls:  # first, so that nothing is summed that is evicted
            moment.peer.restore_control(control, 0.0)
        for descriptor in self.descriptors:  # each after the one that it replaces
            session = descriptor.session
            if session in self.states:
                moment.peer.restore(descriptor, self.states[session], (), self.heard_at.get(session, 0.0))
            else:
                moment.peer.repeat(Session(descriptor.encode()), 0.0)
        moment.count = self.count
        return moment


class LogPlayer:
    """Shows one log (``agent.page_source.Source``). It begins at the end: with all that there is of the map.

    Args:
        path: the log.

    Attributes:
        config: the recorded swarm's.

    Raises:
        UserError: it cannot be read, is no log, or has no swarm in it.
    """

    def __init__(self, path: Path) -> None:
        self._log = LogReader(path)
        self.config: Config = resolve(self._log.swarm())
        self._rules = self.config.rules()
        self._coming: Iterator[tuple[int, Told]] = self._log.told()
        self._began_ns: int | None = None
        self._whole = False
        self._told: list[Told] = []
        self._times: list[float] = []  # of each, in seconds; they only grow
        self._ahead = Moment(self._rules, Tracks())
        self._history = History()
        self._keep_every = KEEP_EVERY
        self._kept = [Kept.of(self._ahead)]
        self._shown = self._ahead
        self._snapshots = Snapshots(self._ahead.peer, self._ahead.tracks, {})
        self._seconds = 0.0
        self._speed = 0.0
        self._now: float | None = None

    @property
    def duration(self) -> float:
        """Seconds from the first message to the last that has been read."""
        return self._times[-1] if self._times else 0.0

    def read(self, until: float) -> bool:
        """Read on until a time on ``time.monotonic``; gives whether there is more.

        Raises:
            UserError: the log holds something that no recorder writes.
        """
        while not self._whole and time.monotonic() < until:
            self._hear_next()
        return not self._whole

    def _hear_next(self) -> None:
        """Read one message."""
        following = next(self._coming, None)
        if following is None:
            self._whole = True
            self._remember(last=True)
            return
        log_ns, told = following
        if self._began_ns is None:
            self._began_ns = log_ns
        self._told.append(told)
        self._times.append((log_ns - self._began_ns) / 1e9)
        self._ahead.hear(told, self._times[-1])
        self._remember(last=False)

    def _remember(self, *, last: bool) -> None:
        """Keep a state and a row of the history, if it is time."""
        if self._history.due(self.duration) or last:
            self._history.take(self._ahead.peer.fusion.tiles, self._rules.lattice)
            self._history.note(self.duration, self._rates(self.duration)[None])
        if self._ahead.count - self._kept[-1].count < self._keep_every:
            return
        self._kept.append(Kept.of(self._ahead))
        if len(self._kept) > 2 and sum(kept.tiles for kept in self._kept) > MOST_TILES:
            self._kept = self._kept[::2]
            self._keep_every *= 2

    def take(self, now: float) -> Snapshot:
        """See ``Source``; a log that is played goes on by as much as the clock has."""
        if self._speed and self._now is not None:
            self._go(self._seconds + (now - self._now) * self._speed)
        elif self._at_end:
            self._go(self.duration)
        self._now = now
        rates, shown = self._rates(self._seconds), self._snapshots.take(self._seconds)
        return replace(
            shown,
            now=now,
            sessions=tuple(replace(view, updates_rate=rates[view.session]) for view in shown.sessions),
            bytes_rate=rates[None],
            traffic=_NONE,
            timeline=Timeline(
                self._seconds, self.duration, self._whole, self._log.torn, self._speed, self._history.rows
            ),
        )

    def obey(self, order: Order, now: float) -> None:
        """See ``Source``."""
        match order:
            case Seek(seconds):
                self._go(seconds)
            case Play(speed):
                if speed and not self._speed and self._at_end:
                    self._go(0.0)
                self._speed, self._now = speed, now
            case _:
                raise ValueError("this is a log: there is no swarm that could follow")

    @property
    def _at_end(self) -> bool:
        """Whether all that has been read is shown, and what is read from now on."""
        return self._shown is self._ahead

    def _go(self, seconds: float) -> None:
        """Show the log as it was then."""
        self._seconds = min(max(seconds, 0.0), self.duration)
        if seconds < self.duration:
            self._show(self._moment(bisect_right(self._times, self._seconds)))
        else:
            self._show(self._ahead)
            self._speed = 0.0 if self._whole else self._speed

    def _moment(self, count: int) -> Moment:
        """The one that has heard so many messages: what is shown now, or what was kept last, and what came after."""
        kept = self._kept[bisect_right(self._kept, count, key=lambda each: each.count) - 1]
        moment = self._shown
        if self._at_end or not kept.count <= moment.count <= count:
            moment = kept.again()
        for k in range(moment.count, count):
            moment.hear(self._told[k], self._times[k])
        return moment

    def _show(self, moment: Moment) -> None:
        if moment is not self._shown:
            self._shown, self._snapshots = moment, Snapshots(moment.peer, moment.tracks, {})

    def _rates(self, seconds: float) -> Mapping[SessionId | None, float]:
        """Updates a second of each session in the last seconds before, and under None the bytes of all of them."""
        first, end = bisect_left(self._times, seconds - _RATE_WINDOW), bisect_right(self._times, seconds)
        rates: defaultdict[SessionId | None, float] = defaultdict(float)
        for told in self._told[first:end]:
            if isinstance(told, Update):
                rates[told.session] += 1 / _RATE_WINDOW
                rates[None] += (len(told.payload) + len(told.trail)) / _RATE_WINDOW
        return rates


def show_log(player: LogPlayer, page: Page, control: Starter) -> None:
    """Have a log shown until told to stop; it is read on meanwhile.

    Raises:
        UserError: the log holds something that no recorder writes.
    """
    turn = page.show(player)
    while not control.stop:
        turn(time.monotonic())
        if not player.read(until=time.monotonic() + _TURN):
            time.sleep(_TURN)
    page.end()
