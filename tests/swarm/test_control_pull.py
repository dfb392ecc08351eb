from itertools import pairwise

import pytest

from swarm import control_pull as control_pull_module
from swarm.control_pull import ControlPull
from swarm.jitter import Jitter
from swarm.timers import Timers

TIMERS = Timers(jitter=(0.1, 0.3), retry=1.0, retry_max=3.0, backoff=1.5)
MINE = 7


def new():
    return ControlPull(TIMERS, Jitter(b"seed"))


def asked(pull, mine=MINE):
    """Whom it asks next, and when."""
    now = pull.wake_at
    return pull.poll(mine, now), now


def test_a_difference_is_asked_about_after_a_little_while():
    pull = new()
    pull.heard("a", 1, 5.0)
    assert 5.1 <= pull.wake_at < 5.3
    assert pull.poll(MINE, 5.05) is None
    assert asked(pull)[0] == "a"


def test_a_difference_that_closes_by_itself_is_not_asked_about():
    pull = new()
    pull.heard("a", 1, 0.0)
    assert asked(pull, mine=1)[0] is None
    assert pull.wake_at == float("inf")


def test_one_peer_is_asked_for_each_of_its_digests_and_ever_more_patiently():
    pull = new()
    times = []
    for _ in range(6):
        pull.heard("a", 1, 0.0)
        pull.heard("a", 1, 0.0)
        peer, now = asked(pull)
        assert peer == "a"
        times.append(now)
    gaps = [later - sooner for sooner, later in pairwise(times)]
    assert gaps == pytest.approx([1.0, 1.5, 2.25, 3.0, 3.0])
    assert asked(pull)[0] is None


def test_without_an_answer_somebody_else_is_asked():
    pull = new()
    pull.heard("a", 1, 0.0)
    pull.heard("b", 2, 0.0)
    assert {asked(pull)[0], asked(pull)[0]} == {"a", "b"}
    assert asked(pull)[0] is None


def test_who_leaves_is_not_asked():
    pull = new()
    pull.heard("a", 1, 0.0)
    pull.gone("a")
    pull.gone("nobody")
    assert asked(pull)[0] is None


def test_peers_that_are_remembered_are_bounded(monkeypatch):
    monkeypatch.setattr(control_pull_module, "MAX_SESSIONS", 3)
    pull = new()
    for k in range(9):
        pull.heard(f"p{k}", 1, 0.0)
    pull.heard("p0", 2, 0.0)
    assert sorted(pull._told) == ["p0", "p1", "p2"]
    assert pull._told["p0"] == 2
