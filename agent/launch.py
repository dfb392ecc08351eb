"""``orion demo`` and ``orion replay``: a configuration for a whole swarm on this machine, run to its end."""

from __future__ import annotations

import json
import math
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from agent.config import Config, resolve
from agent.errors import UserError
from agent.files import prepare_folder, write_whole
from agent.fleet import Fleet
from agent.links import check_ports
from agent.outputs import Outputs
from agent.progress import progress
from mapping.sensor import Sensor


def demo_config(base: Config, *, world: str, robots: int | None, speed: float | str, seed: int) -> Config:
    """Simulated robots at the world's starts; the roster of ``base`` if it has one.

    Raises:
        UserError: the world is bad, or has not so many starts.
    """
    from agent.world import load_world

    there = load_world(world)
    count = len(there.starts) if robots is None else robots
    if base.robots and robots is not None and robots != len(base.robots):
        raise UserError("--robots", f"is {robots}, but the file names {len(base.robots)}", "give one or the other")
    if base.robots:
        count = len(base.robots)
    if not 1 <= count <= len(there.starts):
        remedy = f"give 1 to {len(there.starts)}, or another --world"
        raise UserError("--robots", f"is {count}, but world {world!r} has {len(there.starts)} starts", remedy)
    table = base.model_dump(mode="json", exclude_none=True)
    roster: dict[str, Any] = {}
    for k, name in enumerate(base.roster or [f"r{k + 1}" for k in range(count)]):
        start = there.starts[k]
        truth = {"x": start.x, "y": start.y, "yaw_deg": round(math.degrees(start.yaw), 9)}
        body = {"kind": "serial", "port": f"{name}.tty", "waypoints": there.waypoints[k].tolist()}
        roster[name] = {"start": truth, **table.get("robots", {}).get(name, {}), "body": body}
    simulation = table["simulation"] | {"world": _absolute(world), "seed": seed, "speed": speed}
    return resolve(table | {"robots": roster, "simulation": simulation})


def replay_config(
    base: Config,
    recordings: Sequence[Path],
    *,
    robots: int | None,
    poses: str | None,
    max_range: float | None,
    speed: float | str,
) -> Config:
    """Recorded robots: the k-th recording is the k-th robot of the roster; one log may be cut into several robots.

    Raises:
        UserError: a recording is bad, or the numbers of recordings and robots do not fit.
    """
    from agent.playback import read, split

    bodies: list[dict[str, Any]] = []
    for path in recordings:
        found = read(path, poses=poses, max_range=max_range)
        _check_range(base, path, found[0].sensor)
        pieces = robots if robots is not None and len(recordings) == len(found) == 1 else 1
        split(found[0], pieces)
        options = {"poses": poses, "max_range": max_range}
        for k in range(len(found)):
            body = {"kind": "recording", "path": _in_a_file(path), "robot": k, "speed": speed, "parts": pieces}
            body |= {key: value for key, value in options.items() if value is not None}
            bodies += [body | {"part": part + 1} for part in range(pieces)]
    if robots is not None and robots != len(bodies):
        raise UserError("--robots", f"is {robots}, but the recordings hold {len(bodies)}", "leave the option out")
    if base.robots and len(base.robots) != len(bodies):
        remedy = "name a robot for each recording, in their order"
        raise UserError("robots", f"{len(base.robots)} in the file, but the recordings hold {len(bodies)}", remedy)
    table = base.model_dump(mode="json", exclude_none=True)
    roster: dict[str, Any] = {}
    for name, body in zip(base.roster or [f"r{k + 1}" for k in range(len(bodies))], bodies, strict=True):
        roster[name] = {"start": {}, **table.get("robots", {}).get(name, {}), "body": body}
    return resolve(table | {"robots": roster})


def _check_range(base: Config, path: Path, sensor: Sensor) -> None:
    try:
        base.rules().lattice.check_range(sensor.max_range_mm)
    except ValueError as error:
        raise UserError(path, str(error), "give a shorter --max-range or a larger --cell") from None


def _in_a_file(path: Path) -> str:
    """The absolute path, if a TOML can hold it."""
    text = str(path.absolute())
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UserError(path, "is no name in UTF-8, as the resolved configuration must have it", "rename it") from None
    return text


def _absolute(world: str) -> str:
    """A world's file wherever we are; a packaged world's name as it is."""
    return _in_a_file(Path(world)) if "/" in world or world.endswith((".yaml", ".yml")) else world


def launch(config: Config, out: Path, outputs: Outputs, *, simulated: bool, as_json: bool) -> bool:
    """Run a swarm on this machine to its end, and say what came of it; gives whether all agree.

    Args:
        config: the swarm.
        out: a folder for all that it writes.
        outputs: what else its observer makes of it; with a state, robots keep one there too.
        simulated: the world too, as the robots are not there without it.
        as_json: the result as one JSON object.

    Raises:
        UserError: the folder cannot be written, a port is occupied, or a process could not start.
    """
    import typer

    check_ports(config)
    folder = prepare_folder(out)
    write_whole(folder / "orion.toml", config.toml())

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    began = time.monotonic()
    interrupted = False
    with Fleet(config, folder, outputs) as fleet:
        try:
            fleet.start(simulated=simulated)
            with progress() as bars:
                settled = fleet.run(bars)
        except UserError:
            (folder / "orion.toml").unlink(missing_ok=True)  # nothing came of it
            raise
        except KeyboardInterrupt:
            interrupted, settled = True, False
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        seconds = time.monotonic() - began
        fleet.finish()
        summary = fleet.summary(settled=settled, seconds=seconds)
    text = json.dumps(summary)
    write_whole(folder / "summary.json", text.encode() + b"\n")
    if interrupted:
        typer.echo("orion: interrupted; the map so far is written", err=True)
    for line in _told(summary):
        typer.echo(line, err=as_json)
    if as_json:
        typer.echo(text)
    sys.stdout.flush()
    return bool(summary["converged"])


def _told(summary: dict[str, Any]) -> list[str]:
    """The result for a person."""
    lines = []
    for robot in summary["robots"]:
        if robot.get("lost"):
            lines.append(f"{robot['id']:>10}  LOST")
        else:
            sent = robot["bytes_sent"] / 1000
            facts = f"{robot['scans']} scans in {robot['updates']} updates, {sent:.1f} kB sent"
            lines.append(f"{robot['id']:>10}  {robot['map_digest']}  {facts}")
    if summary.get("simulation", {}).get("lost"):
        lines.append(f"{'simulation':>10}  LOST")
    observer = summary["observer"]
    if observer:
        known = f"{observer['tiles']} tiles, {observer['known_m2']:.2f} m2 known"
        lines.append(f"{'observer':>10}  {observer['map_digest']}  {known}")
    agreement = "all agree" if summary["converged"] else "NOT CONVERGED"
    lines.append(f"{agreement} after {summary['seconds']:.1f} s")
    if "png" in summary["files"]:
        lines.append(f"map: {summary['files']['png']}")
    return lines
