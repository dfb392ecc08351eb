"""A fleet and its members, played by actors: when a run has converged, when not, and what is said of it."""

from __future__ import annotations

import json
import queue
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import agent.fleet
from agent.config import resolve
from agent.errors import UserError
from agent.fleet import Fleet
from agent.outputs import Outputs
from agent.progress import Silence

DIGEST = "ab" * 16


class Actor:
    """Plays a member's process: what it does when it is told something is a table.

    Attributes:
        orders: what it was told.
        killed: whether it had to be.
    """

    def __init__(self, name: str, plays: dict[str, Callable[[Actor], None]]) -> None:
        self.name = name
        self.orders: list[str] = []
        self.killed = False
        self.stdin = self
        self.stdout = self
        self._plays = plays
        self._said: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._plays.get("start", lambda actor: None)(self)

    # what a play may do

    def says(self, event: str, **facts: Any) -> None:
        self._said.put(json.dumps({"event": event, **facts}) + "\n")

    def stutters(self) -> None:
        self._said.put('{"event": "stat')

    def dies(self) -> None:
        self._said.put(None)
        self._dead = True

    # a process

    def write(self, text: str) -> None:
        self.orders.append(text.strip())
        self._plays.get(text.strip(), lambda actor: None)(self)

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass

    def wait(self, timeout: float | None = None) -> int:
        if not getattr(self, "_dead", False):
            raise subprocess.TimeoutExpired("actor", timeout or 0)
        return 0

    def kill(self) -> None:
        self.killed = True
        self.dies()

    def __enter__(self) -> Actor:
        return self

    def __exit__(self, *exc_info: object) -> None:
        pass

    def __iter__(self) -> Iterator[str]:
        while (line := self._said.get()) is not None:
            yield line


def stands_there(actor: Actor) -> None:
    actor.says("ready")
    actor.says("status", around=2, progress=[0, 5], done=actor.name == "observer", positions={}, refused=[])


def maps(**positions: int) -> Callable[[Actor], None]:
    def play(actor: Actor) -> None:
        actor.says("status", around=2, progress=[5, 5], done=True, positions=positions, refused=[])

    return play


def reports(digest: str = DIGEST) -> Callable[[Actor], None]:
    def play(actor: Actor) -> None:
        if actor.name == "observer":
            actor.says("report", map_digest=digest, tiles=3, known_m2=1.5, files={"png": "map.png"})
        else:
            actor.says("report", id=actor.name, map_digest=digest, scans=5, updates=2)
        actor.dies()

    return play


def silent(actor: Actor) -> None:
    """Neither acts nor ends."""


GOOD = {"start": stands_there, "go": maps(aa=2, bb=3), "finish": reports()}


class NoCompilation:
    ready = True

    def __enter__(self) -> NoCompilation:
        return self

    def __exit__(self, *exc_info: object) -> None:
        pass


@pytest.fixture
def cast(monkeypatch: pytest.MonkeyPatch):
    """Gives the roles to actors: runs a fleet of r1, r2 and the observer with them to its summary."""
    actors: dict[str, Actor] = {}
    monkeypatch.setattr(agent.fleet, "Compilation", NoCompilation)
    monkeypatch.setattr(agent.fleet, "_MEETING", 0.2)
    monkeypatch.setattr(agent.fleet, "_STALLED", 0.3)
    monkeypatch.setattr(agent.fleet, "_LEAVING", 0.5)

    def perform(
        *, simulated: bool = False, **roles: dict[str, Callable[[Actor], None]]
    ) -> tuple[dict[str, Any], dict[str, Actor]]:
        def popen(words: list[str], **options: Any) -> Actor:
            assert "--supervised" in words
            assert str(Path("out") / "orion.toml") in words
            command = words[words.index("agent") + 1]
            name = {"observe": "observer", "simulate": "world"}.get(command) or words[words.index("--robot") + 1]
            actors[name] = Actor(name, GOOD | roles.get(name, {}))
            return actors[name]

        monkeypatch.setattr(agent.fleet.subprocess, "Popen", popen)
        with Fleet(resolve({"robots": {"r1": {}, "r2": {}}}), Path("out"), Outputs()) as fleet:
            fleet.start(simulated=simulated)
            settled = fleet.run(Silence())
            fleet.finish()
            summary = fleet.summary(settled=settled, seconds=1.23456)
        return summary, actors

    perform.actors = actors  # type: ignore[attr-defined]
    return perform


def lost(summary: dict[str, Any]) -> list[str]:
    return [robot["id"] for robot in summary["robots"] if robot.get("lost")]


def test_a_good_run_has_converged(cast) -> None:
    summary, actors = cast()
    assert summary == {
        "converged": True,
        "seconds": 1.235,
        "robots": [{"id": name, "map_digest": DIGEST, "scans": 5, "updates": 2} for name in ("r1", "r2")],
        "observer": {"map_digest": DIGEST, "tiles": 3, "known_m2": 1.5},
        "files": {"png": "map.png"},
    }
    for actor in actors.values():
        assert set(actor.orders[:2]) == {"kernel", "go"}
        assert set(actor.orders[2:]) == {"finish"}
        assert not actor.killed


@pytest.mark.parametrize("who", ["r1", "r2", "observer"])
def test_one_process_with_another_map_is_enough_not_to_converge(cast, who: str) -> None:
    summary, _ = cast(**{who: {"finish": reports("cd" * 16)}})
    assert summary["converged"] is False
    assert lost(summary) == []


def test_the_bodies_move_when_all_see_each_other_or_patience_ends(cast) -> None:
    def alone(actor: Actor) -> None:
        actor.says("status", around=0, progress=[0, 5], done=False, positions={}, refused=[])

    summary, actors = cast(r1={"start": alone})
    assert summary["converged"] is True
    assert all("go" in actor.orders for actor in actors.values())


def test_a_process_that_lags_behind_for_ever_is_no_convergence(cast) -> None:
    summary, _ = cast(observer={"go": maps(aa=2, bb=2)})
    assert summary["converged"] is False


def test_a_robot_that_dies_on_the_way_is_lost_and_the_others_report(cast) -> None:
    summary, _ = cast(r2={"go": Actor.dies})
    assert summary["converged"] is False
    assert lost(summary) == ["r2"]
    assert summary["robots"][1] == {"id": "r2", "session": None, "map_digest": None, "lost": True}
    assert summary["robots"][0]["map_digest"] == summary["observer"]["map_digest"] == DIGEST


def test_a_robot_that_dies_before_it_reports_is_lost(cast) -> None:
    summary, _ = cast(r1={"finish": Actor.dies})
    assert (summary["converged"], lost(summary)) == (False, ["r1"])


def test_all_robots_dead_is_the_end_of_the_run(cast) -> None:
    summary, _ = cast(r1={"go": Actor.dies}, r2={"go": Actor.dies})
    assert (summary["converged"], lost(summary)) == (False, ["r1", "r2"])


def test_a_dead_observer_is_the_end_of_the_run(cast) -> None:
    summary, _ = cast(observer={"go": Actor.dies})
    assert summary["converged"] is False
    assert (summary["observer"], summary["files"]) == ({}, {})
    assert lost(summary) == []


def test_a_line_cut_off_by_death_is_overlooked(cast) -> None:
    def stutter_and_die(actor: Actor) -> None:
        actor.stutters()
        actor.dies()

    summary, _ = cast(r2={"go": stutter_and_die})
    assert lost(summary) == ["r2"]


def test_a_process_that_does_not_end_is_killed(cast) -> None:
    summary, actors = cast(r2={"finish": silent})
    assert (summary["converged"], lost(summary)) == (False, ["r2"])
    assert {name for name, actor in actors.items() if actor.killed} == {"r2"}


def complains(actor: Actor) -> None:
    actor.says("error", where="robots.r2.body", what="is none", remedy="give one")
    actor.dies()


def test_what_a_process_cannot_do_is_said_in_its_words_and_nobody_writes_a_map(cast) -> None:
    """The others were once told to finish, and the observer wrote an empty map over the last run's."""
    with pytest.raises(UserError, match=r"^robots\.r2\.body: is none; give one$"):
        cast(r2={"start": complains})
    assert all("finish" not in actor.orders for actor in cast.actors.values())
    assert cast.actors["r1"].killed
    assert cast.actors["observer"].killed


def test_a_complaint_is_heard_though_its_process_is_long_gone(cast) -> None:
    """The run was once over when all processes were, with their complaints unread: "NOT CONVERGED" for a bad file."""

    def chatter(actor: Actor) -> None:
        for _ in range(20):
            actor.says("status", around=0, progress=[0, 5], done=False, positions={}, refused=[])

    with pytest.raises(UserError, match="is none"):
        cast(observer={"start": chatter}, r1={"start": complains}, r2={"start": complains})


def test_what_the_observer_cannot_do_at_the_end_is_said_in_its_words(cast) -> None:
    """It once ended in "NOT CONVERGED", and nobody was told of the full disk."""

    def disk_full(actor: Actor) -> None:
        actor.says("error", where="out/map.npz", what="cannot be written: No space left", remedy="free some")
        actor.dies()

    with pytest.raises(UserError, match=r"out/map\.npz: cannot be written: No space left"):
        cast(observer={"finish": disk_full})


def test_a_run_that_is_interrupted_before_everybody_has_started_still_has_a_summary(tmp_path: Path) -> None:
    """Ctrl-C came between the first process and the last: that ended in a KeyError."""
    fleet = Fleet(resolve({"robots": {"r1": {}}}), tmp_path, Outputs())
    summary = fleet.summary(settled=False, seconds=0.1)
    assert (summary["converged"], summary["robots"], summary["observer"]) == (False, [], {})


# The simulated world


def reports_the_world(actor: Actor) -> None:
    actor.says("report", world="paper", simulated_seconds=9.5, robots=[])
    actor.dies()


WORLD = {"start": lambda actor: actor.says("ready", ports={}), "finish": reports_the_world}


def test_the_world_is_a_process_that_is_no_member(cast) -> None:
    """It publishes nothing, so nobody waits to meet it, and it has no map to agree with."""
    summary, actors = cast(simulated=True, world=WORLD)
    assert summary["converged"] is True
    assert [robot["id"] for robot in summary["robots"]] == ["r1", "r2"]
    assert summary["simulation"] == {"world": "paper", "simulated_seconds": 9.5, "robots": []}
    assert next(iter(actors)) == "world"  # the robots find their ports
    assert set(actors["world"].orders) == {"kernel", "go", "finish"}
    assert not actors["world"].killed


def test_without_its_world_a_run_is_over_and_the_robots_report(cast) -> None:
    summary, actors = cast(simulated=True, world=WORLD | {"go": Actor.dies}, r1={"go": silent}, r2={"go": silent})
    assert (summary["converged"], summary["simulation"]) == (False, {"lost": True})
    assert lost(summary) == []
    assert summary["observer"]["map_digest"] == DIGEST
    assert not any(actor.killed for actor in actors.values())


def test_what_the_world_cannot_do_is_said_in_its_words(cast) -> None:
    with pytest.raises(UserError, match="is none"):
        cast(simulated=True, world={"start": complains})
    assert all("finish" not in actor.orders for actor in cast.actors.values())
