"""The command line: ``orion``. The only place that prints an error and picks an exit status.

0 is success, 2 bad usage or configuration, 1 failure (a swarm that does not agree included).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from agent.errors import UserError
from agent.map_command import app as map_app

_SWITCH_INTERVAL = 0.0005
"""Seconds. With Python's 5 ms a loop that is busy mapping keeps what comes in waiting: p50 3.5 ms instead of 0.8."""

app = typer.Typer(
    name="orion",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="One command a robot, one map for the swarm: the same, bit for bit, on every peer, without a server.",
)
app.add_typer(map_app, name="map")

ConfigFile = Annotated[Path | None, typer.Option("-c", "--config", metavar="FILE", help="The swarm's TOML.")]
Cell = Annotated[float | None, typer.Option(metavar="M", help="Cell size in metres, whole millimetres.")]
SpeedOption = Annotated[str, typer.Option(metavar="X|max", help="Times real time, or max.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the map and the resolved configuration go.")]
BasePort = Annotated[int | None, typer.Option(metavar="P", help="Robot k listens on P + k (default 7450).")]
Transport = Annotated[str | None, typer.Option(help="The bus between peers: zenoh.")]
Radio = Annotated[str | None, typer.Option(metavar="PROFILE", help="What the network can carry: lan.")]
PublishOption = Annotated[str | None, typer.Option(metavar="FORM", help="auto, scans or tiles.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object as the last line of stdout.")]
SupervisedOption = Annotated[bool, typer.Option("--supervised", hidden=True)]


@app.command(epilog="Examples: orion demo    orion demo --world rooms --robots 4 --speed max --json")
def demo(
    config: ConfigFile = None,
    robots: Annotated[
        int | None, typer.Option(metavar="N", help="How many; by default as the world has starts.")
    ] = None,
    cell: Cell = None,
    speed: SpeedOption = "10",
    world: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="paper, rooms, office, or a YAML of walls.")
    ] = "paper",
    seed: Annotated[int, typer.Option(min=0, help="Decides the sensors' noise.")] = 1,
    publish: PublishOption = None,
    transport: Transport = None,
    radio: Radio = None,
    base_port: BasePort = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Simulated robots, each its own process, and an observer map a world together; ends by itself."""
    from agent.config import load
    from agent.launch import demo_config, launch

    options = _swarm_options(cell, publish, transport, radio, base_port)
    base = load(config, options)
    resolved = demo_config(base, world=world, robots=robots, speed=_speed(speed), seed=seed)
    raise typer.Exit(0 if launch(resolved, out, simulated=True, as_json=as_json) else 1)


@app.command(
    epilog="Examples: orion replay run.log.gz --robots 3 --cell 0.05    orion replay r1.log r2.log -c lab.toml"
)
def replay(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="CARMEN logs, one a robot, or nano_swarm folders.")
    ],
    config: ConfigFile = None,
    robots: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Cut one log into N robots at equal path.")
    ] = None,
    cell: Cell = None,
    max_range: Annotated[
        float | None, typer.Option(metavar="M", help="Readings beyond it free their ray up to it.")
    ] = None,
    poses: Annotated[str | None, typer.Option(metavar="WHICH", help="truth, odometry or slam.")] = None,
    speed: SpeedOption = "max",
    publish: PublishOption = None,
    transport: Transport = None,
    radio: Radio = None,
    base_port: BasePort = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Recorded robots, each its own process, and an observer map together what they once saw."""
    from agent.config import load
    from agent.launch import launch, replay_config

    options = _swarm_options(cell, publish, transport, radio, base_port)
    base = load(config, options)
    resolved = replay_config(base, recordings, robots=robots, poses=poses, max_range=max_range, speed=_speed(speed))
    raise typer.Exit(0 if launch(resolved, out, simulated=False, as_json=as_json) else 1)


@app.command(epilog="Example: orion agent -c lab.toml --robot r1")
def agent(
    config: Annotated[Path, typer.Option("-c", "--config", metavar="FILE", help="The swarm's TOML.")],
    robot: Annotated[str, typer.Option(metavar="ID", help="Which robot of the roster this is.")],
    as_json: AsJson = False,
    supervised: SupervisedOption = False,
) -> None:
    """One robot: its body, its session, its copy of the map. Runs until Ctrl-C."""
    from agent.config import load
    from agent.robot import run_robot

    _work(lambda control: run_robot(load(config, {}), robot, control), as_json=as_json, supervised=supervised)


@app.command(epilog="Example: orion observe -c lab.toml --out map/")
def observe(
    config: ConfigFile = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Where the map is written at the end.")] = None,
    scans: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Where the scans that came by are written at the end.")
    ] = None,
    as_json: AsJson = False,
    supervised: SupervisedOption = False,
) -> None:
    """A peer without a body: follows the swarm until Ctrl-C, then writes the map."""
    from agent.config import load
    from agent.files import prepare_folder
    from agent.observer import run_observer

    def work(control: Any) -> dict[str, Any]:
        swarm = load(config, {})
        return run_observer(swarm, None if out is None else prepare_folder(out), control, scans)

    _work(work, as_json=as_json, supervised=supervised)


@app.command(epilog="Example: orion simulate -c lab.toml, and in other terminals orion agent -c lab.toml --robot r1")
def simulate(
    config: Annotated[Path, typer.Option("-c", "--config", metavar="FILE", help="The swarm's TOML.")],
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Where the robots' true ways are written at the end.")
    ] = None,
    as_json: AsJson = False,
    supervised: SupervisedOption = False,
) -> None:
    """The world and the bodies of all robots, each behind a serial port r1.tty beside the TOML. Runs until Ctrl-C."""
    from agent.config import load
    from agent.emulator import run_simulation

    _work(
        lambda control: run_simulation(load(config, {}), config.absolute().parent, control, truth),
        as_json=as_json,
        supervised=supervised,
    )


@app.command(epilog="Example: orion paper --out report/")
def paper(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where figures, tables and runs go.")] = Path("paper"),
    seed: Annotated[int, typer.Option(min=0, help="Decides the sensors' noise.")] = 1,
    base_port: BasePort = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Default odometry only: all figures, a shorter table.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Do the paper's experiments again: its figures, and a table of its pipeline beside ours."""
    from agent.config import load
    from agent.paper_report import report

    def say(line: str) -> None:
        if sys.stderr.isatty():
            typer.echo(line, err=True)

    found = report(load(None, {"base_port": base_port}), out, seed, say, quick=quick)
    typer.echo(json.dumps(found) if as_json else f"{found['table']}\ntable and figures: {found['folder']}")


def _work(work: Any, *, as_json: bool, supervised: bool) -> None:
    """Run one process of a swarm, for a person or for the command that started it."""
    from agent.control import Control, Supervised
    from agent.kernel import Compilation

    sys.setswitchinterval(_SWITCH_INTERVAL)
    if supervised:
        control: Control = Supervised()
        try:
            control.tell("report", **work(control))
        except UserError as error:
            control.tell("error", where=error.where, what=error.what, remedy=error.remedy)
            raise typer.Exit(2) from None
        return
    with Compilation() as compilation:
        control = Control(compilation)
        control.obey_signals()
        summary = work(control)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        for key, value in summary.items():
            typer.echo(f"{key:>12}  {value}")


def _swarm_options(
    cell: float | None, publish: str | None, transport: str | None, radio: str | None, base_port: int | None
) -> dict[str, Any]:
    return {"cell": cell, "publish": publish, "transport": transport, "radio": radio, "base_port": base_port}


def _speed(text: str) -> float | str:
    if text == "max":
        return text
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise UserError("--speed", f"is {text!r}", "give a positive number, or max")
    return speed


def main() -> None:
    """Run the command; print what a user can mend as one line."""
    try:
        app()
    except UserError as error:
        typer.echo(f"orion: {error}", err=True)
        sys.exit(2)
