"""The page's server at the end of a run: whoever looks has the last of it, however late or slow he is."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import msgpack
import pytest

from agent.overview import Overview
from agent.page_feed import Feed
from agent.page_mailbox import Mailbox
from agent.page_orders import Orders
from agent.page_server import _Pages
from agent.page_snapshot import Snapshot, Snapshots


class Socket:
    """A browser's end of the live socket.

    Args:
        taking: called while it takes a frame.
    """

    def __init__(self, taking: Callable[[], None]) -> None:
        self.frames: list[dict] = []
        self.closed = False
        self._taking = taking

    async def accept(self) -> None:
        pass

    async def send_bytes(self, frame: bytes) -> None:
        self.frames.append(msgpack.unpackb(frame))
        self._taking()

    async def receive(self) -> dict:
        await asyncio.Event().wait()  # it says nothing
        raise AssertionError

    async def close(self, code: int, reason: str) -> None:
        self.closed = True


@pytest.fixture
def snapshot(watched, straight) -> Snapshot:
    """A map of one robot."""
    watched.robot("r1")
    watched.sense("r1", straight(20))
    return Snapshots(watched.observer, watched.tracks, watched.heard).take(watched.now)


def test_a_swarm_that_ends_while_a_frame_is_under_way_says_so_in_the_last_one(snapshot) -> None:
    feed = Feed(Overview("lab", []))
    feed.take(snapshot)
    socket = Socket(lambda: None if feed.ended else feed.end(snapshot))
    asyncio.run(_Pages(feed, Mailbox(), Orders())._send(socket, feed.join()))
    assert socket.closed
    assert [frame.get("ended", False) for frame in socket.frames] == [False, True]
    assert socket.frames[-1]["state"]["ended"]


def test_a_browser_that_comes_after_the_end_is_seen_off_too(snapshot) -> None:
    mailbox = Mailbox()
    mailbox.last = snapshot
    pages = _Pages(Feed(Overview("lab", [])), mailbox, Orders())
    seen_off: list[bool] = []
    socket = Socket(lambda: seen_off.append(mailbox.seen_off.is_set()))

    async def come_late() -> None:
        await pages._look()
        assert mailbox.seen_off.is_set()  # nobody is there
        await pages.live(socket)

    asyncio.run(come_late())
    assert socket.frames[-1]["ended"]
    assert seen_off
    assert not any(seen_off)
    assert mailbox.seen_off.is_set()
