"""A peer at work: the one loop that owns a process's state.

body -> scans -> the peer's own session -> bus; bus -> the peer -> the fused map. Everything happens in this loop, in
this thread; other threads only put bytes into the bus's queue.
"""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Mapping
from typing import Any

from agent.body import Body
from agent.control import Control
from agent.kernel import Kernel
from mapping.lattice import Cells, TileKey
from mapping.pose import QuantisedPose
from mapping.scan import Scans
from mapping.sensor import Beam, Sensor
from mapping.tiles import Tiles
from swarm.messages import Hello
from swarm.peer import Listener, Peer
from swarm.session import Descriptor, Rules
from swarm.timers import LAN
from swarm.writer import Publish
from transport.bus import Bus, Joined, Left, Message

SOFTWARE = b"orion-swarm"
Corrections = Callable[[Tiles], Mapping[TileKey, Cells]]
"""The own session's tiles that news changes, with their new contents (``agent.team_mates``)."""

_STATUS_PERIOD = 0.1


class NoBody:
    """The body of an observer: it senses nothing and is always done."""

    sensor = Sensor((Beam(0, 0, 0),), 1)
    progress = (0, 0)
    done = True
    patience = 0.02
    status = ""

    def read(self, until: float) -> Scans:
        """No scans, ever."""
        return Scans.empty(len(self.sensor.beams))

    def close(self) -> None:
        """Nothing moves."""


def peer_name(name: str) -> str:
    """A name on the bus that no other process has, not even a restart of the same robot."""
    return f"{name}.{secrets.token_hex(4)}"


class Node:
    """One process of the swarm.

    Attributes:
        peer: all that it knows of the swarm.
        scans: how many its body has sensed.
    """

    def __init__(
        self,
        bus: Bus,
        rules: Rules,
        hello: Hello,
        *,
        body: Body | None = None,
        speed: float = 1.0,
        listener: Listener = lambda descriptor, update: None,
        corrections: Corrections = lambda tiles: {},
    ) -> None:
        self._bus = bus
        self._corrections = corrections
        self._body: Body = NoBody() if body is None else body
        self._speed = speed
        self._kernel = Kernel()
        self._began: float | None = None
        self._around: set[str] = set()
        self._told: dict[str, Any] = {}
        self._told_at = -math.inf
        self.scans = 0
        self.peer = Peer(
            hello,
            rules,
            seed=bus.peer.encode(),
            mtu=bus.mtu,
            now=time.monotonic(),
            timers=LAN,
            kernel=self._kernel,
            listener=listener,
        )

    def open_session(self, robot: str, start: QuantisedPose | None, publish: Publish) -> Descriptor:
        """Become the writer of a new session of that robot."""
        descriptor = Descriptor(robot, secrets.token_bytes(8), self.peer.rules, self._body.sensor, start)
        self.peer.open_session(descriptor, publish)
        return descriptor

    def run(self, control: Control) -> None:
        """Work until told to stop."""
        try:
            while not control.stop:
                if control.kernel:
                    self._kernel.load()
                self._sense(go=control.go)
                self._hear()
                self._say(time.monotonic())
                self._correct()
                self._report(control)
            self._say(time.monotonic() + LAN.update_period)  # what was sensed is not lost with the process
        finally:
            self._kernel.close()

    def _sense(self, *, go: bool) -> None:
        done = self._body.done  # then it has seen enough; but a robot must be listened to even so
        scans = self._body.read(self._body_time(time.monotonic()) if go else 0.0)
        if self.peer.writer is not None and len(scans) and not done:
            self.peer.writer.sense(scans)
            self.scans += len(scans)

    def _body_time(self, now: float) -> float:
        if self._began is None:
            self._began = now
        return math.inf if math.isinf(self._speed) else (now - self._began) * self._speed

    def _correct(self) -> None:
        """Publish what was learnt of what is published already; not while scans wait, on which it does not count."""
        writer = self.peer.writer
        if writer is not None and not writer.waiting:
            changes = self._corrections(writer.replica.state.cells)
            if changes:
                self.peer.correct(changes, time.monotonic())

    def _hear(self) -> None:
        for event in self._bus.receive(self._idle_time()):
            now = time.monotonic()
            match event:
                case Message(sender, payload):
                    self.peer.receive(sender, payload, now)
                case Joined(name):
                    self._around.add(name)
                    self.peer.joined(name, now)
                case Left(name):
                    self._around.discard(name)
                    self.peer.left(name, now)

    def _idle_time(self) -> float:
        """Seconds to wait for something to come in."""
        hurry = not self._body.done and math.isinf(self._speed) and self._began is not None
        return 0.0 if hurry else min(max(0.0, self.peer.wake_at - time.monotonic()), self._body.patience)

    def _say(self, now: float) -> None:
        for to, topic, payload in self.peer.poll(now):
            if to is None:
                self._bus.publish(topic, payload)
            else:
                self._bus.send(to, payload)

    def _report(self, control: Control) -> None:
        """Tell how far we are, if that is news, ten times a second at most."""
        now = time.monotonic()
        if now - self._told_at < _STATUS_PERIOD:
            return
        writer = self.peer.writer
        status = {
            "around": len(self._around),
            "progress": self._body.progress,
            "body": self._body.status,
            "done": self._body.done and not (writer is not None and writer.waiting),
            "positions": {session.hex(): replica.state.n for session, replica in self.peer.replicas.items()},
            "refused": sorted(self.peer.refused.values()),
            "not_placed": sorted(
                replica.descriptor.robot for replica in self.peer.replicas.values() if replica.descriptor.start is None
            ),
        }
        if status != self._told:
            self._told, self._told_at = status, now
            control.tell("status", **status)

    def summary(self) -> dict[str, Any]:
        """What every process says of itself at the end."""
        return {
            "bytes_sent": self._bus.counters["bytes_sent"],
            "map_digest": self.peer.fusion.digest().hex(),
            "dropped": dict(self.peer.dropped) | self._lost(),
        }

    def _lost(self) -> dict[str, int]:
        """What the bus itself had to drop."""
        return {name: count for name, count in self._bus.counters.items() if name.startswith("dropped_")}
