"""The command line: ``orion``. The only place that prints an error and picks an exit status.

0 is success, 2 bad usage or configuration, 1 failure (a swarm that does not agree included).
"""

from __future__ import annotations

import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from agent.completion import FORMS, POSES, RADIOS, TRANSPORTS, one_of, robots, worlds
from agent.config_command import app as config_app
from agent.errors import UserError
from agent.log_command import app as log_app
from agent.map_command import app as map_app
from agent.news import WRITERS, Form, of_error
from agent.outputs import Outputs
from agent.packaged_worlds import world_names
from agent.page_options import OpenOption, PageHost, PagePort, page_options

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
app.add_typer(log_app, name="log")
app.add_typer(config_app, name="config")

ConfigFile = Annotated[Path | None, typer.Option("-c", "--config", metavar="FILE", help="The swarm's TOML.")]
Cell = Annotated[float | None, typer.Option(metavar="M", help="Cell size in metres, whole millimetres.")]
SpeedOption = Annotated[
    str, typer.Option(metavar="X|max", help="Times real time, or max.", autocompletion=one_of(["max"]))
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the map and the resolved configuration go.")]
BasePort = Annotated[int | None, typer.Option(metavar="P", help="Robot k listens on P + k (default 7450).")]
Transport = Annotated[
    str | None,
    typer.Option(metavar="|".join(TRANSPORTS), help="The bus between peers.", autocompletion=one_of(TRANSPORTS)),
]
Radio = Annotated[
    str | None,
    typer.Option(
        metavar="PROFILE",
        help="What the network can carry: lan, digimesh-1hop, -3hop or -6hop.",
        autocompletion=one_of(RADIOS),
    ),
]
PublishOption = Annotated[
    str | None, typer.Option(metavar="FORM", help="auto, scans or tiles.", autocompletion=one_of(FORMS))
]
State = Annotated[Path | None, typer.Option(metavar="DIR", help="Where the map is kept from one run to the next.")]
Record = Annotated[
    Path | None, typer.Option(metavar="FILE.mcap", help="A new file for a log of all that happens, to replay.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object as the last line of stdout.")]
PageOption = Annotated[bool, typer.Option("--page/--no-page", help="Show the map live in a browser.")]
LogOption = Annotated[
    Form | None, typer.Option("--log", help="How news is written on stderr: by default text for a terminal, else JSON.")
]
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
        str,
        typer.Option(
            metavar="NAME|FILE", help=f"{', '.join(world_names())}, or a YAML of walls.", autocompletion=worlds
        ),
    ] = "paper",
    seed: Annotated[int, typer.Option(min=0, help="Decides the sensors' noise.")] = 1,
    publish: PublishOption = None,
    transport: Transport = None,
    radio: Radio = None,
    base_port: BasePort = None,
    page: PageOption = True,
    port: PagePort = None,
    host: PageHost = "127.0.0.1",
    open_page: OpenOption = None,
    out: Out = Path("out"),
    state: State = None,
    record: Record = None,
    as_json: AsJson = False,
) -> None:
    """Simulated robots, each its own process, and an observer map a world together; ends by itself."""
    from agent.config import load
    from agent.launch import demo_config, launch

    options = _swarm_options(cell, publish, transport, radio, base_port)
    outputs = Outputs(page_options(port, host, open_page) if page else None, record, state=state)
    base = load(config, options)
    resolved = demo_config(base, world=world, robots=robots, speed=_speed(speed), seed=seed)
    converged = launch(resolved, out, outputs, simulated=True, as_json=as_json)
    raise typer.Exit(0 if converged else 1)


@app.command(
    epilog="Examples: orion replay run.log.gz --robots 3 --cell 0.05    orion replay r1.log r2.log -c lab.toml"
)
def replay(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING...", help="CARMEN logs, one a robot, nano_swarm folders, or one .mcap."),
    ],
    config: ConfigFile = None,
    robots: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Cut one log into N robots at equal path.")
    ] = None,
    cell: Cell = None,
    max_range: Annotated[
        float | None, typer.Option(metavar="M", help="Readings beyond it free their ray up to it.")
    ] = None,
    poses: Annotated[
        str | None, typer.Option(metavar="WHICH", help="truth, odometry or slam.", autocompletion=one_of(POSES))
    ] = None,
    speed: SpeedOption = "max",
    publish: PublishOption = None,
    transport: Transport = None,
    radio: Radio = None,
    base_port: BasePort = None,
    page: PageOption = True,
    port: PagePort = None,
    host: PageHost = "127.0.0.1",
    open_page: OpenOption = None,
    out: Out = Path("out"),
    state: State = None,
    record: Record = None,
    as_json: AsJson = False,
) -> None:
    """Recorded robots, each its own process, and an observer map together what they once saw."""
    from agent.config import load
    from agent.launch import launch, replay_config

    options = _swarm_options(cell, publish, transport, radio, base_port)
    outputs = Outputs(page_options(port, host, open_page) if page else None, record, state=state)
    base = load(config, options)
    if any(path.suffix.lower() == ".mcap" for path in recordings):
        from agent.repeater import log_config

        fixed = {"-c": config, "--robots": robots, "--cell": cell, "--max-range": max_range, "--poses": poses}
        _brings_its_own(recordings, fixed | {"--publish": publish})
        resolved = log_config(base, recordings[0], _speed(speed))
    else:
        resolved = replay_config(base, recordings, robots=robots, poses=poses, max_range=max_range, speed=_speed(speed))
    converged = launch(resolved, out, outputs, simulated=False, as_json=as_json)
    raise typer.Exit(0 if converged else 1)


@app.command(epilog="Example: orion agent -c lab.toml --robot r1 --state state/")
def agent(
    config: Annotated[Path, typer.Option("-c", "--config", metavar="FILE", help="The swarm's TOML.")],
    robot: Annotated[str, typer.Option(metavar="ID", help="Which robot of the roster this is.", autocompletion=robots)],
    state: State = None,
    metrics_port: Annotated[
        int | None,
        typer.Option(metavar="P", min=0, max=65535, help="Where /healthz and /metrics are; nowhere if not given."),
    ] = None,
    metrics_host: Annotated[
        str, typer.Option(metavar="H", help="Where they listen; not only here: then they want a token.")
    ] = "127.0.0.1",
    as_json: AsJson = False,
    log: LogOption = None,
    supervised: SupervisedOption = False,
) -> None:
    """One robot: its body, its session, its copy of the map. Runs until Ctrl-C."""
    from agent.config import load
    from agent.probes import NO_PROBES, Probes
    from agent.robot import run_robot

    def work(control: Any) -> dict[str, Any]:
        swarm = load(config, {})
        with NO_PROBES if metrics_port is None else Probes(swarm, metrics_host, metrics_port) as probes:
            if probes.url:
                control.tell("metrics", url=probes.url)
            return run_robot(swarm, robot, control, state, probes)

    _work(work, as_json=as_json, log=log, supervised=supervised)


@app.command(epilog="Example: orion observe -c lab.toml --state state/ --out map/")
def observe(
    config: ConfigFile = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Where the map is written at the end.")] = None,
    scans: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Where the scans that came by are written at the end.")
    ] = None,
    page: PageOption = True,
    port: PagePort = None,
    host: PageHost = "127.0.0.1",
    open_page: OpenOption = None,
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Which observer of the file this is: it listens, so that others find it."),
    ] = None,
    state: State = None,
    record: Record = None,
    ros2: Annotated[
        bool, typer.Option("--ros2", help="Publish map, poses and scans as ROS 2 topics (rmw_zenoh).")
    ] = False,
    ros2_router: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="Where ROS 2's Zenoh router listens.")
    ] = "tcp/127.0.0.1:7447",
    as_json: AsJson = False,
    log: LogOption = None,
    supervised: SupervisedOption = False,
) -> None:
    """A peer without a body: follows the swarm until Ctrl-C, then writes the map."""
    from agent.config import load
    from agent.files import prepare_folder
    from agent.observer import run_observer

    def work(control: Any) -> dict[str, Any]:
        swarm = load(config, {})
        folder = None if out is None else prepare_folder(out)
        shown = page_options(port, host, open_page) if page else None
        outputs = Outputs(shown, record, scans, state, ros2_router if ros2 else None)
        return run_observer(swarm, folder, outputs, control, name)

    _work(work, as_json=as_json, log=log, supervised=supervised)


@app.command(epilog="Examples: orion top -c lab.toml    orion top -c lab.toml --once    orion top -c lab.toml --json")
def top(
    config: ConfigFile = None,
    once: Annotated[
        bool, typer.Option("--once", help="Print the table once; so too where there is no terminal.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """The swarm in a terminal: who is there, how each robot stands, what is sent and dropped, a small map."""
    from rich.console import Console

    from agent.config import load
    from agent.control import Quiet
    from agent.kernel import Compilation
    from agent.operate import NobodyError
    from agent.top import look, show
    from agent.top_view import report

    swarm, console = load(config, {}), Console()
    live = console.is_terminal and not (once or as_json)
    with Compilation() if live else nullcontext() as compilation:
        control = Quiet(compilation)
        control.obey_signals()
        if live:
            show(swarm, control, console)
            return
        try:
            state = look(swarm, control)
        except NobodyError:
            raise _nobody(swarm, "nothing is known") from None
    if as_json:
        typer.echo(json.dumps(state))
    else:
        console.print(report(state, console.width))
    if not state["caught_up"]:
        typer.echo("orion: not all that others hold is here yet", err=True)


@app.command(epilog="Example: orion simulate -c lab.toml, and in other terminals orion agent -c lab.toml --robot r1")
def simulate(
    config: Annotated[Path, typer.Option("-c", "--config", metavar="FILE", help="The swarm's TOML.")],
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Where the robots' true ways are written at the end.")
    ] = None,
    as_json: AsJson = False,
    log: LogOption = None,
    supervised: SupervisedOption = False,
) -> None:
    """The world and the bodies of all robots, each behind a serial port r1.tty beside the TOML. Runs until Ctrl-C."""
    from agent.config import load
    from agent.emulator import run_simulation

    _work(
        lambda control: run_simulation(load(config, {}), config.absolute().parent, control, truth),
        as_json=as_json,
        log=log,
        supervised=supervised,
    )


@app.command(
    "start-pose",
    epilog="Examples: orion start-pose r2 --x 2.15 --y 1.45 --yaw-deg 10 -c lab.toml    "
    "orion start-pose r2 --x -0.5 --y 0 --yaw-deg -90 -c lab.toml --json",
)
def start_pose(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Whose start pose.", autocompletion=robots)],
    x: Annotated[float, typer.Option("--x", metavar="M", help="Metres in the common frame.")],
    y: Annotated[float, typer.Option("--y", metavar="M", help="Metres in the common frame.")],
    yaw_deg: Annotated[float, typer.Option("--yaw-deg", metavar="D", help="Degrees, counter-clockwise.")],
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Tell a running swarm where a robot really started: it publishes its whole map anew, and everybody has it right.

    The decision is stronger than the file's start, for as long as any peer remembers it.
    """
    from agent.config import load, start_of
    from agent.operate import set_start_pose

    pose, swarm = start_of(x, y, yaw_deg), load(config, {})
    _operate(swarm, lambda operator: set_start_pose(operator, swarm, robot, pose), as_json=as_json)


@app.command(
    epilog="Examples: orion evict r2 -c lab.toml    orion evict 5f3a09 -c lab.toml    "
    "orion evict r2 --readmit -c lab.toml"
)
def evict(
    session: Annotated[
        str,
        typer.Argument(
            metavar="SESSION|ROBOT",
            help="16 hex digits, the first few of them, or a robot's id.",
            autocompletion=robots,
        ),
    ],
    config: ConfigFile = None,
    readmit: Annotated[bool, typer.Option("--readmit", help="Take it back into the map.")] = False,
    as_json: AsJson = False,
) -> None:
    """Take a session out of the map everywhere, exactly and for as long as nobody readmits it."""
    from agent.config import load
    from agent.operate import evict as decide

    _operate(load(config, {}), lambda operator: decide(operator, session, readmit=readmit), as_json=as_json)


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


@app.command(epilog="Examples: orion doctor    orion doctor /dev/ttyACM0    orion doctor -c lab.toml --json")
def doctor(
    port: Annotated[
        str | None, typer.Argument(metavar="[PORT]", help="The serial port of one robot, to test that alone.")
    ] = None,
    config: ConfigFile = None,
    baudrate: Annotated[int | None, typer.Option(metavar="N", min=300, help="Bits a second on PORT.")] = None,
    as_json: AsJson = False,
) -> None:
    """Test this machine, a configuration, and the robots on its serial ports. Turns no wheel; exits 1 at a problem."""
    from agent.config import load
    from agent.doctor import examine
    from agent.errors import printable
    from agent.finding import worst

    swarm = None if config is None else load(config, {})
    findings = []
    for finding in examine(port, swarm, Path.cwd() if config is None else config.absolute().parent, baudrate):
        findings.append(finding)
        if not as_json:
            remedy = f"; {finding.remedy}" if finding.remedy else ""
            typer.echo(printable(f"{finding.verdict:>8}  {finding.subject}: {finding.found}{remedy}"))
    if as_json:
        typer.echo(json.dumps({"verdict": worst(findings), "findings": [it._asdict() for it in findings]}))
    raise typer.Exit(1 if worst(findings) == "problem" else 0)


def _work(work: Any, *, as_json: bool, log: Form | None, supervised: bool) -> None:
    """Run one process of a swarm, for a person, a service manager or the command that started it."""
    from agent.control import Control, Supervised
    from agent.kernel import Compilation
    from agent.service_manager import ServiceManager

    sys.setswitchinterval(_SWITCH_INTERVAL)
    if supervised:
        control: Control = Supervised()
        try:
            control.tell("report", **work(control))
        except UserError as error:
            control.tell("error", where=error.where, what=error.what, remedy=error.remedy)
            raise typer.Exit(2) from None
        return
    form = log or (Form.TEXT if sys.stderr.isatty() else Form.JSON)
    try:
        with Compilation() as compilation:
            control = Control(compilation, WRITERS[form], ServiceManager(os.environ))
            control.obey_signals()
            summary = work(control)
    except UserError as error:
        typer.echo(WRITERS[form](of_error(error)), err=True)
        raise typer.Exit(2) from None
    if as_json or form is Form.JSON:
        typer.echo(json.dumps(summary))
        return
    for each in summary.pop("contributions", ()):
        state = "in the map" if each["summed"] else "not in the map"
        reason = f": {each['reason']}" if each["reason"] else ""
        typer.echo(f"{each['robot']:>12}  session {each['session']}, {each['updates']} updates, {state}{reason}")
    for key, value in summary.items():
        typer.echo(f"{key:>12}  {value}")


def _operate(config: Any, work: Any, *, as_json: bool) -> None:
    """Decide something in a running swarm; tell what changed and who knows."""
    from agent.operate import NobodyError, in_words, operate

    try:
        result = operate(config, work)
    except NobodyError:
        raise _nobody(config, "nothing was decided") from None
    typer.echo(json.dumps(result) if as_json else "\n".join(in_words(result)))
    raise typer.Exit(0 if result["known_to_all"] else 1)


def _nobody(config: Any, so: str) -> typer.Exit:
    """Say that there is no swarm; gives how the command ends."""
    ports = f"{config.base_port} to {config.base_port + len(config.robots) - 1}"
    typer.echo(f"orion: nobody of swarm {config.swarm} is there (ports {ports}); {so}", err=True)
    return typer.Exit(1)


def _swarm_options(
    cell: float | None, publish: str | None, transport: str | None, radio: str | None, base_port: int | None
) -> dict[str, Any]:
    return {"cell": cell, "publish": publish, "transport": transport, "radio": radio, "base_port": base_port}


def _brings_its_own(recordings: list[Path], fixed: dict[str, Any]) -> None:
    """A log is replayed by itself and as it is."""
    if len(recordings) > 1:
        raise UserError("orion replay", "takes one log, with all its robots, and nothing else", "give one .mcap")
    for option, value in fixed.items():
        if value is not None:
            raise UserError(option, "cannot be given with a log, which has its own", "leave it out")


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
