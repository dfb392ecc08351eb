"""The worlds that come with Orion: YAML files in ``agent/worlds``, by name. Light, for the command line's help."""

from __future__ import annotations

from importlib import resources

FOLDER = resources.files("agent") / "worlds"


def world_names() -> list[str]:
    """The names, in order."""
    return sorted(entry.name.removesuffix(".yaml") for entry in FOLDER.iterdir() if entry.name.endswith(".yaml"))
