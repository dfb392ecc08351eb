"""``orion config``: write a swarm's configuration to begin with, and say what one means before anything starts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.errors import UserError
from agent.files import write_whole

if TYPE_CHECKING:
    from agent.config import Config

app = typer.Typer(no_args_is_help=True, help="The swarm's configuration: write one, check one.")

_HEAD = """\
# The configuration of one swarm: the same file on every robot and for every observer.
# Settings behind "# " are the defaults. Options, and variables such as ORION_CELL=0.05, go before the file.

swarm = "lab"                     # peers of other swarms on the same network are neither heard nor seen
# cell = 0.02                     # metres, whole millimetres; one for the swarm
# transport = "zenoh"             # the bus between peers
# base_port = 7450                # the k-th robot below listens on base_port + k
# radio = "lan"                   # what the network can carry
# publish = "auto"                # "scans" or "tiles" insist on one form

# [evidence]                      # what a reading is worth, nats of log-odds; one for the swarm
# occupied = 0.85
# free = -0.40
# limit = 0.0                     # 0: none. Touch it where the world changes while you map

{simulation}
# [observers.base]                # one that others find, though no robot is left: orion observe -c FILE --name base
# host = "127.0.0.1"

# The robots. Start poses are in the common frame: metres, x forward, y left, degrees counter-clockwise. Measure them:
# the map is as good as they are. Without one a robot maps in its own frame, apart, until it is given one.
"""

_NO_SIMULATION = """\
# [simulation]                    # for orion simulate alone
# world = "paper"                 # a name, or a YAML of walls
# seed = 1
# speed = 1.0                     # times real time, or "max"
# ideal = false                   # true: no noise, no slip
"""

_SIMULATION = """\
[simulation]                      # for orion simulate alone
world = {world}
speed = 10.0                      # times real time, or "max"
"""

_ROBOT = """
[robots.{robot}]
host = "127.0.0.1"                # as the others reach it
start = {{x = {x:.3f}, y = {y:.3f}, yaw_deg = {yaw_deg:.1f}}}
body = {{kind = "serial", port = "{port}"}}   # or kind = "recording", path = "run.log.gz"
"""


def template(robots: int) -> str:
    """A commented configuration of so many robots, r1, r2, ..., that stand half a metre apart."""
    tables = [
        _ROBOT.format(robot=f"r{k + 1}", x=0.5 * k, y=0.0, yaw_deg=0.0, port="/dev/ttyACM0") for k in range(robots)
    ]
    return _HEAD.format(simulation=_NO_SIMULATION) + "".join(tables)


def simulated_template(world: str, robots: int | None) -> str:
    """A commented configuration for ``orion simulate``: robots r1, r2, ... at the world's starts.

    Args:
        world: a packaged one's name, or a YAML of walls.
        robots: how many, or None for one at each start.

    Raises:
        UserError: the world is bad, or has not so many starts.
    """
    from agent.config import Config
    from agent.launch import demo_config

    config = demo_config(Config(), world=world, robots=robots, speed=10.0, seed=1)
    tables = [
        _ROBOT.format(robot=name, port=f"{name}.tty", **robot.start.model_dump())
        for name, robot in config.robots.items()
        if robot.start is not None
    ]
    simulation = _SIMULATION.format(world=json.dumps(config.simulation.world, ensure_ascii=False))
    return _HEAD.format(simulation=simulation) + "".join(tables)


@app.command(epilog="Examples: orion config init lab.toml --robots 3    orion config init lab.toml --world paper")
def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The TOML to write; never one that is there.")] = Path(
        "orion.toml"
    ),
    robots: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=1000, help="How many: 2, or as the world has starts.")
    ] = None,
    world: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="For orion simulate: robots at the starts of that world.")
    ] = None,
) -> None:
    """Write a commented configuration to edit, or one for a simulated world, to run as it is."""
    if file.exists():
        raise UserError(file, "is there already", "give another name, or take it away")
    if world is not None:
        write_whole(file, simulated_template(world, robots).encode())
        typer.echo(f"{file}: the robots of world {world}. Next: orion simulate -c {file}")
        return
    count = 2 if robots is None else robots
    write_whole(file, template(count).encode())
    typer.echo(
        f"{file}: {count} robots. Measure their start poses and name their ports; then: orion config check {file}"
    )


@app.command(epilog="Example: orion config check lab.toml")
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The swarm's TOML.")],
    as_json: Annotated[bool, typer.Option("--json", help="The resolved configuration as one JSON object.")] = False,
) -> None:
    """Say what a configuration means, defaults and ORION_* variables included; exit with 2 if it is none."""
    from agent.config import load

    config = load(file, {})
    typer.echo(json.dumps(config.model_dump(mode="json")) if as_json else told(config))


def told(config: Config) -> str:
    """A configuration for a person: one line for the swarm, one a robot."""
    lines = [f"swarm {config.swarm}: cells of {config.cell:g} m over {config.transport} ({config.radio})"]
    for k, (name, robot) in enumerate(config.robots.items()):
        start = robot.start
        where = f"starts at ({start.x:g}, {start.y:g}) m, {start.yaw_deg:g} deg" if start else "has no start pose"
        body = "has no body" if robot.body is None else f"{robot.body.kind} body"
        lines.append(f"{name:>10}  {robot.host}:{config.base_port + k}  {where}, {body}")
    for k, (name, station) in enumerate(config.observers.items(), len(config.robots)):
        lines.append(f"{name:>10}  {station.host}:{config.base_port + k}  observer")
    return "\n".join(lines)
