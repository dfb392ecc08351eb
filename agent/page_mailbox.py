"""Between the loop and the page: the newest snapshot one way, a word when all have seen the last one the other way."""

from __future__ import annotations

import threading

from agent.page_snapshot import Snapshot


class Mailbox:
    """Holds one snapshot; a newer one replaces it, so nobody ever waits.

    Attributes:
        newest: the newest snapshot, or None.
        last: the one after which there is no other, or None.
        visited: set when a browser has been sent something.
        seen_off: set when every browser that is there has had the last snapshot.
    """

    def __init__(self) -> None:
        self.newest: Snapshot | None = None
        self.last: Snapshot | None = None
        self.visited = threading.Event()
        self.seen_off = threading.Event()
