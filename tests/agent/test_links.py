"""Ports and hosts: what cannot be listened on is said before anything starts, with the robot's name."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from agent.config import Config, resolve
from agent.errors import UserError
from agent.links import check_ports, open_bus


@pytest.fixture
def occupied() -> Iterator[int]:
    """A port on which somebody listens."""
    with socket.socket() as somebody:
        somebody.bind(("127.0.0.1", 0))
        somebody.listen()
        yield somebody.getsockname()[1]


def swarm(base_port: int, *hosts: str, transport: str = "zenoh") -> Config:
    return resolve(
        {
            "transport": transport,
            "base_port": base_port,
            "robots": {f"r{k + 1}": {"host": host} for k, host in enumerate(hosts)},
        }
    )


def a_free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_free_ports_pass_and_stay_free() -> None:
    config = swarm(a_free_port(), "127.0.0.1")
    check_ports(config)
    check_ports(config)


def test_an_occupied_port_names_the_robot_and_the_port(occupied: int) -> None:
    config = swarm(occupied - 1, "127.0.0.2", "127.0.0.1")
    said = rf"^robots\.r2: 127\.0\.0\.1:{occupied}: address already in use; give another base_port$"
    with pytest.raises(UserError, match=said):
        check_ports(config)


@pytest.mark.parametrize("transport", ["zenoh", "zmq"])
def test_an_agent_on_an_occupied_port_says_the_same(occupied: int, transport: str) -> None:
    """It once named all the swarm's endpoints and a place in Zenoh's sources."""
    said = rf"^robots\.r1: 127\.0\.0\.1:{occupied}: address already in use; give another base_port$"
    with pytest.raises(UserError, match=said):
        open_bus(swarm(occupied, "127.0.0.1", transport=transport), "r1")


@pytest.mark.parametrize("transport", ["zenoh", "zmq"])
def test_a_port_just_given_up_is_free_again(transport: str) -> None:
    config = swarm(a_free_port(), "127.0.0.1", transport=transport)
    with open_bus(config, "r1"), pytest.raises(UserError, match="address already in use"):
        check_ports(config)
    check_ports(config)


@pytest.mark.parametrize(
    ("host", "reason"),
    [
        ("192.0.2.1", "cannot assign requested address"),  # an address for documentation: nobody has it
        ("a..b", "label empty or too long"),
        ("x" * 200, "label"),
    ],
)
def test_a_host_that_is_not_ours_is_named_with_its_robot(host: str, reason: str) -> None:
    with pytest.raises(UserError, match=rf"^robots\.r1: {host}:\d+: .*{reason}.*; give it a host of this machine"):
        check_ports(swarm(a_free_port(), host))


def test_a_name_that_nobody_knows_is_named_with_its_robot() -> None:
    with pytest.raises(UserError, match=r"^robots\.r1: nobody\.invalid:\d+: .*; give it a host of this machine"):
        check_ports(swarm(a_free_port(), "nobody.invalid"))


@pytest.mark.parametrize("transport", ["zenoh", "zmq"])
def test_an_observer_listens_nowhere(transport: str) -> None:
    config = swarm(a_free_port(), "127.0.0.1", transport=transport)
    with open_bus(config, "observer") as bus:
        assert bus.peer.startswith("observer.")
        check_ports(config)


@pytest.mark.parametrize("transport", ["zenoh", "zmq"])
def test_an_observer_with_a_table_listens_after_the_robots(transport: str) -> None:
    config = resolve(swarm(a_free_port(), "127.0.0.1", transport=transport).model_dump() | {"observers": {"base": {}}})
    assert (config.roster, config.listeners) == (["r1"], ["r1", "base"])
    with open_bus(config, "base"), pytest.raises(UserError, match=r"observers\.base: .*address already in use"):
        open_bus(config, "base")
