"""Many sessions at once: who asks first, who has to wait, and what is forgotten."""

import math

import pytest

from swarm.drops import Drop
from swarm.jitter import Jitter
from swarm.messages import Manifest, Want
from swarm.pursuits import Pursuits
from swarm.state import State
from swarm.timers import Timers

TIMERS = Timers(jitter=(0.1, 0.2), retry=1.0, retry_max=1.0, fetches=2)
SESSIONS = [bytes([k] * 8) for k in range(4)]


@pytest.fixture
def pursuits():
    return Pursuits(TIMERS, Jitter(b"seed"), 1000)


def test_nothing_is_to_be_done_while_nobody_has_more(pursuits):
    assert pursuits.wake_at == math.inf
    assert pursuits.poll({}, 5.0) == []
    assert (len(pursuits), pursuits.most(SESSIONS[0])) == (0, -1)


def test_no_more_sessions_are_asked_for_at_once_than_may_be_and_the_others_get_their_turn(pursuits):
    for session in SESSIONS:
        pursuits.heard(session, "a", 9, -1, 0.0)
    assert pursuits.most(SESSIONS[3]) == 9
    first = pursuits.poll({}, 1.0)
    assert [(to, request.n) for to, request in first] == [("a", -1)] * 2
    assert all(isinstance(request, Want) for _, request in first)
    assert pursuits.wake_at == 2.0  # when the first of them is overdue, though two others have waited for long
    for _, request in first:
        pursuits.advanced(request.session, 9, 1.5)
    assert len(pursuits) == 2
    second = pursuits.poll({}, 1.5)
    assert {request.session for _, request in (*first, *second)} == set(SESSIONS)


def test_a_session_that_is_not_pursued_has_no_answers(pursuits):
    with pytest.raises(Drop, match="an answer that nobody waits for"):
        pursuits.offer("a", Manifest(SESSIONS[0], 20, 0, bytes(16), b""), State(), 0.0)


def test_whoever_has_gone_is_not_asked(pursuits):
    pursuits.heard(SESSIONS[0], "a", 9, -1, 0.0)
    pursuits.gone("a", 0.05)
    assert pursuits.poll({}, 1.0) == []
    assert len(pursuits) == 0
