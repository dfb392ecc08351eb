"""Who listens where: every peer of the roster listens on its own port and connects to those before it.

Laws kept here: between any two of them exactly one of the pair is told to connect, so that a link that breaks is
always somebody's to make again; a peer that is not in the roster is connected to by nobody, and connects to all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Endpoints(NamedTuple):
    """What one peer listens on and connects to, as Zenoh writes it (our ZeroMQ bus too): ``tcp/127.0.0.1:7450``."""

    listen: list[str]
    connect: list[str]


def roster_endpoints(hosts: Sequence[str], base_port: int, index: int | None) -> Endpoints:
    """The endpoints of the peer with this index in the roster, or of one that is not in it.

    Args:
        hosts: the peers' hosts in the roster's order, as the others reach them: a name, an IPv4 or IPv6 address.
        base_port: peer k listens on ``hosts[k]``, port ``base_port + k``.
        index: the peer's place in the roster; None if it has none.

    Raises:
        ValueError: the index is not in the roster, or a port would not be one.
    """
    if index is not None and not 0 <= index < len(hosts):
        raise ValueError(f"index: expected 0 to {len(hosts) - 1}, got {index}")
    if not (base_port > 0 and base_port + len(hosts) - 1 <= 65_535):
        raise ValueError(f"base_port: expected 1 to 65535 for all {len(hosts)} peers, got {base_port}")
    peers = [f"tcp/{_bracketed(host)}:{base_port + k}" for k, host in enumerate(hosts)]
    if index is None:
        return Endpoints(listen=[], connect=peers)
    return Endpoints(listen=[peers[index]], connect=peers[:index])


def _bracketed(host: str) -> str:
    """An IPv6 address in the brackets that keep its colons apart from the port's."""
    return f"[{host}]" if ":" in host and not host.startswith("[") else host
