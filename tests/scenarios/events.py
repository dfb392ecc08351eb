"""What can happen to a swarm: each kind of event is one small class with the time at which it happens.

Laws kept here: an event is a plain value whose ``repr`` makes it again; whatever is not there to happen to (a peer that
has crashed, say) makes it nothing, so that any subset of a schedule is a schedule.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Literal, Protocol

from swarm.writer import Publish
from tests.scenarios import oracle
from tests.scenarios.arena import Arena, Role
from tests.scenarios.damage import Damage, is_a_lie, mutated
from transport.in_process import Link


class Event(Protocol):
    """Something that happens ``at`` seconds."""

    @property
    def at(self) -> float: ...

    def happen(self, arena: Arena) -> None: ...


@dataclass(frozen=True)
class Join:
    """A process starts: a robot's (``robot`` is its id) or an observer's; ``start`` is one of ``oracle.STARTS``."""

    at: float
    who: str
    robot: str | None = None
    start: int | None = 0
    publish: Publish = "auto"
    remembers: bool = False

    def happen(self, arena: Arena) -> None:
        start = None if self.start is None else oracle.STARTS[self.start]
        arena.join(self.who, Role(self.robot, start, self.publish, self.remembers))


@dataclass(frozen=True)
class Crash:
    """A process is killed, and its state file (if it has one) perhaps damaged."""

    at: float
    who: str
    damage: Damage = "none"
    seed: int = 0

    def happen(self, arena: Arena) -> None:
        arena.crash(self.who, self.damage, self.seed)


@dataclass(frozen=True)
class Return:
    """A process that crashed starts again, with what is left of its state file."""

    at: float
    who: str

    def happen(self, arena: Arena) -> None:
        if (role := arena.roles.get(self.who)) is not None:
            arena.join(self.who, role)


@dataclass(frozen=True)
class Sense:
    """A robot begins to see things, one each ``every`` seconds (0: all at once)."""

    at: float
    who: str
    sightings: tuple[int, ...]
    every: float = 0.06

    def happen(self, arena: Arena) -> None:
        arena.sense(self.who, self.sightings, self.every)


@dataclass(frozen=True)
class Withdraw:
    """A robot learns that the nth scan of its journal was wrong, and corrects its map."""

    at: float
    who: str
    nth: int

    def happen(self, arena: Arena) -> None:
        arena.withdraw(self.who, self.nth)


@dataclass(frozen=True)
class SetStart:
    """Somebody decides where a robot started: ``start`` is one of ``oracle.STARTS``."""

    at: float
    by: str
    robot: str
    start: int

    def happen(self, arena: Arena) -> None:
        arena.set_start(self.by, self.robot, oracle.STARTS[self.start])


@dataclass(frozen=True)
class Partition:
    """Only peers on one island hear each other from now on; those not named share one more."""

    at: float
    islands: tuple[tuple[str, ...], ...]

    def happen(self, arena: Arena) -> None:
        arena.partition(*self.islands)


@dataclass(frozen=True)
class Heal:
    """The partition ends."""

    at: float

    def happen(self, arena: Arena) -> None:
        arena.partition()


@dataclass(frozen=True)
class Silence:
    """Two never hear each other, from now to the end."""

    at: float
    one: str
    other: str

    def happen(self, arena: Arena) -> None:
        arena.silence(self.one, self.other)


@dataclass(frozen=True)
class Weather:
    """All links behave differently from now on."""

    at: float
    loss: float = 0.0
    duplicate: float = 0.0
    delay: tuple[float, float] = (0.0, 0.0)

    def happen(self, arena: Arena) -> None:
        arena.weather(Link(self.loss, self.duplicate, self.delay))


@dataclass(frozen=True)
class Evict:
    """Somebody evicts the nth session that it knows."""

    at: float
    by: str
    nth: int

    def happen(self, arena: Arena) -> None:
        arena.evict(self.by, self.nth, readmit=False)


@dataclass(frozen=True)
class Readmit:
    """Somebody readmits the nth session that it knows."""

    at: float
    by: str
    nth: int

    def happen(self, arena: Arena) -> None:
        arena.evict(self.by, self.nth, readmit=True)


@dataclass(frozen=True)
class Corrupt:
    """From now on this share of all payloads arrives with a few bytes changed."""

    at: float
    share: float

    def happen(self, arena: Arena) -> None:
        arena.corrupt(self.share)


@dataclass(frozen=True)
class Hostile:
    """A stranger says something: random bytes, what others said before, or that with a few bytes changed."""

    at: float
    how: Literal["noise", "replay", "mutation"]
    seed: int
    count: int = 5

    def happen(self, arena: Arena) -> None:
        chance = random.Random(self.seed)
        tap = arena.stranger()
        for _ in range(self.count):
            payload = chance.randbytes(chance.randint(1, min(tap.mtu, 300)))
            if self.how != "noise" and arena.said:
                payload = chance.choice(arena.said)
            if self.how == "mutation":
                payload = mutated(payload, chance)
            if self.how == "replay" or not is_a_lie(payload):
                tap.publish("update", payload)
