"""A cable between peers that a test can pull: passes on one TCP port's connections, cuts them, or carries nothing.

Arguments: the address to listen on, the address to pass on to, and the port of both. Words on standard input: ``cut``
ends all connections and accepts none, ``stall`` keeps them and carries nothing, ``heal`` is as in the beginning.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import sys

here, there, port = sys.argv[1], sys.argv[2], int(sys.argv[3])
selector = selectors.DefaultSelector()
listener = socket.create_server((here, port))
selector.register(listener, selectors.EVENT_READ)
selector.register(sys.stdin, selectors.EVENT_READ)
ends: dict[socket.socket, socket.socket] = {}
state = ["heal"]


def drop(end: socket.socket) -> None:
    for each in (end, ends.pop(end, end)):
        ends.pop(each, None)
        if each.fileno() >= 0:
            with contextlib.suppress(KeyError):
                selector.unregister(each)
            each.close()


def carry(end: socket.socket) -> None:
    try:
        data = end.recv(65_536)
        if data:
            ends[end].sendall(data)
            return
    except OSError:
        pass
    drop(end)


def accept() -> None:
    near, _ = listener.accept()
    try:
        if state == ["cut"]:
            raise ConnectionRefusedError
        far = socket.create_connection((there, port), timeout=1.0)
    except OSError:
        near.close()
        return
    for end, other in ((near, far), (far, near)):
        ends[end] = other
        if state == ["heal"]:
            selector.register(end, selectors.EVENT_READ)


def obey(word: str) -> None:
    state[:] = [word]
    for end in [*ends]:
        if word == "cut" and end in ends:
            drop(end)
        elif word == "stall":
            selector.unregister(end)
        elif word == "heal":
            selector.register(end, selectors.EVENT_READ)
    print(word, flush=True)


print("ready", flush=True)
while True:
    for key, _ in selector.select():
        if key.fileobj is sys.stdin:
            line = sys.stdin.readline()
            if not line:
                sys.exit()
            obey(line.strip())
        elif key.fileobj is listener:
            accept()
        elif key.fileobj in ends:
            carry(key.fileobj)  # type: ignore[arg-type]
