"""``orion start-pose`` and ``orion evict``: an operator joins the swarm, decides, and sees that everybody knows.

Laws kept here: nothing is decided before it is known what is in force, so that a decision supersedes it; a peer counts
as knowing only if it said so itself; whoever did not in time is named, and learns it from the others all the same.
"""

from __future__ import annotations

import getpass
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from agent.config import Config
from agent.errors import UserError
from agent.links import open_bus
from agent.node import SOFTWARE
from mapping.pose import QuantisedPose
from swarm.drops import Drop
from swarm.messages import AskControls, Control, Digest, Hello, decode, encode
from swarm.peer import Peer
from swarm.session import Descriptor, Rules, SessionId
from transport.bus import Bus, Joined, Left, Message

MEETING = 5.0
"""Seconds in which everybody who is there tells what is in force. After them it is decided with what is known."""

HOLDING = 10.0
"""Seconds in which everybody who is there should know what was decided."""

_ASK_AGAIN = 0.5
_TURN = 0.02


class NobodyError(Exception):
    """There is no swarm."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided and who knows it.

    Attributes:
        before: the record that was in force, if there was one.
        control: the record that is in force now.
        held_by: the peers that are known to hold it, by name.
        missing: those that are there and did not say so in time.
    """

    before: Control | None
    control: Control
    held_by: list[str]
    missing: list[str]

    @property
    def known_to_all(self) -> bool:
        """Whether everybody who is there holds it."""
        return not self.missing


class Operator:
    """A peer that comes to decide something and goes again.

    Args:
        bus: the swarm's.
        rules: the swarm's.
        monotonic: seconds.

    Attributes:
        peer: what it knows of the swarm.
    """

    def __init__(self, bus: Bus, rules: Rules, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._bus = bus
        self._clock = monotonic
        self._around: set[str] = set()
        self._checks: dict[str, int] = {}  # of the control records that each peer said it has
        self._records: dict[str, Control] = {}  # about the subject in question, as each peer has it
        self._sessions: set[SessionId] = set()  # that anybody spoke of
        name = _user()
        hello = Hello(Hello.OBSERVER, b"operator", SOFTWARE)
        self.peer = Peer(hello, rules, seed=bus.peer.encode(), mtu=bus.mtu, now=monotonic(), issuer=name.encode()[:8])

    @classmethod
    def met(cls, bus: Bus, rules: Rules, monotonic: Callable[[], float] = time.monotonic) -> Self:
        """An operator who knows who is there, which sessions there are, and what is in force.

        Raises:
            NobodyError: there is nobody.
        """
        operator = cls(bus, rules, monotonic)
        operator._until(lambda: operator._is_in_the_know, MEETING)
        if not operator._around:
            raise NobodyError
        return operator

    @property
    def _is_in_the_know(self) -> bool:
        told = self._around & self._checks.keys()
        return (
            bool(self._around)
            and told == self._around
            and all(self._checks[peer] == self.peer.controls.check for peer in told)
            and self._sessions <= self.peer.descriptors.keys()
        )

    def decide(self, setting: int, subject: bytes, issue: Callable[[float], None]) -> Decision:
        """Have a record in force everywhere.

        Args:
            setting: of the record.
            subject: of the record.
            issue: issues it, at a time; again, if somebody decides otherwise meanwhile.
        """
        before = self.peer.controls.get(setting, subject)
        issue(self._clock())
        value = self._in_force(setting, subject).value
        ask_at = self._clock() + _ASK_AGAIN

        def everybody_holds_it() -> bool:
            nonlocal ask_at
            if self._in_force(setting, subject).value != value:  # one that we had not heard of is stronger
                issue(self._clock())
            missing = self._missing(self._in_force(setting, subject))
            if self._clock() >= ask_at:
                ask_at += _ASK_AGAIN
                for peer in missing:
                    self._bus.send(peer, encode(AskControls(0)))
            return not missing

        self._until(everybody_holds_it, HOLDING)
        control = self._in_force(setting, subject)
        missing = self._missing(control)
        return Decision(before, control, self._names(self._around - missing), self._names(missing))

    def _in_force(self, setting: int, subject: bytes) -> Control:
        """The record about a subject of which there is one."""
        control = self.peer.controls.get(setting, subject)
        assert control is not None
        return control

    def _missing(self, control: Control) -> set[str]:
        """Who is there and has not said that it holds a record."""
        check = self.peer.controls.check
        return {peer for peer in self._around if self._checks.get(peer) != check and self._records.get(peer) != control}

    def _names(self, peers: set[str]) -> list[str]:
        """Peers as a person knows them."""
        return sorted(
            self.peer.peers[peer].name.decode("latin-1") if peer in self.peer.peers else peer for peer in peers
        )

    def is_here(self, robot: str) -> bool:
        """Whether a robot is there, so that it will act on what was decided."""
        return any(
            hello.role == Hello.ROBOT and hello.name == robot.encode()
            for peer, hello in self.peer.peers.items()
            if peer in self._around
        )

    # --- the loop

    def _until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Listen and speak until something is so, or the time is over; gives whether it is so."""
        deadline = self._clock() + seconds
        while not (reached := condition()) and self._clock() < deadline:
            for event in self._bus.receive(_TURN):
                match event:
                    case Message(sender, payload):
                        self._note(sender, payload)
                        self.peer.receive(sender, payload, self._clock())
                    case Joined(name):
                        self._around.add(name)
                        self.peer.joined(name, self._clock())
                    case Left(name):
                        self._around.discard(name)
                        self.peer.left(name, self._clock())
            for to, topic, payload in self.peer.poll(self._clock()):
                if to is None:
                    self._bus.publish(topic, payload)
                else:
                    self._bus.send(to, payload)
        return reached

    def _note(self, sender: str, payload: bytes) -> None:
        """Remember what a peer itself said of sessions and records."""
        try:
            message = decode(payload)
        except Drop:
            return
        match message:
            case Digest():
                self._checks[sender] = message.controls
                self._sessions |= message.positions().keys()
            case Control():
                self._records[sender] = message
            case _:
                pass


def _user() -> str:
    """Who decides, for those who ask later."""
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):  # no name for this user id
        return "operator"


# --- what is decided


def set_start_pose(operator: Operator, config: Config, robot: str, pose: QuantisedPose) -> dict[str, Any]:
    """Tell everybody where a robot started; gives what changed.

    Raises:
        UserError: nobody knows that robot.
    """
    peer = operator.peer
    known = sorted({*config.roster, *(descriptor.robot for descriptor in peer.descriptors.values())})
    if robot not in known:
        raise UserError("ROBOT", f"{robot!r} is unknown", f"robots there are: {', '.join(known) or 'none'}")
    recorded = peer.controls.start_pose(robot)
    settings = config.robots.get(robot)
    configured = settings.start.quantised() if settings is not None and settings.start is not None else None
    before = configured if recorded is None else recorded.pose
    decision = operator.decide(Control.START_POSE, robot.encode(), lambda now: peer.set_start_pose(robot, pose, now))
    return {
        "robot": robot,
        "start": _start(pose),
        "before": None if before is None else _start(before),
        "pending": not operator.is_here(robot),
        **_known(decision),
    }


def evict(operator: Operator, name: str, *, readmit: bool) -> dict[str, Any]:
    """Take a session out of the sum everywhere, or back into it; gives what changed.

    Args:
        operator: who decides.
        name: the session's id, the beginning of one, or a robot that has only one.
        readmit: back into it.

    Raises:
        UserError: there is no such session, or more than one.
    """
    descriptor = chosen(operator.peer, name, readmit=readmit)
    session = descriptor.session
    issue = operator.peer.readmit if readmit else operator.peer.evict
    was_out = session in operator.peer.controls.evicted
    decision = operator.decide(Control.EVICT, session, lambda now: issue(session, now))
    return {
        "robot": descriptor.robot,
        "session": session.hex(),
        "evicted": not readmit,
        "changed": was_out == readmit,
        **_known(decision),
    }


def chosen(peer: Peer, name: str, *, readmit: bool) -> Descriptor:
    """The session that a person means: by its id, by the beginning of one, or by its robot.

    A robot stands for the one session of its that is in the sum, or out of it when it is to be readmitted.

    Raises:
        UserError: there is none, or more than one.
    """
    there = [descriptor for session, descriptor in peer.descriptors.items() if session not in peer.replaced]
    evicted = peer.controls.evicted
    of_robot = [each for each in there if each.robot == name]
    found = [each for each in of_robot if (each.session in evicted) == readmit] or of_robot
    if not found:
        found = [each for each in there if each.session.hex().startswith(name.lower())] if name else []
    if len(found) == 1:
        return found[0]
    states = {True: ", evicted", False: ""}
    listed = sorted(f"{each.session.hex()} ({each.robot}{states[each.session in evicted]})" for each in found or there)
    what = f"{name!r} is no session or robot" if not found else f"{name!r} means {len(found)} sessions"
    raise UserError("SESSION", what, f"give one of {', '.join(listed)}" if listed else "there are no sessions")


def _start(pose: QuantisedPose) -> dict[str, float]:
    degrees = pose.yaw_turn16 / 65536 * 360
    return {"x": pose.x_mm / 1000, "y": pose.y_mm / 1000, "yaw_deg": round(degrees - 360 * (degrees > 180), 4)}


def _known(decision: Decision) -> dict[str, Any]:
    return {"known_to_all": decision.known_to_all, "held_by": decision.held_by, "missing": decision.missing}


# --- commands


def operate(config: Config, work: Callable[[Operator], dict[str, Any]]) -> dict[str, Any]:
    """Join the swarm and decide something.

    Raises:
        UserError: there is nobody to be met in the configuration, or what is asked for makes no sense.
        NobodyError: nobody is there.
    """
    if not config.robots:
        raise UserError("robots", "none in the configuration, so there is nobody to tell", "give the swarm's TOML: -c")
    with open_bus(config, "operator") as bus:
        return work(Operator.met(bus, config.rules()))


def in_words(result: dict[str, Any]) -> list[str]:
    """What changed, for a person: a line each."""
    if "start" in result:
        lines = [f"{result['robot']} starts at {_place(result['start'])}; before: {_place(result['before'])}"]
        if result["pending"]:
            lines.append(f"{result['robot']} is not here: its map is put right when it comes back")
    else:
        done = "evicted" if result["evicted"] else "readmitted"
        again = "" if result["changed"] else " (as it was before)"
        lines = [f"session {result['session']} of {result['robot']} is {done}{again}"]
    lines.append(f"known to {', '.join(result['held_by']) or 'nobody'}")
    if result["missing"]:
        lines.append(f"not confirmed by {', '.join(result['missing'])}: they learn it from the others")
    return lines


def _place(start: dict[str, float] | None) -> str:
    return "unknown" if start is None else f"x = {start['x']:g} m, y = {start['y']:g} m, yaw = {start['yaw_deg']:g} deg"
