"""Values that a shell completes on Tab (``orion --install-completion``).

Laws kept here: nothing heavy is imported, somebody waits with a finger on the key; what cannot be known is completed to
nothing, without a word.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path

import typer

from agent.packaged_worlds import world_names

TRANSPORTS = ("zenoh", "zmq")
RADIOS = ("lan", "digimesh-1hop", "digimesh-3hop", "digimesh-6hop")
FORMS = ("auto", "scans", "tiles")
POSES = ("truth", "odometry", "slam")
"""As ``agent.config`` has them."""


def one_of(values: Iterable[str]) -> Callable[[str], list[str]]:
    """Completes to some values."""

    def complete(incomplete: str) -> list[str]:
        return [value for value in values if value.startswith(incomplete)]

    return complete


def worlds(incomplete: str) -> list[str]:
    """Completes to the worlds that come with Orion; a shell has files by itself."""
    return one_of(world_names())(incomplete)


def robots(ctx: typer.Context, incomplete: str) -> list[str]:
    """Completes to the robots of the file that was given with ``-c`` before."""
    try:
        table = tomllib.loads(Path(ctx.params["config"]).read_text("utf-8")).get("robots", {})
    except (KeyError, TypeError, OSError, ValueError):  # no file yet, or none that can be read
        return []
    return one_of(table if isinstance(table, dict) else ())(incomplete)
