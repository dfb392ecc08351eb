"""One seed, one schedule: what chance does to swarms."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise

from swarm.writer import Publish
from tests.scenarios.damage import Damage
from tests.scenarios.events import (
    Corrupt,
    Crash,
    Event,
    Evict,
    Heal,
    Hostile,
    Join,
    Partition,
    Readmit,
    Return,
    Sense,
    SetStart,
    Silence,
    Weather,
    Withdraw,
)
from tests.scenarios.oracle import SIGHTINGS, STARTS
from tests.scenarios.schedule import Schedule

Draw = Callable[[random.Random, list[str], list[str], float], list[Event]]
"""From chance, the robots, all peers, and how long it lasts: some events."""


def _some_sightings(chance: random.Random, most: int, least: int = 1) -> tuple[int, ...]:
    return tuple(chance.randrange(len(SIGHTINGS)) for _ in range(chance.randint(least, most)))


def _sensing(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """A few robots drive long enough for checkpoints, others for a moment; bursts come all at once."""
    events: list[Event] = []
    for who in robots:
        most = chance.choice([5, 12, 30, 60])
        for _ in range(chance.randint(1, 2)):
            every = chance.choice([0.0, 0.06, 0.06, 0.06])
            events.append(Sense(_time(chance, 0.0, lasts * 0.7), who, _some_sightings(chance, most), every))
    return events


def _joins(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """Most are there from the start; two robots may have one id."""
    events: list[Event] = []
    remember = chance.random() < 0.4
    for who in peers:
        at = 0.0 if chance.random() < 0.7 else _time(chance, 0.0, lasts)
        if who in robots:
            robot = robots[0] if chance.random() < 0.1 else who
            publish: Publish = chance.choice(["auto", "auto", "tiles"])
            start = None if chance.random() < 0.07 else chance.randrange(len(STARTS))
            events.append(Join(at, who, robot, start, publish, remembers=remember and chance.random() < 0.8))
        else:
            events.append(Join(at, who, remembers=remember and chance.random() < 0.5))
    return events


def _crashes(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    events: list[Event] = []
    for who in chance.sample(peers, chance.randint(1, max(1, len(peers) - 1))):
        at = _time(chance, 0.2, lasts)
        damage: Damage = chance.choice(["none", "none", "none", "lost", "truncated", "flipped"])
        events.append(Crash(at, who, damage, chance.randrange(2**32)))
        if chance.random() < 0.7:
            back = _time(chance, at, lasts)
            events.append(Return(back, who))
            if who in robots:
                events.append(Sense(back, who, _some_sightings(chance, 8)))
    return events


def _partitions(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    events: list[Event] = []
    for _ in range(chance.randint(1, 3)):
        at = _time(chance, 0.0, lasts)
        shuffled = chance.sample(peers, len(peers))
        cut = chance.randrange(len(peers))
        events += [Partition(at, (tuple(shuffled[:cut]),)), Heal(_time(chance, at, lasts))]
    return events


def _chain(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """A-B-C-...: only neighbours ever hear each other."""
    near = {frozenset(pair) for pair in pairwise(peers)}
    pairs = [(one, other) for k, one in enumerate(peers) for other in peers[k + 1 :]]
    return [Silence(0.0, one, other) for one, other in pairs if frozenset((one, other)) not in near]


def _weather(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    at = _time(chance, 0.0, lasts)
    return [Weather(at, round(chance.uniform(0, 0.6), 2), round(chance.uniform(0, 0.3), 2), _delay(chance))]


def _hostile(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    return [
        Hostile(_time(chance, 0.1, lasts), chance.choice(["noise", "replay", "mutation"]), chance.randrange(2**32))
        for _ in range(chance.randint(1, 6))
    ]


def _withdrawals(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    return [
        Withdraw(_time(chance, 0.0, lasts), chance.choice(robots), chance.randrange(60))
        for _ in range(chance.randint(1, 4))
    ]


def _decisions(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """Operators decide and think better of it; what they decided before is said again by a stranger."""
    kinds = [Evict, Evict, Readmit]
    events: list[Event] = [
        chance.choice(kinds)(_time(chance, 0.2, lasts), chance.choice(peers), chance.randrange(6))
        for _ in range(chance.randint(1, 4))
    ]
    return [*events, Hostile(lasts, "replay", chance.randrange(2**32), count=30)]


def _starts(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    return [
        SetStart(_time(chance, 0.2, lasts), chance.choice(peers), chance.choice(robots), chance.randrange(len(STARTS)))
        for _ in range(chance.randint(1, 3))
    ]


def _late(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """Somebody comes when there is more than updates can tell, and what it is given is damaged on the way."""
    who, comes = chance.choice(robots), _time(chance, 3.0, 4.5)
    events: list[Event] = [
        Sense(0.0, who, _some_sightings(chance, 64, least=40)),
        Corrupt(comes, round(chance.uniform(0.05, 0.4), 2)),
        Join(comes, "late"),
        Sense(_time(chance, comes + 1, comes + 4), who, _some_sightings(chance, 3)),
    ]
    return events + ([Crash(_time(chance, comes, comes + 1), who)] if chance.random() < 0.3 else [])


def _homecoming(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """A robot with a memory crashes and comes back, and its start pose is put right."""
    crashes, robot = _time(chance, 0.5, 2.0), "keeper"
    by = chance.choice(peers)
    return [
        Join(0.0, robot, robot, chance.randrange(len(STARTS)), remembers=True),
        Sense(0.0, robot, _some_sightings(chance, 30, least=5)),
        Crash(crashes, robot),
        Return(_time(chance, crashes, crashes + 1), robot),
        SetStart(_time(chance, crashes - 0.3, crashes + 1.5), by, robot, chance.randrange(len(STARTS))),
    ]


def _verdicts(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """Somebody with a memory decides while nobody hears it, crashes, and comes back."""
    by, at = "judge", _time(chance, 0.5, 2.0)
    decision = chance.choice([Evict(at, by, chance.randrange(3)), SetStart(at, by, robots[0], 2)])
    return [
        Join(0.0, by, remembers=True),
        Partition(at - 0.01, ((by,),)),
        decision,
        Crash(at + chance.choice([0.0, 0.001, 0.01, 0.3]), by),
        Return(at + 1.0, by),
        Heal(at + 1.5),
    ]


def _damage(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """A robot comes back with a damaged memory."""
    robot = "hurt"
    damage: Damage = chance.choice(["truncated", "flipped", "flipped"])
    return [
        Join(0.0, robot, robot, chance.randrange(len(STARTS)), remembers=True),
        Sense(0.0, robot, _some_sightings(chance, 64, least=22)),
        Crash(_time(chance, 2.0, 4.0), robot, damage, chance.randrange(2**32)),
        Return(4.0, robot),
    ]


def _corruption(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    return [Corrupt(_time(chance, 0.0, lasts / 2), round(chance.uniform(0.01, 0.3), 2))]


def _whole_tiles(chance: random.Random, robots: list[str], peers: list[str], lasts: float) -> list[Event]:
    """A robot says whole tiles, which fit wherever they come, and much of it is damaged on the way."""
    who = "painter"
    return [
        Join(0.0, who, who, chance.randrange(len(STARTS)), publish="tiles"),
        Corrupt(0.0, round(chance.uniform(0.2, 0.5), 2)),
        Sense(0.1, who, _some_sightings(chance, 25, least=10), 0.06),
    ]


def _time(chance: random.Random, first: float, last: float) -> float:
    return round(chance.uniform(first, last), 3)


def _mtu(chance: random.Random) -> int:
    return round(math.exp(chance.uniform(math.log(84), math.log(65536))))


def _delay(chance: random.Random) -> tuple[float, float]:
    return 0.0002, chance.choice([0.001, 0.02, 0.1, 0.5])


FAULTS: dict[str, Draw] = {
    "crashes": _crashes,
    "partitions": _partitions,
    "chain": _chain,
    "weather": _weather,
    "hostile": _hostile,
    "corruption": _corruption,
    "decisions": _decisions,
    "starts": _starts,
    "late": _late,
    "homecoming": _homecoming,
    "damage": _damage,
    "withdrawals": _withdrawals,
    "verdicts": _verdicts,
    "whole-tiles": _whole_tiles,
}
"""What can go wrong beside the links, each with a way to draw it."""


def everything(seed: int) -> Schedule:
    """Any number of peers, any link, any faults."""
    chance = random.Random(seed)
    robots = [f"r{k}" for k in range(1, chance.randint(1, 4) + 1)]
    peers = robots + [f"o{k}" for k in range(1, chance.randint(0 if len(robots) > 1 else 1, 2) + 1)]
    chance.shuffle(peers)
    lasts = chance.choice([1.5, 3.0, 5.0])
    events = _joins(chance, robots, peers, lasts) + _sensing(chance, robots, peers, lasts)
    for draw in FAULTS.values():
        if chance.random() < 0.35:
            events += draw(chance, robots, peers, lasts)
    return Schedule(
        seed,
        tuple(sorted(events, key=lambda event: event.at)),
        loss=round(max(0.0, chance.uniform(-0.2, 0.6)), 2),
        duplicate=round(max(0.0, chance.uniform(-0.2, 0.3)), 2),
        delay=_delay(chance),
        mtu=_mtu(chance),
        lease=chance.choice([0.0, 0.3, 2.0]),
    )


def only(fault: str) -> Callable[[int], Schedule]:
    """Two robots and an observer on good links, to whom one kind of thing happens."""

    def draw(seed: int) -> Schedule:
        chance = random.Random(seed)
        robots, peers = ["r1", "r2"], ["r1", "r2", "o"]
        events: list[Event] = [Join(0.0, who, who, k) for k, who in enumerate(robots)]
        events += [Join(0.0, "o"), *_sensing(chance, robots, peers, 2.0), *FAULTS[fault](chance, robots, peers, 2.0)]
        return Schedule(seed, tuple(sorted(events, key=lambda event: event.at)), mtu=_mtu(chance), limit=120.0)

    return draw


def with_loss(loss: float) -> Callable[[int], Schedule]:
    """Five peers, four of them robots that drive about, and links that do nothing but lose."""

    def draw(seed: int) -> Schedule:
        chance = random.Random(seed)
        robots = [f"r{k}" for k in range(1, 5)]
        events: list[Event] = [Join(0.0, who, who, k % len(STARTS)) for k, who in enumerate(robots)]
        events.append(Join(0.0, "o"))
        events += [
            Sense(_time(chance, 0, 0.1), who, tuple(chance.randrange(len(SIGHTINGS)) for _ in range(25)))
            for who in robots
        ]
        return Schedule(seed, tuple(sorted(events, key=lambda event: event.at)), loss=loss)

    return draw


KINDS: dict[str, Callable[[int], Schedule]] = {
    "everything": everything,
    **{fault: only(fault) for fault in FAULTS},
    "loss-10": with_loss(0.1),
    "loss-30": with_loss(0.3),
    "loss-50": with_loss(0.5),
}
"""The kinds of schedules, by name."""
