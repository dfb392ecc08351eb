"""A peer in a process of its own: greets whoever joins, echoes what it hears, and ends when its standard input does.

Arguments: the bus (``ZenohBus`` or ``ZmqBus``), the peer's name, one endpoint to listen on and one to connect to
(``-`` for none), and what to do: ``echo``, or ``fail`` with an uncaught exception as soon as somebody joins, its bus
still open.
"""

from __future__ import annotations

import select
import sys

from transport.bus import Joined, Message
from transport.zenoh_bus import ZenohBus
from transport.zmq_bus import ZmqBus

kind, name, listen, connect, then = sys.argv[1:]
bus = {"ZenohBus": ZenohBus, "ZmqBus": ZmqBus}[kind](  # on purpose not in a with statement, and held by the module
    "test",
    name,
    listen=[listen] if listen != "-" else [],
    connect=[connect] if connect != "-" else [],
)
while not select.select([sys.stdin], [], [], 0)[0]:
    for event in bus.receive(0.02):
        if isinstance(event, Joined):
            if then == "fail":
                raise LookupError("nobody catches this")
            bus.send(event.peer, b"welcome")
        if isinstance(event, Message):
            bus.send(event.sender, b"echo " + event.payload)
