"""What ``orion top`` draws: a table of robots and observers, what is dropped and spent, and a small map.

Laws kept here: it is made of values alone (``agent.overview`` and a map), for a rectangle of any size; whatever a
colour says, a character says too.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np
from rich.color import Color
from rich.console import Group, RenderableType
from rich.style import Style
from rich.table import Column, Table
from rich.text import Text

from mapping.grid import Grid
from mapping.thumbnail import FREE, OCCUPIED, UNKNOWN, Thumbnail

_WIDE = 120
"""Characters from which on the map is beside the table and not below it."""

_TABLE_WIDTH = 80
_LEAST_MAP = 7
"""Lines that the map below the table has before the table is cut."""

_FREE = Color.parse("grey50")  # to be seen on black and on white; walls are in the terminal's own ink

_SAME = {True: Text("✓", "green"), False: Text("·", "yellow"), None: Text("?", "yellow")}

_REPAIR = ("requests", "answers", "control")
"""The classes of traffic that are neither updates nor digests."""


def screen(state: dict[str, Any], grid: Grid, width: int, height: int, *, colours: bool) -> RenderableType:
    """All of it, for a rectangle of so many characters."""
    facts = _facts(state)
    room = height - 4 - len(facts)  # the heading has two lines, the table's has one, and one is empty
    beside = width >= _WIDE
    rows = table(state, max(1, room if beside else room - min(_LEAST_MAP, room // 2)))
    if beside:
        columns = Table.grid(Column(width=_TABLE_WIDTH), Column(), padding=(0, 2, 0, 0))
        large = picture(state, grid, width - _TABLE_WIDTH - 4, max(1, height - 2), colours=colours)
        columns.add_row(Group(rows, Text(), *facts), large)
        return Group(heading(state, width), columns)
    small = picture(state, grid, width, max(1, room - rows.row_count), colours=colours)
    return Group(heading(state, width), rows, Text(), *facts, small)


def report(state: dict[str, Any], width: int) -> RenderableType:
    """All but the map, with every row and word of it."""
    return Group(heading(state, width), table(state), Text(), *_facts(state, whole=True))


def heading(state: dict[str, Any], width: int) -> Text:
    """Two lines on the swarm: who is there and what is known; the digest, and whether all agree on it."""
    robots = sum(peer["robot"] for peer in state["peers"])
    there = f"{_count(robots, 'robot')}, {_count(len(state['peers']) - robots, 'other peer')}"
    load = f"{_bytes(state['bytes_rate'])}/s{_share(state, state['bytes_rate'])}"
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(state["swarm"], "bold").append(f"   {there}   {state['known_m2']:.2f} m² known   {load}\n")
    text.append(state["digest"] if width >= _WIDE else f"{state['digest'][:16]}…", "cyan")
    if state["agree"]:
        return text.append("   ✓ all agree", "green")
    same = sum(peer["same"] is True for peer in state["peers"])
    return text.append(
        f"   {same} of {len(state['peers'])} agree" if state["peers"] else "   nobody is there", "yellow"
    )


def table(state: dict[str, Any], most: int | None = None) -> Table:
    """A line for each session that is not replaced, and for each peer that is no robot.

    Args:
        state: see ``agent.overview``.
        most: lines that there is room for; None is for all of them, and their words may take several.
    """
    whole = most is None
    listed = Table(
        Column("robot", no_wrap=True, max_width=18),
        Column("same", justify="center", no_wrap=True),
        Column("state", ratio=1, no_wrap=not whole, overflow="fold" if whole else "ellipsis"),
        *(Column(name, justify="right", no_wrap=True) for name in ("updates", "/s", "age", "bytes/s")),
        box=None,
        expand=True,
        pad_edge=False,
        header_style="dim",
    )
    rows = list(_rows(state))
    shown = rows if most is None or len(rows) <= most else rows[: most - 1]
    for row in shown:
        listed.add_row(*row)
    if len(shown) < len(rows):
        listed.add_row("", "", Text(f"and {len(rows) - len(shown)} more", "dim"))
    return listed


def _rows(state: dict[str, Any]) -> Iterator[tuple[Text, ...]]:
    robots = sorted((peer for peer in state["peers"] if peer["robot"]), key=lambda peer: peer["same"] is not True)
    same = {peer["name"]: peer["same"] for peer in robots}  # of two of one name, what the one says that does not agree
    for it in state["sessions"]:
        if it["replaced"]:
            continue
        behind = "" if it["n"] >= it["known_n"] else f"/{it['known_n']}"
        yield (
            Text.assemble(("● " if it["live"] else "○ ", it["colour"]), it["robot"]),
            _SAME[same.get(it["robot"])] if it["live"] else Text("-", "dim"),
            _standing(it),
            Text(f"{it['n']}{behind}", "yellow" if behind else ""),
            Text(f"{it['updates_rate']:.1f}"),
            Text(_age(it["age"])),
            Text("-" if it["bytes_rate"] is None else _bytes(it["bytes_rate"]) + _share(state, it["bytes_rate"])),
        )
    for it in state["peers"]:
        if not it["robot"]:
            rate = _bytes(it["bytes_rate"]) + _share(state, it["bytes_rate"])
            yield Text(f"  {it['name']}"), _SAME[it["same"]], Text(_SAID[it["same"]]), *map(Text, ("", "", "", rate))


_SAID = {True: "has this map", False: "has another state", None: "has not said what it has"}


def _standing(session: dict[str, Any]) -> Text:
    """How a session stands, and why."""
    if not session["summed"]:
        return Text(f"not in the map: {session['reason']}", "red")
    return Text(f"in the map; {session['reason']}", "yellow") if session["reason"] else Text("in the map", "green")


def _facts(state: dict[str, Any], *, whole: bool = False) -> list[Text]:
    """What we dropped, and what we spent."""
    dropped = ", ".join(f"{reason} {count}" for reason, count in sorted(state["dropped"].items()) if count)
    spent = {name: state["spent"].get(name, 0) for name in ("updates", "digests")}
    spent["repair"] = sum(state["spent"].get(name, 0) for name in _REPAIR)
    lines = {"dropped": dropped or "nothing", "spent": ", ".join(f"{name} {_bytes(n)}" for name, n in spent.items())}
    options: Any = {} if whole else {"no_wrap": True, "overflow": "ellipsis"}
    return [Text.assemble((f"{name:<9}", "dim"), text, **options) for name, text in lines.items()]


# --- the map


def picture(state: dict[str, Any], grid: Grid, width: int, height: int, *, colours: bool) -> Text:
    """The map in half-blocks, two cells a character, with a robot's cell in its colour."""
    small = Thumbnail.of(grid, 2 * height, width)
    cells = np.pad(small.cells, ((0, len(small.cells) % 2), (0, 0)), constant_values=UNKNOWN).tolist()
    robots = {}
    for it in state["sessions"]:
        if it["live"] and it["pose"] is not None and (place := small.place(it["pose"][0] / 1000, it["pose"][1] / 1000)):
            robots[place] = Color.parse(it["colour"])
    draw = _coloured if colours else _plain
    lines = []
    for row in range(0, len(cells), 2):
        line = [
            draw((upper, robots.get((row, column))), (lower, robots.get((row + 1, column))))
            for column, (upper, lower) in enumerate(zip(cells[row], cells[row + 1], strict=True))
        ]
        runs = groupby(line, key=lambda character: character[1])
        lines.append(Text.assemble(*(("".join(glyph for glyph, _ in run), style) for style, run in runs), no_wrap=True))
    return Text("\n").join(lines)


Half = tuple[int, Color | None]
"""What a cell is, and the colour of the robot that stands there."""


def _plain(upper: Half, lower: Half) -> tuple[str, Style]:
    """Walls as blocks, what is free as a dot, a robot as an o."""
    if upper[1] or lower[1]:
        return "o", Style()
    walls = (upper[0] == OCCUPIED, lower[0] == OCCUPIED)
    free = FREE in {upper[0], lower[0]}
    return {(True, True): "█", (True, False): "▀", (False, True): "▄"}.get(walls, "·" if free else " "), Style()


@cache
def _coloured(upper: Half, lower: Half) -> tuple[str, Style]:
    """The half that is more than the other is drawn, the other is the ground that it is drawn on."""
    glyph, drawn, ground = ("▀", upper, lower) if _weight(upper) >= _weight(lower) else ("▄", lower, upper)
    if _weight(drawn) == 0:
        return " ", Style()
    if drawn == ground:
        glyph = "█"
    under = _FREE if _weight(ground) else None
    return glyph, Style.from_color(_ink(drawn), None if glyph == "█" else under)


def _weight(half: Half) -> int:
    """Robots before walls before what is free."""
    cell, robot = half
    return 3 if robot else {OCCUPIED: 2, FREE: 1}.get(cell, 0)


def _ink(half: Half) -> Color | None:
    cell, robot = half
    return robot or (_FREE if cell == FREE else None)


# --- words


def _count(count: int, what: str) -> str:
    return f"{count} {what}" + "s" * (count != 1)


def _bytes(count: int) -> str:
    """To three digits or so."""
    for unit, size in (("kB", 1e3), ("MB", 1e6), ("GB", 1e9)):
        if count < 999.5 * size:
            return f"{count} B" if count < 1000 else f"{count / size:.3g} {unit}"
    return f"{count / 1e12:.3g} TB"


def _share(state: dict[str, Any], rate: int) -> str:
    """Of what the radio can carry."""
    return f" {100 * rate / state['budget']:.0f}%" if state["budget"] else ""


def _age(seconds: int | None) -> str:
    if seconds is None:
        return "never"
    return f"{seconds} s" if seconds < 100 else f"{seconds // 60} min" if seconds < 6000 else f"{seconds // 3600} h"
