"""Who listens where, and that every pair has one that connects."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from transport.roster import roster_endpoints


def test_a_robot_listens_on_its_own_port_and_connects_to_those_before_it():
    listen, connect = roster_endpoints(["pi1", "10.0.0.2", "fe80::1"], 7450, 2)
    assert listen == ["tcp/[fe80::1]:7452"]
    assert connect == ["tcp/pi1:7450", "tcp/10.0.0.2:7451"]


def test_an_observer_listens_nowhere_and_connects_to_all():
    assert roster_endpoints(["h", "h"], 7450, None) == ([], ["tcp/h:7450", "tcp/h:7451"])


@given(size=st.integers(1, 20))
def test_of_every_pair_exactly_one_connects_to_the_other(size):
    robots = [roster_endpoints(["127.0.0.1"] * size, 7450, index) for index in range(size)]
    for one in robots:
        for other in robots:
            if one is not other:
                assert (one.listen[0] in other.connect) != (other.listen[0] in one.connect)
    assert len({robot.listen[0] for robot in robots}) == size


@pytest.mark.parametrize("index", [-1, 2])
def test_an_index_outside_the_roster_is_refused(index):
    with pytest.raises(ValueError, match=f"index: expected 0 to 1, got {index}"):
        roster_endpoints(["h", "h"], 7450, index)


@pytest.mark.parametrize("base_port", [0, -1, 65_535])
def test_ports_that_are_none_are_refused(base_port):
    with pytest.raises(ValueError, match="base_port"):
        roster_endpoints(["h", "h"], base_port, 0)
