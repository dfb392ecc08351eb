"""One peer of the swarm: everything that it knows and says, as a function of what it hears and when.

Laws kept here: bytes in (``receive``), bytes out (``poll``), time as an argument; only sessions travel, never a merged
map; whatever the wire brings either takes effect whole or is dropped under a named reason; a peer that has a state
serves it, whether its writer lives or not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from mapping.raster import Raster, raster
from mapping.tiles import Tiles
from swarm.catch_up import CatchUp
from swarm.drops import Drop
from swarm.fusion import Fusion
from swarm.jitter import Jitter
from swarm.limits import MAX_N, MAX_SESSIONS, MIN_MTU
from swarm.messages import (
    REFUSED,
    Digest,
    Hello,
    Manifest,
    Message,
    Need,
    Part,
    Session,
    TilesMessage,
    Update,
    Want,
    decode,
    encode,
)
from swarm.parts import Joiner, cut
from swarm.replica import Replica
from swarm.session import Descriptor, Rules, SessionId, refusal
from swarm.state import Change
from swarm.timers import LAN, Timers
from swarm.trickle import Trickle
from swarm.writer import Publish, Writer

Listener = Callable[[Descriptor, Update], None]
"""Told of every update that is applied, own and others'."""


class Outgoing(NamedTuple):
    """A payload to give to the bus.

    Attributes:
        to: the one peer it is for, or None for all.
        topic: what kind of traffic it is.
        payload: bytes, never longer than the MTU.
    """

    to: str | None
    topic: str
    payload: bytes


class Peer:
    """A robot's or an observer's view of the swarm.

    Attributes:
        replicas: a copy of every session that is known and can be summed with ours, by session id.
        refused: why other sessions cannot, in words.
        fusion: the global map.
        peers: who is there: what each said in its hello.
        dropped: what was dropped, by reason (``swarm.drops.REASONS``).
        sent_bytes: payload bytes given to the bus, by topic.
        writer: the own session, of a robot.

    Raises:
        ValueError: the MTU is too small for the protocol.
    """

    def __init__(
        self,
        hello: Hello,
        rules: Rules,
        *,
        seed: bytes,
        mtu: int,
        now: float,
        timers: Timers = LAN,
        kernel: Raster = raster,
        listener: Listener = lambda descriptor, update: None,
    ) -> None:
        if mtu < MIN_MTU:
            raise ValueError(f"mtu: {mtu} bytes, expected at least {MIN_MTU}")
        self.rules = rules
        self.replicas: dict[SessionId, Replica] = {}
        self.refused: dict[SessionId, str] = {}
        self.fusion = Fusion()
        self.peers: dict[str, Hello] = {}
        self.dropped: Counter[str] = Counter()
        self.sent_bytes: Counter[str] = Counter()
        self.writer: Writer | None = None
        self._hello = hello
        self._timers = timers
        self._kernel = kernel
        self._listener = listener
        self._mtu = mtu
        self._jitter = Jitter(seed)
        self._trickle = Trickle(timers, self._jitter, now)
        self._joiner = Joiner()
        self._catch_ups: dict[SessionId, CatchUp] = {}
        self._news_at: dict[SessionId, float] = {}
        self._settled_at: float | None = None  # when the newest news will have reached everybody
        self._publish_at = now
        self._rotation = 0
        self._out: list[Outgoing] = []
        self._say(hello)

    # --- the own session

    def open_session(self, descriptor: Descriptor, publish: Publish = "auto") -> Writer:
        """Become the writer of a new session. A peer writes at most one.

        Raises:
            ValueError: the descriptor does not follow the swarm's rules.
        """
        assert self.writer is None
        if (reason := refusal(self.rules, descriptor)) is not None:
            raise ValueError(reason)
        replica = self.replicas[descriptor.session] = Replica(descriptor, self._kernel)
        self.writer = Writer(replica, self._kernel, mtu=self._mtu, publish=publish)
        self._say(Session(descriptor.encode()))
        return self.writer

    def correct(self, tiles: Tiles, now: float) -> None:
        """Replace contents of the own session's tiles by what the robot has learnt since."""
        assert self.writer is not None
        self._publish(self.writer.updates(), now)
        self._publish(self.writer.correct(tiles), now)

    def _publish(self, updates: Iterator[tuple[Update, Change]], now: float) -> None:
        assert self.writer is not None
        for update, change in updates:
            self._applied(self.writer.replica, update, change, now)
            self._say(update)

    # --- presence

    def joined(self, peer: str, now: float) -> None:
        """A peer can be heard: tell it at once who we are and what we hold."""
        self._say(self._hello, peer)
        self._say(self._digest_now(), peer)
        self._trickle.reset(now)

    def left(self, peer: str, now: float) -> None:
        """A peer is gone: ask others."""
        self.peers.pop(peer, None)
        for catch_up in self._catch_ups.values():
            catch_up.gone(peer, now)

    # --- time

    @property
    def wake_at(self) -> float:
        """When ``poll`` wants to be called next, if nothing is heard before."""
        times = [self._trickle.wake_at, *(catch_up.wake_at for catch_up in self._catch_ups.values())]
        if self._settled_at is not None:
            times.append(self._settled_at)
        if self.writer is not None and self.writer.waiting:
            times.append(self._publish_at)
        return min(times)

    def poll(self, now: float) -> list[Outgoing]:
        """Everything to be said by now, in order."""
        if self.writer is not None and self.writer.waiting and now >= self._publish_at:
            self._publish_at = now + self._timers.update_period
            self._publish(self.writer.updates(), now)
        if self._settled_at is not None and now >= self._settled_at:
            self._settled_at = None
            self._trickle.reset(now)
        if self._trickle.poll(now):
            self._say(self._digest_now())
        for session, catch_up in list(self._catch_ups.items()):
            if (request := catch_up.poll(self.replicas.get(session), now)) is not None:
                provider, message = request
                self._say(message, provider)
            if catch_up.resting:
                del self._catch_ups[session]
        out, self._out = self._out, []
        return out

    # --- hearing

    def receive(self, sender: str, payload: bytes, now: float) -> None:
        """Take what a peer said. Never raises for anything that the wire may bring."""
        try:
            self._handle(sender, decode(payload), now)
        except Drop as drop:
            self.dropped[drop.reason] += 1

    def _handle(self, sender: str, message: Message, now: float) -> None:
        match message:
            case Update():
                self._update(sender, message, now)
            case Digest():
                self._digest(sender, message, now)
            case Session():
                self._session(message, now)
            case Want():
                self._say_all(self._served(message.session).answer(message), sender)
            case Need():
                self._say_all(self._served(message.session).supply(message, self._mtu), sender)
            case Manifest() | TilesMessage():
                self._fetched(sender, message, now)
            case Hello():
                if sender not in self.peers and len(self.peers) >= MAX_SESSIONS:
                    raise Drop("too_many")
                self.peers[sender] = message
            case Part():
                whole = self._joiner.join(message)
                if whole is not None:
                    self._handle(sender, whole, now)

    def _update(self, sender: str, update: Update, now: float) -> None:
        replica = self._followed(update.session)
        if replica is None:
            self._catch_up(update.session).heard(sender, update.n, -1, now)
            raise Drop("unknown_session")
        if update.n > replica.state.n + 1:
            self._catch_up(update.session).heard(sender, update.n, replica.state.n, now)
        self._follow(sender, replica, replica.offer(update), now)

    def _digest(self, sender: str, digest: Digest, now: float) -> None:
        """Pursue what the sender has and we lack; be quick to speak if it lacks what we have."""
        positions = digest.positions()
        ahead = behind = False
        for session, n in positions.items():
            if session in self.refused or n > MAX_N:  # one of us will never take it: no news to either
                continue
            replica = self.replicas.get(session)
            mine = -1 if replica is None else replica.state.n
            if n > mine:
                if self._writes(session):
                    self.dropped["own_session"] += 1
                    continue
                self._catch_up(session).heard(sender, n, mine, now)
                ahead = True
            elif n < mine and now - self._news_at[session] > self._timers.settle:
                behind = True
        if digest.complete and not self.replicas.keys() <= positions.keys():
            behind = True
        if behind:
            self._trickle.reset(now)
        elif not ahead:
            self._trickle.consistent()

    def _session(self, message: Session, now: float) -> None:
        descriptor = Descriptor.decode(message.descriptor)
        known = self.replicas.get(descriptor.session)
        if known is not None:
            raise Drop("stale" if known.descriptor == descriptor else "bad_descriptor")
        if descriptor.session in self.refused:
            raise Drop("refused_session")
        if len(self.replicas) + len(self.refused) >= MAX_SESSIONS:
            raise Drop("too_many")
        reason = refusal(self.rules, descriptor)
        if reason is not None:
            self.refused[descriptor.session] = f"{descriptor.robot}: {reason}"
            self._catch_ups.pop(descriptor.session, None)
            raise Drop("refused_session")
        replica = self.replicas[descriptor.session] = Replica(descriptor, self._kernel)
        self._news(replica, now)
        self._advanced(replica, now)

    def _fetched(self, sender: str, message: Manifest | TilesMessage, now: float) -> None:
        """An answer to what a catch-up asked for: perhaps the last piece of a later state."""
        replica = self.replicas.get(message.session)
        catch_up = self._catch_ups.get(message.session)
        if replica is None or catch_up is None:
            raise Drop("not_asked")
        try:
            state = catch_up.offer(message, replica.state, now)
        except Drop as drop:
            if drop.reason == "bad_root":
                self._start_over(sender, replica, now)
            raise
        if state is not None:
            self._changed(replica, replica.install(state), now)
            self._advanced(replica, now)
            self._follow(sender, replica, replica.drain(), now)

    # --- what changes

    def _follow(self, sender: str, replica: Replica, updates: Iterator[tuple[Update, Change]], now: float) -> None:
        """Take in the updates that a copy applies, as far as they are good."""
        before = replica.state.n
        try:
            for update, change in updates:
                self._applied(replica, update, change, now)
        except Drop as drop:
            if drop.reason == "bad_check" and not replica.state.sound():
                self._start_over(sender, replica, now)
            raise
        finally:
            if replica.state.n > before:
                self._advanced(replica, now)

    def _applied(self, replica: Replica, update: Update, change: Change, now: float) -> None:
        self._changed(replica, change, now)
        self._listener(replica.descriptor, update)

    def _changed(self, replica: Replica, change: Change, now: float) -> None:
        if replica.descriptor.start is not None:
            self.fusion.add(change)
        self._news(replica, now)

    def _news(self, replica: Replica, now: float) -> None:
        self._news_at[replica.descriptor.session] = now
        self._settled_at = now + self._timers.settle

    def _advanced(self, replica: Replica, now: float) -> None:
        catch_up = self._catch_ups.get(replica.descriptor.session)
        if catch_up is not None:
            catch_up.advanced(replica.state.n, now)

    def _start_over(self, sender: str, replica: Replica, now: float) -> None:
        """A copy proved wrong: back to the empty state, keeping what is sound of it to spare the wire.

        The sum is made anew, for nobody knows what of the wrong copy went into it.
        """
        catch_up = self._catch_up(replica.descriptor.session)
        catch_up.keep(replica.state.sound_tiles())
        catch_up.heard(sender, replica.state.n, 0, now)
        replica.restart()
        catch_up.advanced(0, now)
        self.fusion.rebuild([each.state.cells for each in self.replicas.values() if each.descriptor.start is not None])
        self._news(replica, now)

    # --- look-ups

    def _writes(self, session: SessionId) -> bool:
        return self.writer is not None and self.writer.replica.descriptor.session == session

    def _followed(self, session: SessionId) -> Replica | None:
        """The copy of a session that somebody else writes, if it is known."""
        if self._writes(session):
            raise Drop("own_session")
        if session in self.refused:
            raise Drop("refused_session")
        return self.replicas.get(session)

    def _served(self, session: SessionId) -> Replica:
        replica = self.replicas.get(session)
        if replica is None:
            raise Drop("unknown_session")
        return replica

    def _catch_up(self, session: SessionId) -> CatchUp:
        if session not in self._catch_ups:
            if len(self._catch_ups) >= MAX_SESSIONS:
                raise Drop("too_many")
            self._catch_ups[session] = CatchUp(session, self._timers, self._jitter, self._mtu)
        return self._catch_ups[session]

    # --- speaking

    def _digest_now(self) -> Digest:
        """What we hold; of more sessions than fit into one payload the next ones in turn."""
        held = {session: replica.state.n for session, replica in self.replicas.items()}
        positions = sorted((held | dict.fromkeys(self.refused, REFUSED)).items())
        size = Digest.fitting(self._mtu)
        if len(positions) <= size:
            return Digest.of(positions, complete=True)
        self._rotation = (self._rotation + size) % len(positions)
        turned = positions[self._rotation :] + positions[: self._rotation]
        return Digest.of(turned[:size], complete=False)

    def _say(self, message: Message, to: str | None = None) -> None:
        for payload in cut(encode(message), self._mtu):
            self._out.append(Outgoing(to, message.TOPIC, payload))
            self.sent_bytes[message.TOPIC] += len(payload)

    def _say_all(self, messages: Iterable[Message], to: str) -> None:
        for message in messages:
            self._say(message, to)
