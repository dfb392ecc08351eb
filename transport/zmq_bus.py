"""The bus over ZeroMQ: a ROUTER for those who connect to us, a DEALER for each whom we connect to, heartbeats.

Laws kept here: a link carries both ways, so of each pair of peers one connects; one thread owns the sockets, and the
publisher only puts into its queue; a peer is there while its heartbeats come and its link takes ours; nothing waits for
a link that is down or full, what it does not take is dropped and counted; a message is one frame, for ZeroMQ aborts the
process when a link breaks between two.

What is said on a link: `transport.zmq_frames`.
"""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
import weakref
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import zmq
from zmq.utils.monitor import recv_monitor_message

from transport.bus import MTU, BusError, Joined, Left, Message, PeerId, checked_name
from transport.frame_queue import FrameQueue
from transport.inbox import Inbox
from transport.queued_bus import QueuedBus
from transport.zmq_frames import Alive, Gone, Refused, say_alive, say_gone, say_to_all, say_to_one, understand

_HEARTBEAT = 0.5
"""Seconds between two heartbeats: a link that is gone is noticed by the next one."""

_LEASE = 6.0
"""Seconds after which a peer that says nothing is gone. At 20 kbit/s words take seconds, and a peer that seems to come
and go is told everything again and again (with 2 s Zenoh's swarms never agreed there)."""

_LINGER = 1.0
"""Seconds that closing waits at most for last words to leave."""

_HIGH_WATER = 1_000
"""Messages that wait in our queue, and at either end of each link."""

_BATCH = 200
"""Messages taken from one socket before the others, and what we have to say, get their turn."""

_SETTINGS = {
    zmq.SocketOption.SNDHWM: _HIGH_WATER,
    zmq.SocketOption.RCVHWM: _HIGH_WATER,
    zmq.SocketOption.RECONNECT_IVL: 250,  # ms; who is not there is tried again and again,
    zmq.SocketOption.RECONNECT_IVL_MAX: 2_000,
    zmq.SocketOption.CONNECT_TIMEOUT: 2_000,  # also behind a cable that is pulled, where nobody refuses
    zmq.SocketOption.HANDSHAKE_IVL: 5_000,
    zmq.SocketOption.HEARTBEAT_IVL: 2_000,  # ZeroMQ's own, by which it gives up a dead link and makes it again;
    zmq.SocketOption.HEARTBEAT_TIMEOUT: int(_LEASE * 1000),
}


class _Link(NamedTuple):
    """A way to one other peer: a DEALER, or a ROUTER and its name for the connection."""

    socket: zmq.Socket[bytes]
    address: bytes = b""

    def take(self, frame: bytes) -> bool:
        """Give it something; False if it is full, or known to be gone."""
        try:
            self.socket.send_multipart([self.address, frame] if self.address else [frame], zmq.DONTWAIT)
        except zmq.ZMQError as error:
            if error.errno in {zmq.EAGAIN, zmq.EHOSTUNREACH}:
                return False
            raise
        return True


class _Saying(NamedTuple):
    """A frame for everybody, or for one."""

    to: PeerId | None
    frame: bytes


class ZmqBus(QueuedBus):
    """One peer's access to a swarm over ZeroMQ. Opening takes milliseconds, whoever is there or not.

    Peers hear those they are linked to: who connects where is the roster's to say (`transport.roster`). Links that
    break are made again. Use it in a ``with`` statement, or close it: one that is forgotten is closed when it is
    collected or the interpreter exits.

    Args:
        swarm: the swarm's name; peers of other swarms on the same ports are neither heard nor seen.
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
        self._swarm = checked_name("swarm", swarm)
        self._wire = _Wire(swarm, peer, mtu, self.inbox, self.counters)
        self._shut = weakref.finalize(self, self._wire.close)
        try:
            self._wire.open(listen, connect)
        except BusError:
            self.close()
            raise

    def _publish(self, topic: str, payload: bytes) -> None:
        self._wire.say(_Saying(None, say_to_all(self._swarm, self.peer, topic, payload)))

    def _send(self, peer: PeerId, payload: bytes) -> None:
        self._wire.say(_Saying(peer, say_to_one(self._swarm, self.peer, peer, payload)))

    def _close(self) -> None:
        self._shut()


class _Peer:
    """Who is at the other end of a link, and when it was last heard."""

    def __init__(self, link: _Link, heard_at: float) -> None:
        self.link = link
        self.heard_at = heard_at


class _Wire:
    """The sockets, and the thread that owns them from `open` to `close`. It does not hold the bus."""

    def __init__(self, swarm: str, own: PeerId, mtu: int, inbox: Inbox, counters: Counter[str]) -> None:
        self._swarm = swarm
        self._own = own
        self._mtu = mtu
        self._inbox = inbox
        self._counters = counters
        self._alive = say_alive(swarm, own)
        self._peers: dict[PeerId, _Peer] = {}
        self._monitors: dict[zmq.Socket[bytes], zmq.Socket[bytes]] = {}  # of each DEALER
        self._up: set[_Link] = set()  # the DEALERs that are connected
        self._beat_at = time.monotonic()
        self._context = zmq.Context()
        self._poller = zmq.Poller()
        self._sayings: FrameQueue[_Saying] = FrameQueue(counters, max_items=_HIGH_WATER)
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._poller.register(self._woken, zmq.POLLIN)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"{own} wire", daemon=True)

    def open(self, listen: Sequence[str], connect: Sequence[str]) -> None:
        """Listen, begin to connect, and start the thread.

        Raises:
            BusError: an endpoint cannot be used.
        """
        if listen:
            router = self._socket(zmq.ROUTER, listen)
            router.setsockopt(zmq.ROUTER_MANDATORY, 1)  # tells us that a link is gone
            self._poller.register(router, zmq.POLLIN)
            for endpoint in listen:
                _use(router.bind, endpoint)
        for endpoint in connect:
            dealer = self._socket(zmq.DEALER, [endpoint])
            self._monitors[dealer] = dealer.get_monitor_socket(zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED)
            self._poller.register(self._monitors[dealer], zmq.POLLIN)
            self._poller.register(dealer, zmq.POLLIN)
            _use(dealer.connect, endpoint)
        self._thread.start()

    def say(self, saying: _Saying) -> None:
        """Let the thread say something."""
        self._sayings.put(saying)
        self._nudge()

    def close(self) -> None:
        """Say what waits to be said, and leave. Bounded in time."""
        self._closing = True
        if self._thread.ident is None:
            self._context.destroy(linger=0)
        else:
            self._nudge()
            self._thread.join(2 * _LINGER)
        self._wake.close()
        self._woken.close()

    def _socket(self, kind: int, endpoints: Sequence[str]) -> zmq.Socket[bytes]:
        made = self._context.socket(kind)
        for option, value in _SETTINGS.items():
            made.setsockopt(option, value)
        made.setsockopt(zmq.IPV6, any("[" in endpoint for endpoint in endpoints))  # a name means its IPv4 address
        made.setsockopt(zmq.MAXMSGSIZE, max(1 << 20, 2 * self._mtu))  # who sends longer ones loses the link
        return made

    def _nudge(self) -> None:
        with contextlib.suppress(OSError):  # it is full, and so the thread awake; or closed, and so the thread gone
            self._wake.send(b".")

    # --- in the thread

    def _run(self) -> None:
        try:
            while not self._closing:
                self._turn()
            self._speak()
            for peer in self._peers.values():
                peer.link.take(say_gone(self._swarm, self._own))
        finally:
            self._context.destroy(linger=int(_LINGER * 1000))

    def _turn(self) -> None:
        ready = {source for source, _ in self._poller.poll(self._idle_ms())}
        if self._woken.fileno() in ready:
            self._woken.recv(4_096)
        for dealer, monitor in self._monitors.items():
            if monitor in ready or dealer in ready:  # first how the link is, then what it brings
                self._watch(_Link(dealer), monitor)
        for source in ready - {*self._monitors.values(), self._woken.fileno()}:
            self._hear(source)
        self._speak()
        self._beat()

    def _watch(self, link: _Link, monitor: zmq.Socket[bytes]) -> None:
        """Note that a DEALER was connected, or no longer is."""
        with contextlib.suppress(zmq.Again):
            while True:
                if recv_monitor_message(monitor, zmq.DONTWAIT)["event"] == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                    self._up.add(link)
                    link.take(self._alive)
                else:
                    self._up.discard(link)
                    self._lose([name for name, peer in self._peers.items() if peer.link == link])

    def _idle_ms(self) -> int:
        return max(0, math.ceil((self._beat_at - time.monotonic()) * 1000))

    def _speak(self) -> None:
        for saying in self._sayings.take():
            listeners = [*self._peers] if saying.to is None else [saying.to]
            for listener in listeners:
                peer = self._peers.get(listener)
                if peer is not None and not peer.link.take(saying.frame):
                    self._counters["dropped_link_full"] += 1

    def _hear(self, source: zmq.Socket[bytes]) -> None:
        for _ in range(_BATCH):
            try:
                frames = source.recv_multipart(zmq.DONTWAIT)
            except zmq.Again:
                return
            link = _Link(source, frames.pop(0)) if source.type == zmq.ROUTER else _Link(source)
            self._take(understand(frames, self._swarm, self._own, self._mtu), link)

    def _take(self, said: Alive | Gone | Message | Refused, link: _Link) -> None:
        if isinstance(said, Refused):
            self._inbox.refuse(said.reason)
            return
        peer = self._peers.get(said.sender)
        known = peer is not None and peer.link == link
        if peer is not None and known:
            peer.heard_at = time.monotonic()
        match said:
            case Message():
                self._inbox.put(said)
            case Gone() if known:
                self._lose([said.sender])
            case Alive() if not known and self._greet(link):
                self._meet(said.sender, link)

    def _meet(self, sender: PeerId, link: _Link) -> None:
        """A peer greets on a link which took our greeting: whoever it was that had its name or link is gone."""
        self._lose([name for name, peer in self._peers.items() if name == sender or peer.link == link])
        self._peers[sender] = _Peer(link, time.monotonic())
        self._inbox.put(Joined(sender))

    def _beat(self) -> None:
        """Greet everybody when it is time; who cannot be greeted or has long been silent is gone."""
        now = time.monotonic()
        if now < self._beat_at:
            return
        self._beat_at = now + _HEARTBEAT
        reached = {link for link in self._up.union(peer.link for peer in self._peers.values()) if self._greet(link)}
        self._lose(
            [name for name, peer in self._peers.items() if peer.link not in reached or now - peer.heard_at > _LEASE]
        )

    def _greet(self, link: _Link) -> bool:
        """Tell whoever is there that we are; a DEALER that is down would keep it for whoever comes."""
        return (bool(link.address) or link in self._up) and link.take(self._alive)

    def _lose(self, names: Sequence[PeerId]) -> None:
        for name in names:
            del self._peers[name]
            self._inbox.put(Left(name))


def _use(use: Callable[[str], object], endpoint: str) -> None:
    """Bind or connect to an endpoint as we write them, ``tcp/127.0.0.1:7450``."""
    try:
        use(endpoint.replace("/", "://", 1))
    except zmq.ZMQError as error:
        raise BusError(zmq.strerror(error.errno or 0), endpoint) from error
