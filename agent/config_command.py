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

swarm = "{swarm}"                    # peers of other swarms on the same network are neither heard nor seen
# cell = 0.02                     # metres, whole millimetres; one for the swarm
# transport = "zenoh"             # the bus between peers
# base_port = 7450                # the k-th robot below listens on base_port + k
# radio = "lan"                   # what the network can carry
# publish = "auto"                # "scans" or "tiles" insist on one form

# [evidence]                      # what a reading is worth, nats of log-odds; one for the swarm
# occupied = 0.85
# free = -0.40
# limit = 0.0                     # 0: none. Touch it where the world changes while you map

# [simulation]                    # for orion simulate alone
# world = "paper"                 # a name, or a YAML of walls
# seed = 1
# speed = 1.0                     # times real time, or "max"
# ideal = false                   # true: no noise, no slip

# The robots. Start poses are in the common frame: metres, x forward, y left, degrees counter-clockwise. Measure them:
# the map is as good as they are. Without one a robot maps in its own frame, apart, until it is given one.
"""

_ROBOT = """
[robots.{robot}]
host = "127.0.0.1"                # as the others reach it
start = {{x = {x:.3f}, y = 0.0, yaw_deg = 0.0}}
body = {{kind = "serial", port = "{port}"}}   # or kind = "recording", path = "run.log.gz"
"""


def template(robots: int, *, swarm: str = "lab", port: str = "/dev/ttyACM0") -> str:
    """A commented configuration.

    Args:
        robots: how many; they are called r1, r2, ... and stand half a metre apart.
        swarm: its name.
        port: every robot's serial port.
    """
    tables = [_ROBOT.format(robot=f"r{k + 1}", x=0.5 * k, port=port) for k in range(robots)]
    return _HEAD.format(swarm=swarm) + "".join(tables)


@app.command(epilog="Example: orion config init lab.toml --robots 3")
def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The TOML to write; never one that is there.")] = Path(
        "orion.toml"
    ),
    robots: Annotated[int, typer.Option(metavar="N", min=1, max=1000, help="How many robots.")] = 2,
) -> None:
    """Write a commented configuration to edit."""
    if file.exists():
        raise UserError(file, "is there already", "give another name, or take it away")
    write_whole(file, template(robots).encode())
    typer.echo(
        f"{file}: {robots} robots. Measure their start poses and name their ports; then: orion config check {file}"
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
    return "\n".join(lines)
