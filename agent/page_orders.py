"""What a person decides on the page: parsed where it comes in, carried out by the loop that owns the state.

Laws kept here: an order is checked whole before it is handed over; the loop carries it out between two turns, and the
page hears what came of it.
"""

from __future__ import annotations

import queue
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol

from mapping.pose import FULL_TURN, QuantisedPose
from swarm.limits import MAX_COORDINATE_MM
from swarm.peer import Peer
from swarm.session import ROBOT_ID, SessionId

MOST_WAITING = 64
"""Orders that wait at most; a loop takes them fifty times a second."""


class Order(Protocol):
    """Something to decide."""

    def carry_out(self, peer: Peer, now: float) -> None:
        """Decide it.

        Raises:
            ValueError: it cannot be decided, in words.
        """
        ...


@dataclass(frozen=True, slots=True)
class Evict:
    """Take a session out of the map, or back into it."""

    session: SessionId
    readmit: bool

    def carry_out(self, peer: Peer, now: float) -> None:
        """See ``Order``."""
        if self.session not in peer.replicas:
            raise ValueError(f"session {self.session.hex()} is not held here")
        (peer.readmit if self.readmit else peer.evict)(self.session, now)


@dataclass(frozen=True, slots=True)
class Place:
    """Say where a robot started."""

    robot: str
    pose: QuantisedPose

    def carry_out(self, peer: Peer, now: float) -> None:
        """See ``Order``."""
        if not any(descriptor.robot == self.robot for descriptor in peer.descriptors.values()):
            raise ValueError(f"robot {self.robot} is unknown")
        peer.set_start_pose(self.robot, self.pose, now)


class Orders:
    """Orders on their way from the page's thread to the loop."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[tuple[Order, Future[None]]] = queue.Queue(MOST_WAITING)

    def give(self, order: Order) -> Future[None]:
        """Hand an order over; the future tells what came of it.

        Raises:
            ValueError: too many wait already.
        """
        done: Future[None] = Future()
        try:
            self._waiting.put_nowait((order, done))
        except queue.Full:
            raise ValueError("too many orders at once") from None
        return done

    def carry_out(self, peer: Peer, now: float) -> None:
        """Carry out all that wait; called by the loop."""
        while True:
            try:
                order, done = self._waiting.get_nowait()
            except queue.Empty:
                return
            try:
                order.carry_out(peer, now)
            except ValueError as error:
                done.set_exception(error)
            else:
                done.set_result(None)


def parse(kind: str, fields: Any) -> Order:
    """An order as JSON brings it.

    Args:
        kind: evict, readmit or start-pose.
        fields: ``{"session": hex}``; or ``{"robot": id, "x_mm": int, "y_mm": int, "yaw_turn16": int}``.

    Raises:
        ValueError: it is none, in words.
    """
    if not isinstance(fields, dict):
        raise ValueError("expected a JSON object")
    if kind in {"evict", "readmit"}:
        session = fields.get("session")
        if fields.keys() != {"session"} or not isinstance(session, str):
            raise ValueError("expected session: 16 hex digits")
        try:
            data = bytes.fromhex(session)
        except ValueError:
            data = b""
        if len(data) != 8:
            raise ValueError(f"session: expected 16 hex digits, got {session[:32]!r}")
        return Evict(data, readmit=kind == "readmit")
    if kind == "start-pose":
        if fields.keys() != {"robot", "x_mm", "y_mm", "yaw_turn16"}:
            raise ValueError("expected robot, x_mm, y_mm and yaw_turn16")
        robot, *numbers = (fields[name] for name in ("robot", "x_mm", "y_mm", "yaw_turn16"))
        if not isinstance(robot, str) or not ROBOT_ID.fullmatch(robot):
            raise ValueError("robot: expected a robot's id")
        if not all(type(number) is int for number in numbers):
            raise ValueError("x_mm, y_mm, yaw_turn16: expected whole numbers")
        x_mm, y_mm, yaw_turn16 = numbers
        if max(abs(x_mm), abs(y_mm)) > MAX_COORDINATE_MM:
            raise ValueError(f"x_mm, y_mm: expected at most {MAX_COORDINATE_MM} mm from the origin")
        return Place(robot, QuantisedPose(x_mm, y_mm, yaw_turn16 % FULL_TURN))
    raise ValueError(f"{kind!r} is no order")
