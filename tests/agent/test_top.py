"""``orion top`` under fake time: it waits until all is here that others hold, and not for ever."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from agent.control import Quiet
from agent.overview import Overview
from agent.top import Glance, Swarm, held_by_others, holds


@pytest.fixture
def look(watched):
    """Looks once, turn by turn; gives the state, the seconds that it took, and who else was there."""

    def until_it_ends(turn=lambda: watched.talk(0.1)) -> tuple[dict, float]:
        node = SimpleNamespace(peer=watched.observer, heard_bytes=watched.heard, lost=dict)
        control, began = Quiet(), watched.now
        glance = Glance(Swarm(node, watched.tracks, Overview("lab", [])), control, watched.now)
        while not control.stop:
            turn()
            glance(watched.now)
            assert watched.now < began + 60
        return glance.state(watched.now), watched.now - began

    return until_it_ends


def test_it_ends_when_all_is_here_and_the_rates_are_known(look, watched, straight) -> None:
    watched.robot("r1")
    watched.sense("r1", straight(20))
    state, seconds = look()
    assert state["caught_up"]
    assert state["digest"] == watched.observer.fusion.digest().hex()
    assert [session["robot"] for session in state["sessions"]] == ["r1"]
    assert seconds < 10


def test_a_robot_that_goes_on_does_not_keep_it(look, watched, straight) -> None:
    watched.robot("r1")
    ways = iter(range(1000))

    def turn() -> None:
        k = next(ways)
        watched._robots["r1"].writer.sense(straight(2, y_mm=10 * k, first_ms=200 * k))
        watched.talk(0.1)

    state, seconds = look(turn)
    assert state["caught_up"]
    assert seconds < 10
    assert state["sessions"][0]["updates_rate"] > 0


def test_it_tells_what_there_is_when_somebody_does_not_say_what_he_has(look, watched, straight) -> None:
    watched.robot("r1")
    watched.sense("r1", straight(20))

    def turn() -> None:
        watched.talk(0.1)
        watched.observer.told.clear()

    state, seconds = look(turn)
    assert not state["caught_up"]
    assert state["sessions"][0]["n"] > 0
    assert 10 <= seconds < 15


def test_where_nobody_is_it_does_not_wait_long(look, watched) -> None:
    state, seconds = look()
    assert (state["peers"], state["caught_up"]) == ([], False)
    assert seconds < 8


def test_what_others_hold_is_known_once_all_have_told(watched, straight) -> None:
    assert held_by_others(watched.observer) is None
    session = watched.robot("r1")
    watched.sense("r1", straight(20))
    watched.talk(60)
    wanted = held_by_others(watched.observer)
    assert wanted == {session: watched.observer.replicas[session].state.n}
    assert holds(watched.observer, wanted)
    assert not holds(watched.observer, {session: wanted[session] + 1})
    assert not holds(watched.observer, wanted | {b"strange.": 0})
    watched.robot("r2")
    watched.talk(0.01)
    watched.observer.told.pop("r2", None)
    assert held_by_others(watched.observer) is None
