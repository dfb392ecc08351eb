"""A peer at work: the one loop that owns a process's state.

body -> scans -> the peer's own session -> bus; bus -> the peer -> the fused map. Everything happens in this loop, in
this thread; other threads only put bytes into the bus's queue. Only ``run`` looks at the clock: a turn of the loop is
told what came in and what time it is, so that a whole swarm of nodes runs under a fake one.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from agent.body import Body
from agent.control import Control
from agent.keeper import Keeper, NoKeeper
from agent.kernel import Kernel
from agent.map_service import serve_map
from agent.own_session import OwnSession
from agent.readings import Readings
from agent.team_mates import NoMates, TeamMates
from mapping.pose import QuantisedPose
from mapping.sensor import Beam, Sensor
from swarm.contributions import contributions
from swarm.messages import Hello
from swarm.peer import Listener, Peer
from swarm.radio import LAN, Profile
from swarm.session import Rules, SessionId
from swarm.told import Told
from swarm.writer import Publish
from transport.bus import Bus, Event, Joined, Left, Message

SOFTWARE = b"orion-swarm"
_STATUS_PERIOD = 0.1
_REST = 0.02
_LAST_LOOKS = 50  # with such a rest between them: so long whoever ends stays for those who have not heard all of it
_NO_SENSOR = Sensor((Beam(0, 0, 0),), 1)


class NoBody:
    """The body of an observer, or of a run that is over: it senses nothing and is always done."""

    progress = (0, 0)
    done = True
    patience = 0.02
    status = ""

    def __init__(self, sensor: Sensor = _NO_SENSOR) -> None:
        self.sensor = sensor

    def place(self, start: QuantisedPose) -> None:
        """There is nothing to place."""

    def read(self, until: float) -> Readings:
        """Nothing, ever."""
        return Readings.empty(len(self.sensor.beams))

    def close(self) -> None:
        """Nothing moves."""


def peer_name(name: str) -> str:
    """A name on the bus that no other process has, not even a restart of the same robot."""
    return f"{name}.{secrets.token_hex(4)}"


class Node:
    """One process of the swarm.

    Args:
        bus: how it hears and is heard.
        rules: what all robots of the swarm share.
        hello: who it is.
        now: seconds on the clock that its turns are told.
        body: its senses, of a robot.
        speed: how much faster than that clock the body's time runs.
        profile: what the network carries, whatever the bus would.
        listener: told of every update that is applied.
        keeper: what it remembers from one run to the next.

    Attributes:
        peer: all that it knows of the swarm.
        own: the session that it writes, of a robot.
        scans: how many its body has sensed.
        heard_bytes: payload bytes that came from each peer that is there.
    """

    def __init__(
        self,
        bus: Bus,
        rules: Rules,
        hello: Hello,
        *,
        now: float,
        body: Body | None = None,
        speed: float = 1.0,
        profile: Profile = LAN,
        listener: Listener = lambda descriptor, update: None,
        keeper: Keeper | NoKeeper | None = None,
    ) -> None:
        self._bus = bus
        self._keeper = NoKeeper() if keeper is None else keeper
        self._body: Body = NoBody() if body is None else body
        self._speed = speed
        self._update_period = profile.timers.update_period
        self._kernel = Kernel()
        self._now = now
        self._began: float | None = None
        self._around: set[str] = set()
        self._told: dict[str, Any] = {}
        self._told_at = -math.inf
        self._in_exchange = False  # with one of the peers, by what we said last
        self.scans = 0
        self.heard_bytes: Counter[str] = Counter()
        self.own: OwnSession | None = None
        self._earlier: OwnSession | None = None  # an earlier run's, which is published anew before we go on
        self.peer = Peer(
            hello,
            rules,
            seed=bus.peer.encode(),
            mtu=bus.mtu,
            now=now,
            profile=profile,
            kernel=self._kernel,
            listener=listener,
        )
        self._keeper.restore(self.peer, now)
        serve_map(bus, self.peer)

    def open_session(
        self,
        robot: str,
        start: QuantisedPose | None,
        publish: Publish,
        mates: TeamMates | NoMates,
        new_id: Callable[[], SessionId] = lambda: secrets.token_bytes(8),
    ) -> OwnSession:
        """Become the writer of a new session of that robot; see ``OwnSession``."""
        self._session_of = partial(
            OwnSession, self.peer, robot, mates=mates, publish=publish, kernel=self._kernel, new_id=new_id
        )
        self.own = self._session_of(self._body, start=start)
        return self.own

    def run(self, control: Control, watch: Callable[[float], None] = lambda now: None) -> None:
        """Work until told to stop; ``watch`` is called in every turn of the loop, so it must be quick."""
        try:
            while not control.stop:
                if control.kernel:
                    self._kernel.load()
                events = self._gathered(self.idle_time(time.monotonic()))
                now = time.monotonic()
                self.turn(now, events, go=control.go)
                self._report(now, control)
                watch(now)
            self._stay_until_heard(self._say_the_rest(time.monotonic()))
            self._keeper.keep_all(self.peer, self._sessions())
        finally:
            self._kernel.close()

    def _gathered(self, seconds: float) -> Iterable[Event]:
        """What comes in within that time: all of it together, for to wake up for each message would cost more than it.

        But whoever asks, or is asked, waits for no more than the first.
        """
        if self._in_exchange:
            return self._bus.receive(seconds)
        time.sleep(seconds)
        return self._bus.receive(0.0)

    def turn(self, now: float, events: Iterable[Event], *, go: bool = True) -> None:
        """One pass of the loop: take in what the bus brought, sense, and say what is to be said by now.

        Args:
            now: seconds, never less than at the turn before.
            events: what came in since then, in order.
            go: whether the body may move.
        """
        self._now = now
        self._hear(now, events)
        self._sense(now, go=go)
        self._say(now)
        self._correct(now)

    def repeat(self, told: Told) -> None:
        """Take what was said once, and say it again to all; see ``Peer.repeat``."""
        self.peer.repeat(told, self._now)

    def idle_time(self, now: float) -> float:
        """Seconds until the next turn is due, if nothing comes in before."""
        hurry = not self._body.done and math.isinf(self._speed) and self._began is not None
        return 0.0 if hurry else min(max(0.0, self.peer.wake_at - now), self._body.patience)

    def _hear(self, now: float, events: Iterable[Event]) -> None:
        for event in events:
            match event:
                case Message(sender, payload):
                    self.heard_bytes[sender] += len(payload)
                    self.peer.receive(sender, payload, now)
                case Joined(name):
                    self._around.add(name)
                    self.peer.joined(name, now)
                case Left(name):
                    self._around.discard(name)
                    self.heard_bytes.pop(name, None)
                    self.peer.left(name, now)

    def _sense(self, now: float, *, go: bool) -> None:
        done = self._body.done  # then it has seen enough; but a robot must be listened to even so
        readings = self._body.read(self._body_time(now) if go else 0.0)
        if self.own is None:
            return
        if len(readings) and not done:
            self.own.journal.append(readings)
            self.scans += len(readings)
        self._contribute(self.own)

    def _contribute(self, own: OwnSession) -> None:
        """Hand the writer what it has not had yet: of our session, or first of one that sets an earlier run right."""
        if self._earlier is not None and self._earlier.whole:
            self._earlier = None
            own.reopen()
        elif self._earlier is None and (past := self._keeper.past(self.peer, own.run)) is not None:
            self._earlier = self._session_of(NoBody(past.sensor), start=None, past=past)
        (self._earlier or own).publish()

    def _body_time(self, now: float) -> float:
        if self._began is None:
            self._began = now
        return math.inf if math.isinf(self._speed) else (now - self._began) * self._speed

    def _say(self, now: float) -> None:
        outgoing = self.peer.poll(now)
        self._keeper.keep(self.peer, self._sessions(), now)  # before anybody hears of it
        self._in_exchange = any(to is not None for to, _, _ in outgoing)
        for to, topic, payload in outgoing:
            if to is None:
                self._bus.publish(topic, payload)
            else:
                self._bus.send(to, payload)

    def _correct(self, now: float) -> None:
        if (written := self._earlier or self.own) is not None:
            written.correct(now)

    def _say_the_rest(self, now: float) -> float:
        """What was sensed is not lost with the process; gives the time by then, which runs ahead of the clock's."""
        now += self._update_period
        self.peer.flush(now)
        self._say(now)
        while self.own is not None and (left := self._unpublished()):
            self._contribute(self.own)
            if self._unpublished() == left:  # the bus takes no more
                break
            now += self._update_period
            self.peer.flush(now)
            self._say(now)
        return now

    def _stay_until_heard(self, now: float) -> None:
        """See somebody hold all that we have published, if anybody is there: of us nobody can ask for it any more."""
        for _ in range(_LAST_LOOKS):
            if self.peer.is_heard():
                break
            time.sleep(_REST)
            now = max(now, time.monotonic())  # a peer's time never goes back
            self._hear(now, self._bus.receive())
            self._say(now)

    def _unpublished(self) -> int:
        return sum(session.unpublished for session in self._sessions())

    def _sessions(self) -> list[OwnSession]:
        """Those that we write."""
        return [session for session in (self.own, self._earlier) if session is not None]

    def _report(self, now: float, control: Control) -> None:
        """Look ten times a second how far we are, and tell it if that is news."""
        if now - self._told_at < _STATUS_PERIOD:
            return
        self._told_at = now
        control.beat(now)
        status = self.status()
        if status != self._told:
            self._told = status
            control.tell("status", **status, spent=dict(self.peer.outbox.spent))  # which is no news by itself

    def status(self) -> dict[str, Any]:
        """How far we are."""
        return {
            "around": len(self._around),
            "progress": self._body.progress,
            "body": self._body.status or (self.own.status if self.own is not None else ""),
            "state": self._keeper.status,
            "done": self._body.done and all(session.settled for session in self._sessions()),
            "positions": {session.hex(): replica.state.n for session, replica in self.peer.replicas.items()},
            "apart": {
                each.descriptor.session.hex(): f"{each.descriptor.robot}: {each.reason.partition('; ')[0]}"
                for each in contributions(self.peer, self._now)
                if each.duplicate or not each.summed
            },
        }

    def summary(self) -> dict[str, Any]:
        """What every process says of itself at the end."""
        return {
            "bytes_sent": self._bus.counters["bytes_sent"],
            "spent": dict(self.peer.outbox.spent),
            "map_digest": self.peer.fusion.digest().hex(),
            "dropped": dict(self.peer.dropped) | self.lost(),
            **self._keeper.summary(),
            "contributions": [
                {
                    "robot": each.descriptor.robot,
                    "session": each.descriptor.session.hex(),
                    "updates": each.n,
                    "summed": each.summed,
                    "live": each.live,
                    "reason": each.reason,
                }
                for each in contributions(self.peer, self._now)
            ],
        }

    def lost(self) -> dict[str, int]:
        """What the bus itself had to drop, in messages by reason."""
        counters = dict(self._bus.counters)  # the bus's threads go on counting
        return {name: count for name, count in counters.items() if name.startswith("dropped_")}
