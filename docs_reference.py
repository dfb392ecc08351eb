"""The reference of the command line, ``docs/commands.md``, from the commands themselves: ``python docs_reference.py``.

A test compares the page with what the commands say of themselves.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from agent.cli import app

PAGE = Path(__file__).parent / "docs" / "commands.md"

_HEAD = """\
# Commands

What `orion --help` says, for all commands. This page is written by `python docs_reference.py`.

Exit status: 0 is success, 1 failure (a swarm that does not agree included), 2 bad usage or configuration.
"""


def page() -> str:
    """The whole page."""
    sections = [_section(name, command) for name, command in _leaves("orion", typer.main.get_command(app))]
    return "\n".join([_HEAD, *sections]).rstrip() + "\n"


def _leaves(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    """The commands that do something, by the words that call them."""
    if not hasattr(command, "commands"):
        yield name, command
        return
    for word, inner in command.commands.items():
        if not inner.hidden:
            yield from _leaves(f"{name} {word}", inner)


def _section(name: str, command: Any) -> str:
    shown = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
    arguments = [parameter for parameter in shown if parameter.param_type_name == "argument"]
    usage = " ".join([name, *(_call(argument) for argument in arguments), "[OPTIONS]"])
    help_text, examples = _told(command)
    lines = [f"## {name}", "", help_text, "", "```text", usage, "```", ""]
    lines += [*(_line(parameter) for parameter in shown), ""]
    if examples:
        lines += ["```sh", *examples, "```", ""]
    return "\n".join(lines)


def _call(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    return name if argument.required or name.startswith("[") else f"[{name}]"


def _told(command: Any) -> tuple[str, list[str]]:
    """What a command's help says, and its examples: from its end, or from a paragraph of the help."""
    paragraphs = [p.strip() for p in (command.help or "").split("\n\n")]
    listed = [p for p in paragraphs if p.startswith("\b") and "Examples:" in p]
    text = "\n\n".join(" ".join(p.split()) for p in paragraphs if p not in listed)
    examples = [line.strip() for p in listed for line in p.splitlines()[2:]]
    epilog = re.sub(r"^Examples?: ", "", command.epilog or "")
    return text, examples + [each.strip() for each in re.split(r"\s{4,}|, and in other terminals ", epilog) if each]


def _line(parameter: Any) -> str:
    """An option or argument as an item of a list."""
    argument = parameter.param_type_name == "argument"
    flag = getattr(parameter, "is_flag", False)
    if argument:
        names = parameter.metavar or parameter.name.upper()
    else:
        value = "" if flag else f" {parameter.metavar or 'N'}"
        names = ", ".join([*parameter.opts, *parameter.secondary_opts]) + value
    default = "" if argument or flag or parameter.default in (None, False) else f" Default: `{parameter.default}`."
    required = " Must be given." if parameter.required and not argument else ""
    return f"* `{names}`: {parameter.help or ''}{required}{default}"


if __name__ == "__main__":
    PAGE.write_text(page())
