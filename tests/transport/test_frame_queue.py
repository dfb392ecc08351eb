"""The queue between a line's thread and the robot's."""

from __future__ import annotations

import threading
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from transport.frame_queue import FrameQueue


@given(st.lists(st.integers(), max_size=50), st.integers(1, 20))
def test_the_newest_stay_in_their_order_and_the_others_are_counted(items, room):
    counters: Counter[str] = Counter()
    queue: FrameQueue[int] = FrameQueue(counters, max_items=room)
    for item in items:
        queue.put(item)
    assert queue.take() == items[-room:]
    assert counters["dropped_queue_full"] == max(0, len(items) - room)
    assert queue.take() == []


def test_take_waits_for_the_first():
    queue: FrameQueue[int] = FrameQueue(Counter(), max_items=3)
    putting = threading.Timer(0.02, queue.put, [1])
    putting.start()
    assert queue.take(15.0) == [1]
    putting.join()


def test_close_wakes_who_waits_and_nothing_comes_after():
    queue: FrameQueue[int] = FrameQueue(Counter(), max_items=3)
    queue.put(1)
    queue.close()
    queue.put(2)
    assert queue.take(15.0) == []
