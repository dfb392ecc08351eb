"""The bus over Zenoh: peers connect to each other directly, without a broker, and liveliness tells who is there.

Laws kept here: nothing is listened on or connected to but the endpoints given (and the peers those tell of); Zenoh's
threads never enter Python, ours only put into the inbox; a stalled peer costs a publisher a millisecond, then its copy
is dropped by Zenoh, uncounted; the session is closed however the process ends.

Keys: ``orion/<swarm>/<peer>/<topic>`` to all, ``orion/<swarm>/<peer>/to/<other>`` to one, the liveliness token
``orion/<swarm>/<peer>/alive``, and ``orion/<swarm>/<peer>/<topic>/**`` for what anybody may ``get``.
"""

from __future__ import annotations

import contextlib
import json
import threading
import weakref
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import zenoh
from zenoh.handlers import FifoChannel, RingChannel

from transport.bus import MTU, Answers, BusError, Joined, Left, Message, PeerId, checked_name, is_name
from transport.inbox import Inbox
from transport.queued_bus import QueuedBus

_SETTINGS: dict[str, object] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,  # one group for the whole network: strangers and parallel tests would meet
    "scouting/gossip/enabled": True,
    "scouting/gossip/autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
    "connect/timeout_ms": -1,  # opening waits for nobody; who is not there is tried again and again,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 250, "period_max_ms": 2_000, "period_increase_factor": 2},
    "open/return_conditions": {"connect_scouted": False, "declares": False},  # and Joined tells who has come
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
    "transport/link/tx/lease": 6_000,  # a pulled cable is noticed after this many ms; at 20 kbit/s words take seconds
    "transport/unicast/lowlatency": False,  # it loses long messages without a word
    "transport/shared_memory/enabled": False,  # it leaves files behind when a process is killed
}

_T = TypeVar("_T")

_WAITING = 1_024
"""Samples between Zenoh's thread and ours; it is full only while something else holds the interpreter for long."""

_QUESTIONS = 16
"""Questions that wait for an answer; the oldest is given up for a new one."""


class ZenohBus(QueuedBus):
    """One peer's access to a swarm over Zenoh. Opening takes milliseconds, whoever is there or not.

    Peers hear those they are linked to; nobody relays. A link given by an endpoint in ``connect`` is made again when it
    breaks, one found through a third peer is not: see `transport.roster`. Use it in a ``with`` statement, or close
    it: one that is forgotten is closed when it is collected or the interpreter exits. Never fork with one open.

    Args:
        swarm: the swarm's name; peers of other swarms on the same network are neither heard nor seen.
        peer: the own name, which no other running peer bears.
        listen: endpoints to listen on, such as ``tcp/127.0.0.1:7450``; none listens on nothing.
        connect: endpoints to connect to; those that are dead, or die, are retried in the background for ever.
        mtu: the longest payload in bytes; longer ones that come in are dropped as ``dropped_too_long``.
        max_messages: how many messages the inbox holds at most.
        max_bytes: how many bytes of payload the inbox holds at most.

    Raises:
        BusError: an endpoint is occupied, foreign or malformed.
        ValueError: a name is no name.
    """

    def __init__(
        self,
        swarm: str,
        peer: PeerId,
        *,
        listen: Sequence[str],
        connect: Sequence[str],
        mtu: int = MTU,
        max_messages: int = 10_000,
        max_bytes: int = 32 << 20,
    ) -> None:
        super().__init__(peer, mtu=mtu, max_messages=max_messages, max_bytes=max_bytes)
        self._prefix = f"orion/{checked_name('swarm', swarm)}"
        self._session = _open_session(listen, connect, mtu)
        self._pumps: list[threading.Thread] = []
        self._shut = weakref.finalize(self, _shut, self._session, self._pumps)
        self._publishers: dict[str, zenoh.Publisher] = {}
        try:
            self._subscribe()
        except zenoh.ZError as error:
            self.close()
            raise BusError(_reason(error), f"{self._prefix}/{peer}") from error

    def _subscribe(self) -> None:
        """Listen first and show up last: who sees our token has our subscriptions already."""
        everything, here = f"{self._prefix}/*/*", f"{self._prefix}/*/to/{self.peer}"
        for key in (everything, here):
            subscriber = self._session.declare_subscriber(
                key, FifoChannel(_WAITING), allowed_origin=zenoh.Locality.REMOTE
            )
            self._pump(subscriber, _hearing(self.inbox, self.peer, self.mtu))
        liveliness = self._session.liveliness()
        alive = liveliness.declare_subscriber(f"{self._prefix}/*/alive", FifoChannel(_WAITING), history=True)
        self._pump(alive, _seeing(self.inbox, self.peer))
        self._token = liveliness.declare_token(f"{self._prefix}/{self.peer}/alive")

    def serve(self, topic: str, answers: Answers) -> None:
        """See `Bus.serve`."""
        prefix = f"{self._prefix}/{self.peer}/{checked_name('topic', topic)}"
        questions = self._session.declare_queryable(f"{prefix}/**", RingChannel(_QUESTIONS))
        self._pump(questions, _answering(prefix, answers))

    def _pump(self, source: Iterable[_T], handle: Callable[[_T], None]) -> None:
        """Carry what comes in to whoever handles it until the session closes.

        A thread of our own, because a callback costs more: on Zenoh's thread it waits for the interpreter once a
        sample (a busy reader then gets 200 a second), on the thread Zenoh makes for it the process never ends.
        """
        pump = threading.Thread(target=_carry, args=(source, handle), name=f"{self.peer} pump", daemon=True)
        self._pumps.append(pump)
        pump.start()

    def _publish(self, topic: str, payload: bytes) -> None:
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = self._session.declare_publisher(
                f"{self._prefix}/{self.peer}/{topic}",
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,
            )
        publisher.put(payload)

    def _send(self, peer: PeerId, payload: bytes) -> None:
        self._session.put(
            f"{self._prefix}/{self.peer}/to/{peer}",
            payload,
            congestion_control=zenoh.CongestionControl.DROP,
            allowed_destination=zenoh.Locality.REMOTE,
        )

    def _close(self) -> None:
        self._shut()


def _open_session(listen: Sequence[str], connect: Sequence[str], mtu: int) -> zenoh.Session:
    settings = _SETTINGS | {
        "listen/endpoints": [*listen],
        "connect/endpoints": [*connect],
        # What Zenoh puts together from fragments before we see it; a longer one it drops. The default is 1 GiB.
        "transport/link/rx/max_message_size": max(1 << 20, 2 * mtu),
    }
    config = zenoh.Config()
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(_reason(error), ", ".join([*listen, *connect])) from error


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's message without the places in its sources."""
    return str(error).split(" at /")[0]


def _shut(session: zenoh.Session, pumps: Sequence[threading.Thread]) -> None:
    """Close the session and see the pumps out: no thread may be left to wake up in a dying interpreter."""
    with contextlib.suppress(zenoh.ZError):  # it gives up after 10 s on a neighbour that accepts and never answers
        session.close()  # type: ignore[no-untyped-call]
    for pump in pumps:
        if pump is not threading.current_thread():  # the garbage collector may call from anywhere
            pump.join(timeout=1.0)


def _carry(source: Iterable[_T], handle: Callable[[_T], None]) -> None:
    for each in source:
        handle(each)


def _hearing(inbox: Inbox, own: PeerId, mtu: int) -> Callable[[zenoh.Sample], None]:
    def hear(sample: zenoh.Sample) -> None:
        sender = _peer_of(sample)
        if sample.kind != zenoh.SampleKind.PUT:
            inbox.refuse("not_a_put")
        elif not is_name(sender):
            inbox.refuse("bad_name")
        elif sender == own:
            inbox.refuse("own_name")
        elif len(sample.payload) > mtu:
            inbox.refuse("too_long")
        else:
            inbox.put(Message(sender, sample.payload.to_bytes()))

    return hear


def _seeing(inbox: Inbox, own: PeerId) -> Callable[[zenoh.Sample], None]:
    def see(sample: zenoh.Sample) -> None:
        peer = _peer_of(sample)
        if peer == own:
            return
        if not is_name(peer):
            inbox.refuse("bad_name")
        elif sample.kind == zenoh.SampleKind.PUT:
            inbox.put(Joined(peer))
        else:
            inbox.put(Left(peer))

    return see


def _answering(prefix: str, answers: Answers) -> Callable[[zenoh.Query], None]:
    def answer(query: zenoh.Query) -> None:
        with query, contextlib.suppress(zenoh.ZError):  # who asked is gone, or we are
            for name, value in answers():
                key = zenoh.KeyExpr(f"{prefix}/{name}")
                if query.key_expr.intersects(key):
                    query.reply(key, value)

    return answer


def _peer_of(sample: zenoh.Sample) -> PeerId:
    return str(sample.key_expr).split("/")[2]
