"""One peer of the swarm: everything that it knows and says, as a function of what it hears and when.

Laws kept here: bytes in (``receive``), bytes out (``poll``), time as an argument; only sessions travel, never a merged
map; whatever the wire brings either takes effect whole or is dropped under a named reason; a peer that has a state
serves it, whether its writer lives or not; what is summed follows from the descriptors and control records that are
known, never from the order in which they came (so a descriptor counts only after that of the session it replaces).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from mapping.pose import QuantisedPose
from mapping.raster import Raster, raster
from mapping.tiles import Tiles
from swarm.control_pull import ControlPull
from swarm.controls import EVICTED, READMITTED, Controls, StartPose
from swarm.drops import Drop
from swarm.fusion import Fusion
from swarm.jitter import Jitter
from swarm.limits import MAX_N, MAX_SESSIONS, MIN_MTU
from swarm.messages import (
    REFUSED,
    AskControls,
    Control,
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
from swarm.outbox import Lane, Outbox, Outgoing
from swarm.parts import Joiner, cut
from swarm.pursuits import Pursuits
from swarm.radio import LAN, Profile
from swarm.replica import Replica
from swarm.session import Descriptor, Rules, SessionId, refusal
from swarm.state import Change, State
from swarm.told import Jump, Told
from swarm.trickle import Trickle
from swarm.writer import Publish, Writer

Listener = Callable[[Descriptor, Update], None]
"""Told of every update that is applied, own and others'."""


_LANES: dict[type[Message], Lane] = {
    Session: Lane.UPDATES,  # without it its updates are of no use
    Update: Lane.UPDATES,
    Digest: Lane.DIGESTS,
    Want: Lane.REQUESTS,
    Need: Lane.REQUESTS,
    AskControls: Lane.REQUESTS,
}
"""The class of what a peer says of itself; all else is control. Answers are a class of their own, whatever they are."""


class Peer:
    """A robot's or an observer's view of the swarm.

    Args:
        hello: who we are; the session that we write is filled in.
        rules: of the swarm.
        seed: of all jitter; another one for each peer.
        mtu: the most bytes of a payload on the bus.
        now: the time, in seconds since whenever, as in all methods.
        profile: what the network carries, and how long to wait on it.
        kernel: see ``mapping.raster``.
        listener: told of every update.
        issuer: under what name we decide, 8 bytes of it; else the name in ``hello``.

    Attributes:
        descriptors: of every session that is known, in whatever condition, by session id.
        replicas: a copy of every session that can be summed with ours and is not replaced.
        refused: why other sessions cannot, in words.
        replaced: the sessions in whose place another one is summed, and which.
        controls: the operators' decisions.
        fusion: the global map.
        peers: who is there: what each said in its hello.
        told: the last digest that each of them said.
        dropped: what was dropped, by reason (``swarm.drops.REASONS``).
        outbox: what waits to be sent.
        sent_bytes: payload bytes given to the bus, by topic.
        writer: the own session, of a robot; None too once somebody else has replaced it.
        heard_at: when each session's writer was heard, or news of it.

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
        profile: Profile = LAN,
        kernel: Raster = raster,
        listener: Listener = lambda descriptor, update: None,
        issuer: bytes = b"",
    ) -> None:
        if mtu < MIN_MTU:
            raise ValueError(f"mtu: {mtu} bytes, expected at least {MIN_MTU}")
        self.rules = rules
        self.descriptors: dict[SessionId, Descriptor] = {}
        self.replicas: dict[SessionId, Replica] = {}
        self.refused: dict[SessionId, str] = {}
        self.replaced: dict[SessionId, SessionId] = {}
        self.controls = Controls()
        self.fusion = Fusion()
        self.peers: dict[str, Hello] = {}
        self.told: dict[str, Digest] = {}
        self.dropped: Counter[str] = Counter()
        self.outbox = Outbox(profile, now)
        self.sent_bytes = self.outbox.sent_bytes
        self.writer: Writer | None = None
        self.heard_at: dict[SessionId, float] = {}
        self._hello = hello
        self._issuer = (issuer or hello.name)[:8].ljust(8, b"\0")
        self._timers = profile.timers
        self._deflate = profile.deflate
        self._kernel = kernel
        self._listener = listener
        self._mtu = min(mtu, profile.mtu)
        self._update_bytes = max(self._mtu, profile.update)
        self._jitter = Jitter(seed)
        self._trickle = Trickle(profile.timers, self._jitter, now)
        self._joiner = Joiner()
        self._pursuits = Pursuits(profile.timers, self._jitter, self._mtu)
        self._control_pull = ControlPull(profile.timers, self._jitter)
        self._controls_at = -math.inf
        self._orphans: dict[SessionId, Descriptor] = {}  # by the session that they replace, unknown here as yet
        self._news_at: dict[SessionId, float] = {}
        self._settled_at: float | None = None  # when the newest news will have reached everybody
        self._publish_at = now
        self._rotation = 0
        self._around: set[str] = set()
        self._introduced = False  # whether the hello, as it is now, was said to all

    # --- the own session

    def open_session(self, descriptor: Descriptor, publish: Publish = "auto") -> Writer:
        """Become the writer of a new session.

        A peer writes one at a time: an earlier writer ends, and what it has not published yet is not published any
        more. Its session stays as valid evidence, unless the new one replaces it.

        Raises:
            ValueError: the descriptor does not follow the swarm's rules, is known already, or replaces a session that
                is not known or another robot's.
        """
        if descriptor.session in self.descriptors:
            raise ValueError(f"session {descriptor.session.hex()} is known already")
        if descriptor.replaces is not None and descriptor.replaces not in self.descriptors:
            raise ValueError(f"session {descriptor.replaces.hex()}, which is to be replaced, is not known")
        if (reason := self._refusal(descriptor)) is not None:
            raise ValueError(reason)
        self._know(descriptor)
        self.writer = Writer(self.replicas[descriptor.session], self._kernel, mtu=self._update_bytes, publish=publish)
        self._settled_at = -math.inf  # digests shall be quick from the next poll on
        self._hello = replace(self._hello, session=descriptor.session)
        self._introduced = False
        self._say(Session(descriptor.encode()))
        return self.writer

    def correct(self, tiles: Tiles, now: float) -> None:
        """Replace contents of the own session's tiles by what the robot has learnt since."""
        assert self.writer is not None
        self.flush(now)
        self.writer.correct(tiles)

    def flush(self, now: float) -> None:
        """Publish all that waits now, however many updates it takes: they are sent as the channel allows."""
        if self.writer is not None:
            for made in self.writer.updates():
                self._publish(*made, now)

    def _publish(self, update: Update, change: Change, now: float) -> None:
        assert self.writer is not None
        self._applied(self.writer.replica, update, change, now)
        self._say(update)

    def _publish_some(self, now: float) -> list[Outgoing]:
        """What waits, and as many updates as may be sent at once: if it is time, one; any others only if full."""
        out = self.outbox.take(now)
        while self.writer is not None and self.writer.waiting and self.outbox.ready(now):
            due = now >= self._publish_at
            if due:
                self._publish_at = now + self._timers.update_period
            elif not self.writer.full:
                break
            made = self.writer.next_update(partial=due)
            if made is not None:
                self._publish(*made, now)
                out += self.outbox.take(now)
        return out

    # --- what was kept

    def restore(self, descriptor: Descriptor, checkpoint: State, updates: Iterable[Update], now: float) -> None:
        """Take up a copy of a session as somebody kept it, however old: it is continued like any other.

        Args:
            descriptor: the session's; what it replaces was taken up before.
            checkpoint: a true state of it.
            updates: those that follow it, in order.
            now: seconds.

        Raises:
            Drop: the session cannot be taken, or an update is not what it should be: then the copy ends before it.
        """
        self._repeat_session(Session(descriptor.encode()), now)
        replica = self.replicas[descriptor.session]
        self._changed(replica, replica.install(checkpoint), now)
        for update in updates:
            self._repeat_update(update, now)

    def restore_control(self, control: Control, now: float) -> None:
        """Put a control record in force as somebody kept it.

        Raises:
            Drop: it is none, or a newer one is in force.
        """
        self._take(control, now)

    def repeat(self, told: Told, now: float) -> None:
        """Take what was said once (``swarm.told``), and say it again to all, as its writer or issuer did.

        A later state is not said: whoever lacks it hears of it by digest, and asks. What cannot be taken is dropped.
        """
        try:
            match told:
                case Session():
                    self._repeat_session(told, now)
                case Update():
                    self._repeat_update(told, now)
                case Control():
                    self._take(told, now)
                case Jump(session, state):
                    self._jump(session, state, now)
        except Drop as drop:
            self.dropped[drop.reason] += 1
            return
        if not isinstance(told, Jump):
            self._say(told)

    def _repeat_session(self, message: Session, now: float) -> None:
        parent = Descriptor.decode(message.descriptor).replaces
        if parent is not None and parent not in self.descriptors:
            raise Drop("unknown_session")
        self._session("", message, now)

    def _repeat_update(self, update: Update, now: float) -> None:
        replica = self._followed(update.session)
        if replica is None:
            raise Drop("unknown_session")
        if update.n > replica.state.n + 1:
            raise Drop("too_far_ahead")
        for each, change in replica.offer(update):
            self._applied(replica, each, change, now)
        self._advanced(update.session, now)

    def _jump(self, session: SessionId, state: State, now: float) -> None:
        replica = self._followed(session)
        if replica is None:
            raise Drop("unknown_session")
        if state.n <= replica.state.n:
            raise Drop("stale")
        self._changed(replica, replica.install(state), now)
        self._advanced(session, now)

    # --- operators' decisions

    def evict(self, session: SessionId, now: float) -> None:
        """Decide that a session shall not be summed, anywhere. It is held and served all the same.

        A session that replaces it is judged by its own id.
        """
        self._decide(Control.EVICT, session, EVICTED, now)

    def readmit(self, session: SessionId, now: float) -> None:
        """Decide that an evicted session shall be summed again."""
        self._decide(Control.EVICT, session, READMITTED, now)

    def set_start_pose(self, robot: str, pose: QuantisedPose, now: float) -> None:
        """Decide where a robot started; whoever drives it sees that in ``controls.start_pose`` and opens a session."""
        own = [session for session, replica in self.replicas.items() if replica.descriptor.robot == robot]
        newest = max(own, key=lambda session: (self.heard_at.get(session, -math.inf), session), default=None)
        self._decide(Control.START_POSE, robot.encode(), StartPose(pose, newest).pack(), now)

    def _decide(self, setting: int, subject: bytes, value: bytes, now: float) -> None:
        """Issue a record that supersedes the one in force.

        Raises:
            ValueError: it is none, or there are too many.
        """
        control = self.controls.next(setting, subject, self._issuer, value)
        try:
            self._take(control, now)
        except Drop as drop:
            raise ValueError(f"control record of {subject!r}: {drop}") from None
        self._say(control)

    # --- presence

    def joined(self, peer: str, now: float) -> None:
        """A peer can be heard: tell it at once who we are and what we hold."""
        self._meet(peer, now)
        self._say(self._hello, peer)
        self._say(self._digest_now(), peer)
        self._trickle.reset(now)

    def left(self, peer: str, now: float) -> None:
        """A peer is gone: ask others."""
        self.peers.pop(peer, None)
        self._around.discard(peer)
        self.outbox.forget(peer)
        self.outbox.among(len(self._around), now)
        self.told.pop(peer, None)
        self._control_pull.gone(peer)
        self._pursuits.gone(peer, now)

    def _meet(self, peer: str, now: float) -> None:
        self._around.add(peer)
        self.outbox.among(len(self._around), now)

    # --- time

    @property
    def wake_at(self) -> float:
        """When ``poll`` wants to be called next, if nothing is heard before."""
        times = [self.outbox.wake_at]
        if self.outbox.clear(Lane.DIGESTS):
            times.append(self._trickle.wake_at)
        if self.outbox.clear(Lane.REQUESTS):
            times += [self._control_pull.wake_at, self._pursuits.wake_at]
        if self._settled_at is not None:
            times.append(self._settled_at)
        if self.writer is not None and self.writer.waiting:
            at = self.outbox.open_at
            times.append(at if self.writer.full else max(at, self._publish_at))
        return min(times)

    def poll(self, now: float) -> list[Outgoing]:
        """Everything to be said by now, in order."""
        if not self._introduced:
            self._introduced = True
            self._say(self._hello)
        out = self._publish_some(now)
        if self._settled_at is not None and now >= self._settled_at:
            self._settled_at = None
            self._trickle.reset(now)
        # what would have to wait is not said yet: it will be truer then
        if self.outbox.clear(Lane.DIGESTS) and self._trickle.poll(now):
            self._say(self._digest_now())
        if self.outbox.clear(Lane.REQUESTS):
            self._ask(now)
        return out + self.outbox.take(now)

    def _ask(self, now: float) -> None:
        """Pursue what we lack."""
        if (asked := self._control_pull.poll(self.controls.check, now)) is not None:
            self._say(AskControls(self.controls.check), asked)
        for provider, request in self._pursuits.poll(self.replicas, now):
            self._say(request, provider)

    # --- hearing

    def receive(self, sender: str, payload: bytes, now: float) -> None:
        """Take what a peer said. Never raises for anything that the wire may bring."""
        try:
            message = decode(payload)
            self._alive(sender, now)
            self._handle(sender, message, now)
        except Drop as drop:
            self.dropped[drop.reason] += 1

    def _handle(self, sender: str, message: Message, now: float) -> None:
        match message:
            case Update():
                self._update(sender, message, now)
            case Digest():
                self._digest(sender, message, now)
            case Session():
                self._session(sender, message, now)
            case Want() | Need() | AskControls():
                self._say_answers(self._answer(message), sender)
            case Manifest() | TilesMessage():
                self._fetched(sender, message, now)
            case Hello():
                if sender not in self.peers and len(self.peers) >= MAX_SESSIONS:
                    raise Drop("too_many")
                self.peers[sender] = message
                self._meet(sender, now)
            case Control():
                self._take(message, now)
            case Part():
                whole = self._joiner.join(message)
                if whole is not None:
                    self._handle(sender, whole, now)

    def _update(self, sender: str, update: Update, now: float) -> None:
        replica = self._followed(update.session)
        if replica is None:
            self._pursuits.heard(update.session, sender, update.n, -1, now)
            raise Drop("unknown_session")
        if update.n > replica.state.n + 1:
            self._pursuits.heard(update.session, sender, update.n, replica.state.n, now)
        self._follow(sender, replica, replica.offer(update), now)

    def _digest(self, sender: str, digest: Digest, now: float) -> None:
        """Pursue what the sender has and we lack; be quick to speak if it lacks what we have."""
        if sender in self.peers:
            self.told[sender] = digest
        positions = digest.positions()
        ahead = behind = False
        if digest.controls != self.controls.check:
            if now - self._controls_at > self._timers.settle:
                self._control_pull.heard(sender, digest.controls, now)
                behind = True
            ahead = True
        for session, n in positions.items():
            if session in self.refused or session in self.replaced or n > MAX_N:
                continue  # one of us will never take it: no news to either
            replica = self.replicas.get(session)
            mine = -1 if replica is None else replica.state.n
            if n > mine:
                if self._writes(session):
                    self.dropped["own_session"] += 1
                    continue
                self._pursuits.heard(session, sender, n, mine, now)
                ahead = True
            elif n < mine and now - self._news_at.get(session, -math.inf) > self._timers.settle:
                behind = True
        if digest.complete and not self.replicas.keys() <= positions.keys():
            behind = True
        if behind:
            self._trickle.reset(now)
        elif not ahead:
            self._trickle.consistent()

    def _session(self, sender: str, message: Session, now: float) -> None:
        """Take a descriptor, unless the session that it replaces is unknown: then that one's is asked for first.

        So everybody can tell whether it may replace that session, and whatever that one has replaced is out of the sum
        too. Sessions that replace each other in a circle are never taken, by anybody.
        """
        descriptor = Descriptor.decode(message.descriptor)
        session, parent = descriptor.session, descriptor.replaces
        known = self.descriptors.get(session)
        if known is not None and known != descriptor:
            raise Drop("bad_descriptor")
        if session in self.refused:
            raise Drop("refused_session")
        if known is not None:
            raise Drop("stale")
        if len(self.descriptors) + len(self._orphans) >= MAX_SESSIONS and parent not in self._orphans:
            raise Drop("too_many")
        if parent is not None and parent not in self.descriptors and refusal(self.rules, descriptor) is None:
            self._orphans[parent] = descriptor
            self._pursuits.heard(parent, sender, 0, -1, now)
            raise Drop("unknown_session")
        following: Descriptor | None = descriptor
        while following is not None:
            self._know(following)
            if following.session not in self.refused:
                self._news(following.session, now)
                self._advanced(following.session, now)
            following = self._orphans.pop(following.session, None)
        if session in self.refused:
            raise Drop("refused_session")

    def _fetched(self, sender: str, message: Manifest | TilesMessage, now: float) -> None:
        """An answer to what a catch-up asked for: perhaps the last piece of a later state."""
        replica = self.replicas.get(message.session)
        if replica is None:
            raise Drop("not_asked")
        try:
            state = self._pursuits.offer(sender, message, replica.state, now)
        except Drop as drop:
            if drop.reason == "bad_root":
                self._start_over(sender, replica, now)
            raise
        if state is not None:
            self._changed(replica, replica.install(state), now)
            self._advanced(replica.descriptor.session, now)
            self._follow(sender, replica, replica.drain(), now)

    # --- what changes

    def _know(self, descriptor: Descriptor) -> None:
        """A session that was not known is there: follow it, or refuse it for good; what it replaces is over."""
        session = descriptor.session
        self.descriptors[session] = descriptor
        if (reason := self._refusal(descriptor)) is not None:
            self.refused[session] = f"{descriptor.robot}: {reason}"
            self._pursuits.forget(session)
            return
        self.replicas[session] = Replica(descriptor, self._kernel, deflate=self._deflate)
        if descriptor.replaces is not None:
            self._replace(descriptor.replaces, session)

    def _refusal(self, descriptor: Descriptor) -> str | None:
        """Why a session can never be summed with ours, in words, or None if it can; what it replaces is known."""
        reason = refusal(self.rules, descriptor)
        if reason is None and descriptor.replaces is not None:
            parent = self.descriptors[descriptor.replaces]
            if parent.robot != descriptor.robot:
                reason = f"replaces session {parent.session.hex()}, which is robot {parent.robot}'s"
            elif parent.session in self.refused:
                reason = f"replaces session {parent.session.hex()}, which is refused"
        return reason

    def _replace(self, old: SessionId, new: SessionId) -> None:
        """Forget the contents of a session in whose place another one is summed from now on."""
        self.replaced[old] = min(new, self.replaced.get(old, new))
        replica = self.replicas.pop(old, None)
        if replica is None:
            return
        if self._writes(old):
            self.writer = None
        self._pursuits.forget(old)
        for table in (self._news_at, self.heard_at):
            table.pop(old, None)
        if self._summed(replica):
            self.fusion.resum(replica.state.cells, self._maps())

    def _take(self, control: Control, now: float) -> None:
        """Put a control record in force; an evicted session leaves the sum, a readmitted one comes back."""
        replica = self.replicas.get(control.subject) if control.setting == Control.EVICT else None
        before = replica is not None and self._summed(replica)
        if not self.controls.put(control):
            raise Drop("stale")
        self._controls_at = now
        self._settled_at = now + self._timers.settle
        if replica is not None and self._summed(replica) != before:
            self.fusion.resum(replica.state.cells, self._maps())

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
                self._advanced(replica.descriptor.session, now)

    def _applied(self, replica: Replica, update: Update, change: Change, now: float) -> None:
        self._changed(replica, change, now)
        self._listener(replica.descriptor, update)

    def _changed(self, replica: Replica, change: Change, now: float) -> None:
        if self._summed(replica):
            self.fusion.add(change)
        self._news(replica.descriptor.session, now)

    def _news(self, session: SessionId, now: float) -> None:
        self._news_at[session] = self.heard_at[session] = now
        self._settled_at = now + self._timers.settle

    def _alive(self, peer: str, now: float) -> None:
        """A peer was heard: so was the writer of the session that it writes."""
        hello = self.peers.get(peer)
        if hello is not None and hello.session in self.replicas:
            self.heard_at[hello.session] = now

    def _advanced(self, session: SessionId, now: float) -> None:
        self._pursuits.advanced(session, self.replicas[session].state.n, now)

    def _start_over(self, sender: str, replica: Replica, now: float) -> None:
        """A copy proved wrong: back to the empty state, keeping what is sound of it to spare the wire.

        The sum is made anew, for nobody knows what of the wrong copy went into it.
        """
        session, wrong = replica.descriptor.session, replica.state
        replica.restart()
        self._pursuits.start_over(session, sender, wrong, now)
        self.fusion.rebuild(self._maps())
        self._news(session, now)

    # --- look-ups

    def known_n(self, session: SessionId) -> int:
        """The latest state of a session that anybody is known to hold, -1 if nobody is."""
        replica = self.replicas.get(session)
        return max(-1 if replica is None else replica.state.n, self._pursuits.most(session))

    def is_heard(self) -> bool:
        """Whether somebody who is there has told that it holds all of the own session, or nobody is there to."""
        if self.writer is None or not self.peers:
            return True
        session, n = self.writer.replica.descriptor.session, self.writer.replica.state.n
        return any(digest.positions().get(session, -1) >= n for digest in self.told.values())

    def live(self) -> set[SessionId]:
        """The sessions that somebody who is there writes, the own one included."""
        own = {self._hello.session} if self.writer is not None else set()
        return (own | {hello.session for hello in self.peers.values()}) & self.replicas.keys()

    def _summed(self, replica: Replica) -> bool:
        """Whether a session that is held is part of the global map."""
        descriptor = replica.descriptor
        return descriptor.start is not None and descriptor.session not in self.controls.evicted

    def _maps(self) -> list[Tiles]:
        return [replica.state.cells for replica in self.replicas.values() if self._summed(replica)]

    def _writes(self, session: SessionId) -> bool:
        return self.writer is not None and self.writer.replica.descriptor.session == session

    def _followed(self, session: SessionId) -> Replica | None:
        """The copy of a session that somebody else writes, if it is known."""
        if self._writes(session):
            raise Drop("own_session")
        if session in self.refused:
            raise Drop("refused_session")
        if session in self.replaced:
            raise Drop("replaced_session")
        return self.replicas.get(session)

    def _answer(self, request: Want | Need | AskControls) -> Iterable[Message]:
        """What helps the asker along; of a session that is replaced there is only the descriptor left."""
        match request:
            case AskControls(check):
                return [] if check == self.controls.check else self.controls
            case Need(session):
                return self._served(session).supply(request, self._mtu)
            case Want(session, -1) if session in self.replaced:
                return [Session(self.descriptors[session].encode())]
            case Want(session):
                return self._served(session).answer(request)

    def _served(self, session: SessionId) -> Replica:
        if session in self.replaced:
            raise Drop("replaced_session")
        replica = self.replicas.get(session)
        if replica is None:
            raise Drop("unknown_session")
        return replica

    # --- speaking

    def _digest_now(self) -> Digest:
        """What we hold; of more sessions than fit into one payload the next ones in turn."""
        held = {session: replica.state.n for session, replica in self.replicas.items()}
        positions = sorted((held | dict.fromkeys(self.refused, REFUSED)).items())
        size = Digest.fitting(self._mtu)
        if len(positions) <= size:
            return Digest.of(positions, complete=True, controls=self.controls.check)
        self._rotation = (self._rotation + size) % len(positions)
        turned = positions[self._rotation :] + positions[: self._rotation]
        return Digest.of(turned[:size], complete=False, controls=self.controls.check)

    def _say(self, message: Message, to: str | None = None) -> None:
        self._queue(_LANES.get(type(message), Lane.CONTROL), message, to)

    def _say_answers(self, messages: Iterable[Message], to: str) -> None:
        """Say what was asked for as far as there is room for it; the rest will be asked for again."""
        for message in messages:
            if not self._queue(Lane.ANSWERS, message, to):
                break

    def _queue(self, lane: Lane, message: Message, to: str | None) -> bool:
        payloads = cut(encode(message), self._mtu)
        topic = message.TOPIC if len(payloads) == 1 else Part.TOPIC
        return self.outbox.put(lane, topic, payloads, to)
