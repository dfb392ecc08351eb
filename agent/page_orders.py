"""What a person decides on the page: parsed where it comes in, carried out by the loop that owns the state.

Laws kept here: an order is checked whole before it is handed over; the loop has it carried out between two turns, and
the page hears what came of it.
"""

from __future__ import annotations

import queue
import sys
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from mapping.pose import FULL_TURN, QuantisedPose
from swarm.limits import MAX_COORDINATE_MM
from swarm.session import ROBOT_ID, SessionId

MOST_WAITING = 64
"""Orders that wait at most; a loop takes them fifty times a second."""

MOST_SPEED = 1000.0
"""How fast a log can be shown at most."""


@dataclass(frozen=True, slots=True)
class Evict:
    """Take a session out of the map, or back into it."""

    session: SessionId
    readmit: bool


@dataclass(frozen=True, slots=True)
class Place:
    """Say where a robot started."""

    robot: str
    pose: QuantisedPose


@dataclass(frozen=True, slots=True)
class Seek:
    """Show a log as it was so many seconds after it began."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Play:
    """Show a log as it went on, so many times as fast; 0 is to pause."""

    speed: float


Order = Evict | Place | Seek | Play


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

    def carry_out(self, obey: Callable[[Order, float], None], now: float) -> bool:
        """Have all that wait carried out, but for those that nobody waits for any more; called by the loop.

        Gives whether there were any.

        Args:
            obey: carries one out (``agent.page_source.Source``); a ValueError tells why it cannot be.
            now: seconds.
        """
        any_were = False
        while True:
            try:
                order, done = self._waiting.get_nowait()
            except queue.Empty:
                return any_were
            any_were = True
            if not done.set_running_or_notify_cancel():
                continue
            try:
                obey(order, now)
            except ValueError as error:
                done.set_exception(error)
            else:
                done.set_result(None)


def parse(kind: str, fields: Any) -> Order:
    """An order as JSON brings it.

    Args:
        kind: evict, readmit, start-pose, seek or play.
        fields: ``{"session": hex}``; or ``{"robot": id, "x_mm": int, "y_mm": int, "yaw_turn16": int}``; or
            ``{"seconds": number}``; or ``{"speed": number}``.

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
    if kind == "seek":
        return Seek(_number(fields, "seconds", sys.float_info.max))
    if kind == "play":
        return Play(_number(fields, "speed", MOST_SPEED))
    raise ValueError(f"{kind!r} is no order")


def _number(fields: dict[str, Any], name: str, most: float) -> float:
    """The only field, which is no less than 0."""
    value: Any = fields.get(name)
    if fields.keys() != {name} or type(value) not in {int, float} or not 0 <= value <= most:
        raise ValueError(f"expected {name}: a number from 0 to {most:g}")
    return float(value)
