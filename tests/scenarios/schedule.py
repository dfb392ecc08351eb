"""A schedule: all that happens to one swarm, as a plain value that can be printed, shrunk and run again."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.scenarios.arena import Arena
from tests.scenarios.events import Event
from tests.scenarios.laws import Broken

REST = 1.0
"""Seconds that a swarm must stay in agreement once it is."""


@dataclass(frozen=True)
class Schedule:
    """A network and the events in it.

    Attributes:
        seed: decides what the network loses, duplicates and delays, and the sessions' ids.
        events: what happens, in any order.
        loss: see `transport.in_process.Link`; so it stays until the end, unless events change it.
        duplicate: as above.
        delay: as above.
        mtu: the longest payload.
        lease: seconds until a broken link is noticed.
        radio: what the network carries (`swarm.radio.PROFILES`).
        limit: seconds within which all must agree once the last event is over.
    """

    seed: int
    events: tuple[Event, ...]
    loss: float = 0.0
    duplicate: float = 0.0
    delay: tuple[float, float] = (0.0002, 0.001)
    mtu: int = 65536
    lease: float = 0.0
    radio: str = "lan"
    limit: float = 900.0

    def __str__(self) -> str:
        options = [
            f"{each.name}={getattr(self, each.name)!r}"
            for each in fields(self)
            if each.name not in {"seed", "events"} and getattr(self, each.name) != each.default
        ]
        events = "".join(f"\n        {event!r}," for event in sorted(self.events, key=lambda event: event.at))
        return "\n    ".join([f"Schedule({self.seed}, ({events}", *[f"), {', '.join(options)})"]])


@dataclass(frozen=True)
class Outcome:
    """How a schedule ended well.

    Attributes:
        settled: simulated seconds from the last event until all agreed.
        lasted: simulated seconds in all.
        sent_bytes: what all peers gave to the network, by topic.
        network: what became of the payloads.
        dropped: what peers dropped, by reason.
        events: how many of each kind there were.
    """

    settled: float
    lasted: float
    sent_bytes: Counter[str]
    network: Counter[str]
    dropped: Counter[str]
    events: Counter[str]


def run(schedule: Schedule) -> Outcome:
    """Let it all happen, and see all agree.

    Raises:
        Broken: a law does not hold.
    """
    with TemporaryDirectory(prefix="orion-", dir=_MEMORY if _MEMORY.is_dir() else None) as folder:
        return _run(schedule, Arena(schedule, Path(folder)))


_MEMORY = Path("/dev/shm")
"""Where state files cost little."""


def _run(schedule: Schedule, arena: Arena) -> Outcome:
    try:
        for event in sorted(schedule.events, key=lambda event: event.at):
            arena.run_until(event.at)
            event.happen(arena)
        arena.heal()
        settled = arena.settle(schedule.limit)
        arena.check()
        arena.run_until(arena.network.now + REST)
        arena.settle(0.0)
        arena.check()
    except Broken:
        raise
    except Exception as error:
        raise Broken("no peer fails", f"{type(error).__name__}: {error}") from error
    finally:
        arena.close()
    peers = [process.peer for process in arena.processes.values()]
    return Outcome(
        settled,
        arena.network.now,
        sum((peer.sent_bytes for peer in peers), Counter()),
        arena.network.counters,
        sum((peer.dropped for peer in peers), Counter()),
        Counter(type(event).__name__ for event in schedule.events),
    )
