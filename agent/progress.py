"""How a run goes, on stderr when that is a terminal: a bar for every robot, a line for the swarm."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import TracebackType
from typing import Protocol, Self

from agent.member import Member


class Progress(Protocol):
    """Shows members' states. Use it in a ``with`` statement."""

    def show(self, members: Mapping[str, Member]) -> None:
        """Show what the processes last said."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Silence:
    """Shows nothing, for pipes and logs."""

    def show(self, members: Mapping[str, Member]) -> None:
        """Nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        pass


class Bars:
    """Bars with rich."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (
            TextColumn("{task.description:>10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
        )
        self._bars = Progress(*columns, console=Console(stderr=True))
        self._tasks: dict[str, object] = {}

    def show(self, members: Mapping[str, Member]) -> None:
        """A bar a robot: scans sensed, and how many of the swarm's updates it has."""
        known = {name: sum(member.status.get("positions", {}).values()) for name, member in members.items()}
        most = max(known.values(), default=0)
        for name, member in members.items():
            if name not in self._tasks:
                self._tasks[name] = self._bars.add_task(name, total=None, note="")
            done, total = member.status.get("progress", (0, 0))
            if not total:  # an observer's progress is how much of the news it has
                done, total = known[name], most
            note = f"{known[name]} updates" if member.alive else "LOST"
            self._bars.update(self._tasks[name], completed=done, total=total or None, note=note)  # type: ignore[arg-type]

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._bars.stop()


def progress() -> Progress:
    """Bars in a terminal, silence elsewhere."""
    return Bars() if sys.stderr.isatty() else Silence()
