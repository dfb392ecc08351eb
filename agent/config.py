"""The swarm's configuration: one TOML for all robots, overlaid by ``ORION_*`` variables, overlaid by options.

Laws kept here: everything is checked before anything starts; an unknown key names the nearest known one; the resolved
configuration can be written out and used again, and then means the same wherever it is used from.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from agent.errors import UserError
from agent.files import read_bytes
from agent.senses import NO_NOISE, ORION_NOISE, Noise
from mapping.evidence import EvidenceModel, to_units
from mapping.lattice import Lattice
from mapping.pose import Pose, QuantisedPose
from mapping.sensor import MAX_RANGE_LIMIT_MM, ORION_RANGE, Sensor, laser, orion, sensor
from swarm.session import ROBOT_ID, Rules
from transport.bus import is_name

Speed = Annotated[float, Field(gt=0, allow_inf_nan=False)] | Literal["max"]
Publish = Literal["auto", "scans", "tiles"]
_Degrees = Annotated[float, Field(ge=-36_000, le=36_000)]
_Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
_Range = Annotated[float, Field(gt=0, le=MAX_RANGE_LIMIT_MM / 1000)]

_ENVIRONMENT = ("swarm", "cell", "transport", "base_port", "radio", "publish")
"""What ``ORION_SWARM``, ``ORION_CELL`` ... may set."""

_HOST = re.compile(r"[A-Za-z0-9._-]{1,253}|(?=[^:]*:[^:]*:)[0-9A-Fa-f:.]+(%[A-Za-z0-9._-]+)?")
"""A name, an IPv4 address, or an IPv6 address; nothing that an endpoint could take for its own punctuation."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Start(_Table):
    """A robot's start pose in the common frame; metres and degrees."""

    x: float = Field(0.0, ge=-8e5, le=8e5)
    y: float = Field(0.0, ge=-8e5, le=8e5)
    yaw_deg: _Degrees = 0.0

    def quantised(self) -> QuantisedPose:
        """As descriptors carry it."""
        return QuantisedPose.of(Pose(self.x, self.y, math.radians(self.yaw_deg)))


def start_of(x: float, y: float, yaw_deg: float) -> QuantisedPose:
    """A start pose given on the command line; metres and degrees.

    Raises:
        UserError: with the option and the remedy.
    """
    try:
        return Start(x=x, y=y, yaw_deg=yaw_deg).quantised()
    except ValidationError as error:
        first = error.errors()[0]
        option = f"--{first['loc'][0]}".replace("_", "-")
        raise UserError(option, f"{first['msg'][:1].lower()}{first['msg'][1:]}", "mend this value") from None


class SerialBody(_Table):
    """A robot behind a serial port: a real one, or one of ``orion simulate``."""

    kind: Literal["serial"]
    port: str = Field(min_length=1, description="a device, a pseudo-terminal, or a URL as pyserial takes it")
    baudrate: int = Field(115_200, ge=300, le=4_000_000)
    max_range: _Range = ORION_RANGE
    drive: bool = Field(True, description="whether the agent drives; without waypoints to the nearest frontier")
    waypoints: list[tuple[_Metres, _Metres]] = Field(default_factory=list, description="x, y in the common frame")


class RecordedBody(_Table):
    """A body that plays back a recording."""

    kind: Literal["recording"]
    path: str
    robot: int = Field(0, ge=0, description="which of the recording's robots")
    part: int = Field(1, ge=1, description="which piece of a log that is cut")
    parts: int = Field(1, ge=1, description="into how many pieces of equal path")
    poses: Literal["truth", "odometry", "slam"] | None = None
    max_range: _Range | None = None
    speed: Speed = 1.0


class LogBody(_Table):
    """The robot as a log has it: its recorded sessions, said again."""

    kind: Literal["log"]
    path: str
    speed: Speed = 1.0


def _robot_id(name: str) -> str:
    if not ROBOT_ID.fullmatch(name):
        raise ValueError("a robot id is 1 to 32 letters, digits, - or _, and begins with a letter or digit")
    if name == "observer":
        raise ValueError("no robot is called observer: that is the peer without a body")
    return name


def _host(host: str) -> str:
    if not _HOST.fullmatch(host):
        raise ValueError("a host is a name or an address, without port and brackets")
    return host


def _swarm_name(name: str) -> str:
    if not is_name(name):
        raise ValueError("a swarm's name is 1 to 64 letters, digits, ., _ or -")
    return name


RobotId = Annotated[str, AfterValidator(_robot_id)]


class Robot(_Table):
    """One robot of the roster."""

    host: Annotated[str, AfterValidator(_host)] = "127.0.0.1"
    start: Start | None = None
    publish: Publish | None = None
    body: Annotated[SerialBody | RecordedBody | LogBody, Field(discriminator="kind")] | None = None


class Station(_Table):
    """An observer that others can find: it listens, so it keeps the swarm together when no robot is left."""

    host: Annotated[str, AfterValidator(_host)] = "127.0.0.1"


class Evidence(_Table):
    """What a reading is worth, in nats."""

    occupied: float = Field(0.85, gt=0, le=100)
    free: float = Field(-0.40, lt=0, ge=-100)
    limit: float = Field(0.0, ge=0, le=100)


class OrionSensor(_Table):
    """The paper's five beams."""

    kind: Literal["orion"] = "orion"
    max_range: _Range = ORION_RANGE
    view_deg: float = Field(0.0, ge=0, le=180, description="each beam's field of view; a VL53L0X has 25, the paper 0")

    def build(self) -> Sensor:
        """The sensor."""
        return orion(self.max_range, view=math.radians(self.view_deg))


class LaserSensor(_Table):
    """Evenly spaced beams from the robot's centre."""

    kind: Literal["laser"]
    beams: int = Field(ge=1, le=4096)
    first_deg: _Degrees
    step_deg: _Degrees
    max_range: _Range = 20.0

    def build(self) -> Sensor:
        """The sensor."""
        return laser(
            self.beams,
            first=math.radians(self.first_deg),
            step=math.radians(self.step_deg),
            max_range=self.max_range,
        )


class BeamTable(_Table):
    """Where one beam starts on the robot, metres, and where it looks, degrees from forward."""

    x: float = Field(0.0, ge=-32, le=32)
    y: float = Field(0.0, ge=-32, le=32)
    bearing_deg: _Degrees


class BeamsSensor(_Table):
    """Any table of beams."""

    kind: Literal["beams"]
    beams: list[BeamTable] = Field(min_length=1, max_length=4096)
    max_range: _Range

    def build(self) -> Sensor:
        """The sensor."""
        return sensor([(beam.x, beam.y, math.radians(beam.bearing_deg)) for beam in self.beams], self.max_range)


class SimulatedNoise(_Table):
    """What is wrong with simulated senses and wheels; see ``agent.senses.Noise``. Metres, seconds and degrees."""

    range_floor: float = Field(ORION_NOISE.range_floor, ge=0)
    range_share: float = Field(ORION_NOISE.range_share, ge=0)
    range_minimum: float = Field(ORION_NOISE.range_minimum, ge=0)
    dropout: float = Field(ORION_NOISE.dropout, ge=0, le=1)
    heading_deg: float = Field(0.2, ge=0)
    heading_drift_deg: float = Field(0.3, ge=0)
    heading_drift_time: float = Field(ORION_NOISE.heading_drift_time, gt=0)
    slip: float = Field(ORION_NOISE.slip, ge=0, lt=1)
    slip_walk: float = Field(ORION_NOISE.slip_walk, ge=0)

    def build(self) -> Noise:
        """The noise."""
        return Noise(
            heading=math.radians(self.heading_deg),
            heading_drift=math.radians(self.heading_drift_deg),
            **self.model_dump(exclude={"heading_deg", "heading_drift_deg"}),
        )


class Simulation(_Table):
    """The world that ``orion simulate`` is."""

    world: str = "paper"
    seed: int = Field(1, ge=0)
    speed: Speed = 1.0
    ideal: bool = False
    noise: SimulatedNoise = SimulatedNoise()

    def build_noise(self) -> Noise:
        """The noise, or none."""
        return NO_NOISE if self.ideal else self.noise.build()


class Config(_Table):
    """The whole swarm."""

    swarm: Annotated[str, AfterValidator(_swarm_name)] = "orion"
    cell: float = Field(0.02, gt=0)
    transport: Literal["zenoh", "zmq"] = "zenoh"
    base_port: int = Field(7450, ge=1, le=65535)
    radio: Literal["lan", "digimesh-1hop", "digimesh-3hop", "digimesh-6hop"] = "lan"
    publish: Publish = "auto"
    evidence: Evidence = Evidence()
    sensor: Annotated[OrionSensor | LaserSensor | BeamsSensor, Field(discriminator="kind")] = OrionSensor()
    simulation: Simulation = Simulation()
    robots: dict[RobotId, Robot] = Field(default_factory=dict)
    observers: dict[RobotId, Station] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _values_fit(self) -> Config:
        self.rules().lattice.check_range(self.sensor.build().max_range_mm)
        if both := self.robots.keys() & self.observers.keys():
            raise ValueError(f"observers: {min(both)} is a robot's name")
        if self.base_port + len(self.hosts) - 1 > 65535:
            raise ValueError(f"base_port: {self.base_port} leaves no ports for {len(self.hosts)} peers")
        return self

    def rules(self) -> Rules:
        """The lattice and the evidence model."""
        model = EvidenceModel(
            to_units(self.evidence.occupied), to_units(self.evidence.free), to_units(self.evidence.limit)
        )
        return Rules(Lattice.of(self.cell), model)

    @property
    def roster(self) -> list[str]:
        """Robot ids in the file's order, which also numbers their ports."""
        return list(self.robots)

    @property
    def listeners(self) -> list[str]:
        """Who listens: the k-th on ``base_port + k``. The robots, then the observers that have a table."""
        return [*self.robots, *self.observers]

    @property
    def hosts(self) -> list[str]:
        """Where the listeners are, in the same order."""
        return [robot.host for robot in self.robots.values()] + [station.host for station in self.observers.values()]

    def toml(self) -> bytes:
        """The resolved configuration as a file."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True)).encode()


def load(path: Path | None, options: Mapping[str, Any], environment: Mapping[str, str] = os.environ) -> Config:
    """The configuration of a command.

    Args:
        path: the swarm's TOML, if one was given.
        options: keys given on the command line; None is not given.
        environment: where ``ORION_*`` are looked up.

    Raises:
        UserError: with the file, the key and the remedy.
    """
    table: dict[str, Any] = {}
    if path is not None:
        try:
            table = tomllib.loads(read_bytes(path).decode())
        except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, a number or a nesting without end
            raise UserError(
                path, f"is no TOML: {error}", "mend that line; each robot and key may appear once"
            ) from None
        _anchor(table, path.parent)
    sources = dict.fromkeys(table, str(path))
    for key in _ENVIRONMENT:
        if (value := environment.get(f"ORION_{key.upper()}")) is not None:
            table[key] = value
            sources[key] = f"ORION_{key.upper()}"
    for key, value in options.items():
        if value is not None:
            table[key] = value
            sources[key] = f"--{key.replace('_', '-')}"
    return resolve(table, lambda key: sources.get(key, str(path or "configuration")))


def resolve(table: Mapping[str, Any], source: Any = lambda key: "configuration") -> Config:
    """Check a configuration.

    Args:
        table: as TOML gives it.
        source: tells of a top-level key where it was set.

    Raises:
        UserError: the first complaint, with the key and the remedy.
    """
    try:
        return Config.model_validate(table)
    except ValidationError as error:
        raise _complaint(error, source) from None


_PATHS: dict[str, Callable[[str], bool]] = {
    "path": lambda value: True,
    "world": lambda value: "/" in value or value.endswith((".yaml", ".yml")),  # else one that is packaged
    "port": lambda value: bool(value) and "://" not in value,  # else a URL, or nothing
}


def _anchor(table: dict[str, Any], folder: Path) -> None:
    """Paths in a file are relative to that file."""
    robots = table.get("robots")
    bodies = (
        [robot.get("body") for robot in robots.values() if isinstance(robot, dict)] if isinstance(robots, dict) else []
    )
    for body in [*bodies, table.get("simulation")]:
        if not isinstance(body, dict):
            continue
        for key, is_path in _PATHS.items():
            value = body.get(key)
            if isinstance(value, str) and is_path(value):
                body[key] = str((folder / value).absolute())


def _complaint(error: ValidationError, source: Any) -> UserError:
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")  # a misspelt key also leaves one missing
    path = [str(part) for part in _keys(first["loc"])]
    key = ".".join(path)
    where = f"{source(path[0])}: {key}" if path else str(source(""))
    if first["type"] == "extra_forbidden":
        known = sorted(_known_keys(first["loc"]))
        near = difflib.get_close_matches(path[-1], known, 1)
        remedy = f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}"
        return UserError(where, "is no key of the configuration", remedy)
    if first["type"] in {"union_tag_not_found", "union_tag_invalid"}:
        what = f"{first['ctx']['tag']!r} is unknown" if "tag" in first["ctx"] else "is missing"
        kinds = "orion, laser or beams" if path == ["sensor"] else "serial, recording or log"
        return UserError(f"{where}.kind", what, f"give {kinds}")
    what = first["msg"].removeprefix("Value error, ")
    what = what[:1].lower() + what[1:]
    given = first.get("input")
    if isinstance(given, str | int | float):
        what += f", got {given!r}"
    return UserError(where, what, "mend this value")


def _keys(location: tuple[int | str, ...]) -> list[int | str]:
    """Where an error is, as keys of the file: pydantic puts in the kind of a sensor or body, and what is a key."""
    keys = list(location)
    tag = {"sensor": 1, "robots": 3}.get(str(keys[0]) if keys else "")
    if tag is not None and len(keys) > tag and (tag == 1 or keys[2] == "body"):
        del keys[tag]
    return [key for key in keys if key != "[key]"]


def _known_keys(location: tuple[int | str, ...]) -> set[str]:
    """The keys of the table in which an unknown one was found."""
    kinds: dict[object, type[BaseModel]] = {
        "serial": SerialBody,
        "recording": RecordedBody,
        "log": LogBody,
        "orion": OrionSensor,
        "laser": LaserSensor,
        "beams": BeamsSensor,
    }
    table: type[BaseModel]
    match location[:-1]:
        case ("evidence",):
            table = Evidence
        case ("simulation",):
            table = Simulation
        case ("simulation", "noise"):
            table = SimulatedNoise
        case ("sensor", kind) | ("robots", _, "body", kind):
            table = kinds[kind]
        case ("sensor", *_):
            table = BeamTable
        case ("robots", _, "start"):
            table = Start
        case ("robots", _):
            table = Robot
        case ("observers", _):
            table = Station
        case _:
            table = Config
    return set(table.model_fields)
