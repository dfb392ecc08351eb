"""Processes are killed again and again, and come back with their state: nothing that was published is lost."""

from __future__ import annotations

import math
import random
import signal
from typing import Any

import pytest

from agent.playback import RecordedBody, read
from agent.state_reader import read as read_state
from agent.state_reader import read_journal
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import Pose
from mapping.tiles import Tiles, map_digest, summed
from swarm.session import Rules

pytestmark = pytest.mark.processes

CELL = 0.05
EVERY = 3.0
"""Seconds between two murders."""
PATIENCE = 180.0
RULES = Rules(Lattice.of(CELL), EvidenceModel())


class Process:
    """One process of the swarm, which has a life after each death.

    Attributes:
        told: how far it ever said that each session was.
        deaths: how many it has died.
    """

    def __init__(self, orion, *words: object) -> None:
        self._orion, self._words = orion, words
        self.told: dict[str, int] = {}
        self.deaths = 0
        self.start()

    def start(self) -> None:
        self.now = self._orion(*self._words, "--supervised")

    def look(self, seconds: float) -> None:
        """Listen to it for so long."""
        self.now.idle(seconds)
        positions = self.now.status.get("positions", {})
        self.told |= {session: n for session, n in positions.items() if n >= self.told.get(session, 0)}

    def kill(self) -> None:
        self.now.signal(signal.SIGKILL)
        assert self.now.ends() == -signal.SIGKILL, self.now.errors
        self.look(0.0)
        self.deaths += 1


def roster_of(swarm, robots: int) -> dict[str, dict[str, Any]]:
    """Robots that need six seconds each, all of them started elsewhere."""
    table = {}
    for k in range(1, robots + 1):
        log = swarm.log(f"r{k}.log", scans=60 + k, seconds=6.0)
        start = {"x": 0.5 * k, "y": -0.25 * k, "yaw_deg": 7.0 * k}
        table[f"r{k}"] = {"start": start, "body": {"kind": "recording", "path": str(log), "speed": 1.0}}
    return table


@pytest.mark.parametrize(
    ("robots", "observers", "rounds", "victims", "transport"),
    [
        (3, 1, 3, 1, "zenoh"),
        pytest.param(8, 2, 40, 2, "zenoh", marks=pytest.mark.soak),
        pytest.param(8, 2, 40, 2, "zmq", marks=pytest.mark.soak),
    ],
)
def test_all_that_was_published_outlives_those_who_are_killed(
    orion, swarm, truth, robots: int, observers: int, rounds: int, victims: int, transport: str
) -> None:
    """Two at a time in the long forms. The wanted map is made of the recordings, without any network or state."""
    roster = roster_of(swarm, robots)
    toml = swarm.toml(roster, cell=CELL, transport=transport)
    state, out = swarm.folder / "state", swarm.folder / "out"
    agents = [Process(orion, "agent", "-c", toml, "--robot", name, "--state", state) for name in roster]
    watch = [
        Process(orion, "observe", "-c", toml, "--state", swarm.folder / f"state-{k}", "--out", out / str(k))
        for k in range(observers)
    ]
    everybody = [*agents, *watch]
    for each in everybody:
        each.now.is_ready()
    for each in everybody:
        each.now.order("go")
    chance = random.Random(1)
    for _ in range(rounds):
        for each in everybody:
            each.look(EVERY / len(everybody))
        for victim in chance.sample(everybody, victims):
            victim.kill()
            victim.start()
            victim.now.order("go")

    for agent in agents:
        agent.now.shows("done", True, PATIENCE)
    watch[0].now.hears_no_more(quiet=3.0)
    published: dict[str, int] = {}
    for each in everybody:
        each.look(0.1)
        published |= {session: n for session, n in each.told.items() if n >= published.get(session, 0)}
    for each in everybody:
        each.now.knows(lambda known: known == published, PATIENCE)
    reports = [each.now.finish() for each in everybody]
    (digest,) = {report["map_digest"] for report in reports}
    assert all(report["state"]["status"] == "" for report in reports)
    assert len(published) > len(roster)  # some died in their work

    # each session is so many of its robot's first scans, and all of them together are the map
    maps = []
    for name, settings in roster.items():
        start = Pose(settings["start"]["x"], settings["start"]["y"], math.radians(settings["start"]["yaw_deg"]))
        recording = read(swarm.folder / f"{name}.log")[0]
        first_scans = truth.after_each_scan(recording, CELL, start)
        scans_of = {digest_of(tiles): k for k, tiles in enumerate(first_scans)}
        path = state / f"{name}.sqlite"
        runs = sorted(run.run for run in read_state(path, "orion", RULES).runs)
        files = reports[-1]["files"]["robots"]
        for run, stem in zip(runs, [name, *(f"{name}-{run.hex()}" for run in runs[1:])], strict=True):
            scans = scans_of[truth.in_file(files.pop(stem))]
            assert scans <= len(read_journal(path, run, RecordedBody(recording).sensor))
            assert (scans > 0) == (published.pop(run.hex()) > 0)
            maps.append(first_scans[scans])
    assert not published  # whatever anybody has heard of was in its robot's journal before
    assert not files
    assert digest == digest_of(summed(maps))
    print(f"{sum(each.deaths for each in everybody)} killed, {len(maps)} sessions, digest {digest}")


def digest_of(tiles: Tiles) -> str:
    return map_digest(tiles).hex()
