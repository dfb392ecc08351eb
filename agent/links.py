"""The bus that a configuration asks for, and whether its ports are free."""

from __future__ import annotations

import errno
import socket

from agent.config import Config
from agent.errors import UserError
from agent.node import peer_name
from transport.bus import Bus, BusError
from transport.roster import Endpoints, roster_endpoints


def open_bus(config: Config, name: str) -> Bus:
    """Join the swarm.

    Args:
        config: the swarm.
        name: the robot's id, an observer's that has a table, or any other: then it listens on nothing.

    Raises:
        UserError: an endpoint cannot be used.
    """
    index = config.listeners.index(name) if name in config.listeners else None
    if index is not None:
        _check_port(config, index)
    endpoints = roster_endpoints(config.hosts, config.base_port, index)
    try:
        return _open(config, peer_name(name), endpoints)
    except BusError as error:
        raise UserError(error.where, error.what, "choose another base_port, or mend the robots' hosts") from None


def _open(config: Config, peer: str, endpoints: Endpoints) -> Bus:
    if config.transport == "zmq":
        from transport.zmq_bus import ZmqBus

        return ZmqBus(config.swarm, peer, listen=endpoints.listen, connect=endpoints.connect)
    from transport.zenoh_bus import ZenohBus

    return ZenohBus(config.swarm, peer, listen=endpoints.listen, connect=endpoints.connect)


def check_ports(config: Config) -> None:
    """Make sure, before anything starts, that every robot of this machine can listen.

    Raises:
        UserError: a port is occupied, or a host is not ours.
    """
    for index in range(len(config.roster)):
        _check_port(config, index)


def bind_once(host: str, port: int) -> None:
    """Find out whether one could listen there.

    Raises:
        OSError: one cannot, or the host is not known.
        UnicodeError: a name that no resolver is asked for, such as a..b.
    """
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)


def _check_port(config: Config, index: int) -> None:
    name, host, port = config.listeners[index], config.hosts[index], config.base_port + index
    try:
        bind_once(host, port)
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        table = "robots" if name in config.robots else "observers"
        raise UserError(f"{table}.{name}: {host}:{port}", reason[:1].lower() + reason[1:], _remedy(error)) from None


def _remedy(error: Exception) -> str:
    match error:
        case OSError(errno=errno.EADDRINUSE):
            return "give another base_port"
        case PermissionError():
            return "give a base_port of 1024 or more"
        case _:
            return "give it a host of this machine"
