"""A network of peers in one process under fake time: the same seed and the same calls give the same run.

Laws kept here: time moves only by `Network.advance`; all chance comes from the seed; a payload that is cut off by a
partition is lost, also when it was on its way; presence follows what can be reached: new links are told at once, broken
ones ``lease`` seconds later at the latest.
"""

from __future__ import annotations

import heapq
import random
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import combinations, count

from transport.bus import MTU, Event, Joined, Left, Message, PeerId
from transport.queued_bus import QueuedBus


@dataclass(frozen=True, slots=True)
class Link:
    """How one direction between two peers behaves.

    Attributes:
        loss: the share of payloads that never arrive.
        duplicate: the share of payloads that arrive twice.
        delay: the least and the longest time under way, in seconds. Each payload draws its own: they overtake.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    delay: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not (0 <= self.loss <= 1 and 0 <= self.duplicate <= 1):
            raise ValueError(f"link: expected shares in 0..1, got loss {self.loss}, duplicate {self.duplicate}")
        if not 0 <= self.delay[0] <= self.delay[1]:
            raise ValueError(f"link: expected a delay (least, longest), got {self.delay}")


class Network:
    """The air between the peers. Not thread-safe: one thread drives it and all its buses.

    Attributes:
        now: fake time in seconds, from 0.
        link: how every link behaves that is not in ``links``; may be set at any time.
        links: how single directions (from, to) behave; may be changed at any time.
        counters: ``delivered``, ``duplicated``, ``lost`` (by chance) and ``cut`` (by a partition, or nobody there).

    Args:
        seed: decides every loss, duplicate and delay.
        loss: see `Link`.
        duplicate: see `Link`.
        delay: see `Link`.
        mtu: the longest payload in bytes.
        lease: how many seconds a partition or a crash stays unnoticed.
    """

    def __init__(
        self,
        seed: int,
        *,
        loss: float = 0.0,
        duplicate: float = 0.0,
        delay: tuple[float, float] = (0.0, 0.0),
        mtu: int = MTU,
        lease: float = 0.0,
    ) -> None:
        self.now = 0.0
        self.link = Link(loss=loss, duplicate=duplicate, delay=delay)
        self.links: dict[tuple[PeerId, PeerId], Link] = {}
        self.counters: Counter[str] = Counter()
        self._mtu = mtu
        self._lease = lease
        self._chance = random.Random(seed)  # noqa: S311 - it decides which packets get lost, not who gets in
        self._order = count()
        self._buses: dict[PeerId, InProcessBus] = {}
        self._islands: dict[PeerId, int] = {}  # where the partition put a peer; those not named share one more island
        self._due: list[tuple[float, int, Callable[[], None]]] = []

    def bus(self, peer: PeerId, *, max_messages: int = 10_000, max_bytes: int = 32 << 20) -> InProcessBus:
        """A new peer's access; it and those it can reach learn of each other at once.

        Raises:
            ValueError: the name is no name, or is taken.
        """
        if peer in self._buses:
            raise ValueError(f"peer: {peer!r} is on this network already")
        bus = InProcessBus(self, peer, mtu=self._mtu, max_messages=max_messages, max_bytes=max_bytes)
        self._buses[peer] = bus
        self._tell_of_links((bus, other) for other in self._others(bus))
        return bus

    def next_event(self) -> float | None:
        """When the next payload arrives or the next broken link is noticed; None if nothing is under way."""
        return self._due[0][0] if self._due else None

    def advance(self, to: float) -> None:
        """Let time pass until ``to``: what is due by then happens, in order. Readers react when this returns.

        Raises:
            ValueError: ``to`` lies in the past.
        """
        if to < self.now:
            raise ValueError(f"advance: expected {self.now} or later, got {to}")
        while self._due and self._due[0][0] <= to:
            self.now, _, happen = heapq.heappop(self._due)
            happen()
        self.now = to

    def partition(self, *islands: Collection[PeerId]) -> None:
        """Cut the network: peers hear only those on their own island. Peers not named are on one more island together.

        It replaces an earlier partition; names of peers that are not there yet count when they come.
        """
        self._islands = {peer: number for number, island in enumerate(islands) for peer in island}
        self._tell_of_links(combinations(self._buses.values(), 2))
        self._notice_broken_links_later()

    def heal(self) -> None:
        """Undo the partition."""
        self.partition()

    def crash(self, peer: PeerId) -> None:
        """Let a peer vanish without a goodbye: its bus is closed, the others notice after ``lease``.

        Raises:
            KeyError: there is no such peer.
        """
        self._buses.pop(peer).close()
        self._notice_broken_links_later()

    def publish(self, sender: InProcessBus, payload: bytes) -> None:
        """Carry a payload to every other peer (for the bus)."""
        message = Message(sender.peer, payload)
        for target in self._others(sender):
            self._carry(sender, target, message)

    def send(self, sender: InProcessBus, peer: PeerId, payload: bytes) -> None:
        """Carry a payload to one other peer (for the bus)."""
        target = self._buses.get(peer)
        if target is None:
            self.counters["cut"] += 1
        elif target is not sender:
            self._carry(sender, target, Message(sender.peer, payload))

    def leave(self, bus: InProcessBus) -> None:
        """Take a peer off the network, with a goodbye (for the bus); one that crashed is off already."""
        if self._buses.get(bus.peer) is bus:
            del self._buses[bus.peer]
            for other in [*bus.known.values()]:
                _part(bus, other)

    def _others(self, bus: InProcessBus) -> list[InProcessBus]:
        return [other for other in self._buses.values() if other is not bus]

    def _linked(self, one: InProcessBus, other: InProcessBus) -> bool:
        return (
            self._buses.get(one.peer) is one
            and self._buses.get(other.peer) is other
            and self._islands.get(one.peer) == self._islands.get(other.peer)
        )

    def _carry(self, sender: InProcessBus, target: InProcessBus, message: Message) -> None:
        link = self.links.get((sender.peer, target.peer), self.link)
        if not self._linked(sender, target):
            self.counters["cut"] += 1
        elif self._chance.random() < link.loss:
            self.counters["lost"] += 1
        else:
            self._arrive_later(link, sender, target, message)
            if self._chance.random() < link.duplicate:
                self.counters["duplicated"] += 1
                self._arrive_later(link, sender, target, message)

    def _arrive_later(self, link: Link, sender: InProcessBus, target: InProcessBus, message: Message) -> None:
        self._later(self._chance.uniform(*link.delay), partial(self._arrive, sender, target, message))

    def _arrive(self, sender: InProcessBus, target: InProcessBus, message: Message) -> None:
        if self._islands.get(sender.peer) == self._islands.get(target.peer) and self._buses.get(target.peer) is target:
            self.counters["delivered"] += 1
            target.inbox.put(message)
        else:
            self.counters["cut"] += 1

    def _later(self, delay: float, happen: Callable[[], None]) -> None:
        heapq.heappush(self._due, (self.now + delay, next(self._order), happen))

    def _tell_of_links(self, pairs: Iterable[tuple[InProcessBus, InProcessBus]]) -> None:
        for one, other in pairs:
            if one.known.get(other.peer) is not other and self._linked(one, other):
                _meet(one, other)

    def _notice_broken_links_later(self) -> None:
        if self._lease > 0:
            self._later(self._lease, self._notice_broken_links)
        else:
            self._notice_broken_links()

    def _notice_broken_links(self) -> None:
        for one in [*self._buses.values()]:
            for other in [*one.known.values()]:
                if not self._linked(one, other):
                    _part(one, other)


class InProcessBus(QueuedBus):
    """One peer's access to a `Network`, which makes it: ``network.bus("r1")``.

    `receive` never waits: what there is to come comes by `Network.advance`.

    Attributes:
        known: the peers this one was told of and not yet told to be gone.
    """

    def __init__(self, network: Network, peer: PeerId, *, mtu: int, max_messages: int, max_bytes: int) -> None:
        super().__init__(peer, mtu=mtu, max_messages=max_messages, max_bytes=max_bytes)
        self.known: dict[PeerId, InProcessBus] = {}
        self._network = network

    def receive(self, timeout: float = 0.0) -> list[Event]:
        """See `Bus.receive`; the timeout is not waited for."""
        return self.inbox.take()

    def _publish(self, topic: str, payload: bytes) -> None:
        self._network.publish(self, bytes(payload))

    def _send(self, peer: PeerId, payload: bytes) -> None:
        self._network.send(self, peer, bytes(payload))

    def _close(self) -> None:
        self._network.leave(self)


def _meet(one: InProcessBus, other: InProcessBus) -> None:
    """Tell both of each other; of one that is back before it was missed, first that it was gone."""
    for here, there in ((one, other), (other, one)):
        if there.peer in here.known:
            here.inbox.put(Left(there.peer))
        here.known[there.peer] = there
        here.inbox.put(Joined(there.peer))


def _part(one: InProcessBus, other: InProcessBus) -> None:
    """Tell each that the other is gone, if it still knows it."""
    for here, there in ((one, other), (other, one)):
        if here.known.get(there.peer) is there:
            del here.known[there.peer]
            here.inbox.put(Left(there.peer))
