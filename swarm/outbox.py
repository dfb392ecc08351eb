"""What waits to be sent, and when it may be: a token bucket between a peer and its bus.

Laws kept here: over any time the peer uses no more than its share of the channel, a short burst and one payload
excepted; own updates go first, yet when other things wait they get every second turn; what waits already is not queued
again, and what several peers asked for is said to all at once where that is cheaper; nothing but own updates, which
the writer holds back, can make the queue grow beyond its bound.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from swarm.radio import Profile

_NEVER = float("inf")
_ROUNDING = 1.0  # bytes; a wake-up time is a float, and a bucket that lacks a millionth of a byte at it would spin


class Lane(Enum):
    """The classes of traffic, the most urgent first."""

    UPDATES = "updates"
    CONTROL = "control"
    DIGESTS = "digests"
    REQUESTS = "requests"
    ANSWERS = "answers"


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


@dataclass(slots=True)
class _Waiting:
    topic: str
    receivers: dict[str, None] | None  # in order of asking; None: all


class Outbox:
    """One peer's queue.

    Attributes:
        sent_bytes: payload bytes given to the bus, by topic.
        spent: the same by class (``Lane``'s values).
        refused: payloads for which there was no room.
    """

    def __init__(self, profile: Profile, now: float) -> None:
        self.sent_bytes: Counter[str] = Counter()
        self.spent: Counter[str] = Counter()
        self.refused = 0
        self._profile = profile
        self._others = 0
        self._lanes: dict[Lane, dict[bytes, _Waiting]] = {lane: {} for lane in Lane}
        self._bytes: Counter[Lane] = Counter()
        self._last = Lane.ANSWERS
        self._filled_at = now
        self._tokens = self._depth

    # --- who is there

    def among(self, others: int, now: float) -> None:
        """So many others are there now: it decides our share."""
        self._fill(now)
        self._others = others

    def forget(self, peer: str) -> None:
        """A peer is gone: what waits for it alone is needless."""
        for lane, queue in self._lanes.items():
            for payload, waiting in list(queue.items()):
                if waiting.receivers is not None:
                    waiting.receivers.pop(peer, None)
                    if not waiting.receivers:
                        self._remove(lane, payload)

    # --- what waits

    def put(self, lane: Lane, topic: str, payloads: Iterable[bytes], to: str | None = None) -> bool:
        """Queue the payloads of one message.

        Returns:
            Whether it is of use to queue more of the same kind: no if there is no room, or if this waits already.
        """
        queue = self._lanes[lane]
        new = False
        for payload in payloads:
            waiting = queue.get(payload)
            if waiting is None:
                if lane is not Lane.UPDATES and self._bytes[lane] + len(payload) > self._profile.queue:
                    self.refused += 1
                    return False
                queue[payload] = _Waiting(topic, None if to is None else {to: None})
                self._bytes[lane] += len(payload)
                new = True
            elif to is None and waiting.receivers is not None:
                waiting.receivers = None
                new = True
            elif to is not None and waiting.receivers is not None and to not in waiting.receivers:
                waiting.receivers[to] = None
                new = True
        return new

    def clear(self, lane: Lane) -> bool:
        """Whether nothing of that class waits."""
        return not self._lanes[lane]

    def _remove(self, lane: Lane, payload: bytes) -> _Waiting:
        self._bytes[lane] -= len(payload)
        return self._lanes[lane].pop(payload)

    # --- the bucket

    @property
    def _depth(self) -> float:
        return self._profile.share(self._others) * self._profile.burst

    def _fill(self, now: float) -> None:
        gained = (now - self._filled_at) * self._profile.share(self._others)
        self._tokens = min(self._depth, self._tokens + gained)
        self._filled_at = now

    @property
    def open_at(self) -> float:
        """When the next payload may be sent: as soon as what was sent before is paid for."""
        return self._filled_at + max(0.0, -self._tokens) / self._profile.share(self._others)

    @property
    def wake_at(self) -> float:
        """When ``take`` has something to give."""
        return self.open_at if any(self._lanes.values()) else _NEVER

    def ready(self, now: float) -> bool:
        """Whether an own update would go out at once. If not, better wait and let it carry more."""
        self._fill(now)
        return self._tokens > -_ROUNDING and self.clear(Lane.UPDATES)

    def take(self, now: float) -> list[Outgoing]:
        """What may be sent now, in order."""
        self._fill(now)
        out: list[Outgoing] = []
        while self._tokens > -_ROUNDING and (lane := self._next()) is not None:
            self._last = lane
            payload = next(iter(self._lanes[lane]))
            waiting = self._remove(lane, payload)
            for to in self._addresses(len(payload), waiting.receivers):
                self._tokens -= self._profile.cost(len(payload), self._others, to_all=to is None)
                self.sent_bytes[waiting.topic] += len(payload)
                self.spent[lane.value] += len(payload)
                out.append(Outgoing(to, waiting.topic, payload))
        return out

    def _next(self) -> Lane | None:
        waiting = [lane for lane, queue in self._lanes.items() if queue]
        if not waiting:
            return None
        turn = waiting[0] is self._last is Lane.UPDATES and len(waiting) > 1
        return waiting[1] if turn else waiting[0]

    def _addresses(self, size: int, receivers: dict[str, None] | None) -> list[str | None]:
        """To each who asked, or to all at once if that costs no more."""
        if receivers is None or (
            len(receivers) > 1 and (self._profile.cost(size, self._others, to_all=True) <= len(receivers) * size)
        ):
            return [None]
        return list(receivers)
