"""``orion log``: what can be done with logs without a swarm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from agent.errors import UserError
from agent.page_options import OpenOption, PageHost, PagePort, page_options

app = typer.Typer(no_args_is_help=True, help="Logs that --record wrote: show, describe, recover, export.")

LogFile = Annotated[Path, typer.Argument(metavar="RUN.mcap", help="A log.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


@app.command(epilog="Example: orion log show run.mcap")
def show(
    log: LogFile,
    port: PagePort = None,
    host: PageHost = "127.0.0.1",
    open_page: OpenOption = None,
) -> None:
    """Show a log in a browser as it was at any time, with a slider; no swarm is started. Runs until Ctrl-C."""
    from agent.control import Control
    from agent.log_player import LogPlayer, show_log
    from agent.page import Page

    player, control = LogPlayer(log), Control()
    control.obey_signals()
    with Page(player.config, page_options(port, host, open_page)) as page:
        typer.echo(f"orion: {log} is shown at {page.url}; Ctrl-C ends it", err=True)
        show_log(player, page, control)


@app.command(epilog="Example: orion log info run.mcap")
def info(log: LogFile, as_json: Json = False) -> None:
    """Describe a log: its topics, its sessions, and whether its end is there."""
    from agent.log_tools import describe

    facts = describe(log)
    if as_json:
        typer.echo(json.dumps(facts))
        return
    typer.echo(f"{log}: swarm {facts['swarm']}, {facts['seconds']:.1f} s, {facts['messages']} messages")
    typer.echo(facts["torn"] + "; orion log recover saves what is there" if facts["torn"] else "whole")
    for topic in facts["topics"]:
        typer.echo(f"{topic['messages']:>9}  {topic['topic']}  ({topic['type']})")
    for session in facts["sessions"]:
        typer.echo(f"{session['robot']:>9}  session {session['session']}, {session['updates']} updates")
    typer.echo(f"   digest  {facts['map_digest']}")


@app.command(epilog="Example: orion log recover torn.mcap whole.mcap")
def recover(
    torn: Annotated[Path, typer.Argument(metavar="TORN.mcap", help="A log whose end is missing.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A new file.")],
    as_json: Json = False,
) -> None:
    """Save all that is whole in a log whose writer was killed, up to the tear."""
    from agent.log_tools import recover as save

    messages, why = save(torn, out)
    if as_json:
        typer.echo(json.dumps({"log": str(out), "messages": messages, "torn": why}))
    else:
        typer.echo(f"{messages} messages in {out}; {torn} " + (f"is {why}" if why else "was whole"))


@app.command(epilog="Examples: orion log export run.mcap --rosbag2 bag/    orion log export run.mcap --tum tum/")
def export(
    log: LogFile,
    rosbag2: Annotated[Path | None, typer.Option("--rosbag2", metavar="DIR", help="A new rosbag2 folder.")] = None,
    tum: Annotated[
        Path | None, typer.Option("--tum", metavar="DIR", help="A folder for each robot's trajectory, as evo reads it.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="truth.npz", help="With --tum: the true ways that orion simulate wrote, too."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a log in other forms: a rosbag2 folder, trajectories in TUM's format."""
    from agent.log_tools import export_rosbag2, export_truth, export_tum

    if rosbag2 is None and tum is None:
        raise UserError("orion log export", "has nothing to write", "give --rosbag2 DIR, --tum DIR, or both")
    if truth is not None and tum is None:
        raise UserError("--truth", "is for trajectories", "give --tum DIR too")
    files: dict[str, list[str]] = {}
    if rosbag2 is not None:
        export_rosbag2(log, rosbag2)
        files["rosbag2"] = [str(rosbag2)]
    if tum is not None:
        files["tum"] = [str(path) for path in export_tum(log, tum)]
        if truth is not None:
            files["tum"] += [str(path) for path in export_truth(truth, tum)]
    typer.echo(json.dumps({"files": files}) if as_json else "\n".join(path for kind in files.values() for path in kind))
