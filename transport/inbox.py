"""The one bounded queue between the threads that bring bytes and the thread that owns the peer's state.

Laws kept here: putting never waits for the reader; when there is no room, the oldest message goes and is counted;
presence is never dropped; what is taken comes in the order in which it was put.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from itertools import count

from transport.bus import Event, Message


class Inbox:
    """Events from any number of threads, for one reader.

    Args:
        counters: the bus's counters; the inbox keeps ``received``, ``bytes_received`` and ``dropped_<reason>`` in it.
        max_messages: how many messages wait at most.
        max_bytes: how many bytes of payload wait at most.
    """

    def __init__(self, counters: Counter[str], *, max_messages: int = 10_000, max_bytes: int = 32 << 20) -> None:
        self._counters = counters
        self._max_messages = max_messages
        self._max_bytes = max_bytes
        self._something = threading.Condition()
        self._order = count()
        self._messages: deque[tuple[int, Message]] = deque()
        self._presence: deque[tuple[int, Event]] = deque()
        self._bytes = 0
        self._closed = False

    def put(self, event: Event) -> None:
        """Queue the event; a message may push out older ones. After `close` nothing happens."""
        with self._something:
            if self._closed:
                return
            if isinstance(event, Message):
                self._put_message(event)
            else:
                self._presence.append((next(self._order), event))
            self._something.notify()

    def refuse(self, reason: str) -> None:
        """Count a message that came in but is not worth queueing, under ``dropped_<reason>``."""
        with self._something:
            self._counters[f"dropped_{reason}"] += 1

    def take(self, timeout: float = 0.0) -> list[Event]:
        """Everything that waits, oldest first; waits up to ``timeout`` seconds for the first event."""
        with self._something:
            self._something.wait_for(lambda: self._messages or self._presence or self._closed, timeout)
            waiting = sorted([*self._presence, *self._messages], key=lambda numbered: numbered[0])
            self._clear()
            return [event for _, event in waiting]

    def close(self) -> None:
        """Forget what waits, take nothing more, and wake the reader."""
        with self._something:
            self._closed = True
            self._clear()
            self._something.notify_all()

    def _put_message(self, message: Message) -> None:
        self._counters["received"] += 1
        self._counters["bytes_received"] += len(message.payload)
        self._messages.append((next(self._order), message))
        self._bytes += len(message.payload)
        while len(self._messages) > self._max_messages or self._bytes > self._max_bytes:
            _, oldest = self._messages.popleft()
            self._bytes -= len(oldest.payload)
            self._counters["dropped_inbox_full"] += 1

    def _clear(self) -> None:
        self._messages.clear()
        self._presence.clear()
        self._bytes = 0
