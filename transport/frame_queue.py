"""The bounded queue between a thread that works a wire and the thread that owns what is said there.

Laws kept here: putting never waits for the reader; what is taken comes in the order in which it was put; when there is
no room, the oldest goes and is counted. So the newest is always there, and with it how things stand.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class FrameQueue(Generic[Item]):
    """Items from one thread, for another.

    Args:
        counters: where ``dropped_queue_full`` is counted.
        max_items: how many items wait at most.
    """

    def __init__(self, counters: Counter[str], *, max_items: int) -> None:
        self._counters = counters
        self._something = threading.Condition()
        self._waiting: deque[Item] = deque(maxlen=max_items)
        self._closed = False

    def put(self, item: Item) -> None:
        """Queue the item. After `close` nothing happens."""
        with self._something:
            if self._closed:
                return
            if len(self._waiting) == self._waiting.maxlen:
                self._counters["dropped_queue_full"] += 1
            self._waiting.append(item)
            self._something.notify()

    def take(self, timeout: float = 0.0) -> list[Item]:
        """Everything that waits, oldest first; waits up to ``timeout`` seconds for the first item."""
        with self._something:
            self._something.wait_for(lambda: self._waiting or self._closed, timeout)
            items = list(self._waiting)
            self._waiting.clear()
            return items

    def close(self) -> None:
        """Forget what waits, take nothing more, and wake the reader."""
        with self._something:
            self._closed = True
            self._waiting.clear()
            self._something.notify_all()
