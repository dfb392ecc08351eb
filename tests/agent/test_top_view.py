"""The terminal's picture: made of values, for any size."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.color import Color
from rich.console import Console, RenderableType

from agent.top_view import picture, report, screen
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.thumbnail import FREE, OCCUPIED, UNKNOWN, Thumbnail
from mapping.tiles import frozen

LATTICE = Lattice(50)


def session(robot: str = "r1", **facts: Any) -> dict[str, Any]:
    return {
        "session": "00" * 8,
        "robot": robot,
        "colour": "#0072b2",
        "n": 7,
        "known_n": 7,
        "summed": True,
        "live": True,
        "reason": "",
        "replaced": False,
        "age": 2,
        "updates_rate": 9.96,
        "bytes_rate": 654,
        "pose": [75, 75, 0],
        **facts,
    }


def peer(name: str = "r1", **facts: Any) -> dict[str, Any]:
    return {"name": name, "robot": True, "same": True, "bytes_rate": 654, **facts}


def state(sessions: list[dict[str, Any]], peers: list[dict[str, Any]], **facts: Any) -> dict[str, Any]:
    return {
        "swarm": "lab",
        "digest": "0123456789abcdef" * 2,
        "agree": False,
        "known_m2": 12.5,
        "bytes_rate": 1362,
        "budget": None,
        "sessions": sessions,
        "peers": peers,
        "dropped": {},
        "spent": {},
        **facts,
    }


def grid(evidence: Any) -> Grid:
    return Grid(frozen(np.array(evidence, np.int32)), 0, 0, LATTICE)


NOTHING = grid(np.zeros((0, 0)))
ROOM = np.full((60, 90), -9)
ROOM[[0, -1]] = ROOM[:, [0, -1]] = 9


def drawn(what: RenderableType, width: int = 80, height: int = 24, **options: Any) -> list[str]:
    console = Console(file=io.StringIO(), width=width, height=height, **options)
    console.print(what, end="")
    text: str = console.file.getvalue()
    return text.splitlines()


def line_of(lines: list[str], word: str) -> str:
    (found,) = [line for line in lines if word in line]
    return found


# Words


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({}, ["●", "✓", "in the map", " 7 ", "10.0", "2 s", "654 B"]),
        ({"reason": "silent for 14 s", "age": 14}, ["in the map; silent for 14 s", "14 s"]),
        ({"summed": False, "reason": "evicted by bob"}, ["not in the map: evicted by bob"]),
        ({"n": 3, "known_n": 9}, ["3/9"]),
        ({"live": False, "bytes_rate": None, "age": None}, ["○", " - ", "never"]),
        ({"age": 7260}, ["2 h"]),
        ({"age": 130}, ["2 min"]),
    ],
)
def test_how_a_robot_stands_is_said_in_words(facts: dict[str, Any], words: list[str]) -> None:
    line = line_of(drawn(report(state([session(**facts)], [peer()]), 80)), " r1 ")
    assert all(word in line for word in words), line


def test_an_observer_has_a_line_and_a_replaced_session_none() -> None:
    peers = [peer(), peer("desk", robot=False, same=False)]
    lines = drawn(report(state([session(), session("r2", replaced=True)], peers), 80))
    assert "has another state" in line_of(lines, "desk")
    assert not any("r2" in line for line in lines)
    assert lines[0].split()[:6] == ["lab", "1", "robot,", "1", "other", "peer"]


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_robots_of_one_name_neither_agrees_unless_both_do(order: int) -> None:
    peers = [peer(same=True), peer(same=False)][::order]
    lines = drawn(report(state([session(session=each * 8) for each in ("0a", "0b")], peers), 80))
    assert sum("●" in line for line in lines) == 2
    assert not any("✓" in line for line in lines)


def test_that_all_agree_is_marked_beside_the_digest() -> None:
    assert "✓ all agree" in line_of(drawn(report(state([], [peer()], agree=True), 80)), "0123456789abcdef")
    assert "0 of 1 agree" in drawn(report(state([], [peer(same=None)]), 80))[1]
    assert "nobody is there" in drawn(report(state([], []), 80))[1]


def test_what_is_sent_is_held_against_what_the_radio_carries() -> None:
    lines = drawn(report(state([session()], [peer()], budget=1362.5), 80))
    assert "1.36 kB/s 100%" in lines[0]
    assert "654 B 48%" in line_of(lines, " r1 ")


def test_what_was_dropped_and_spent_is_told() -> None:
    told = state([], [], dropped={"stale": 3, "bad_hash": 0}, spent={"updates": 5, "requests": 1000, "answers": 240})
    lines = drawn(report(told, 80))
    assert line_of(lines, "dropped").split() == ["dropped", "stale", "3"]
    assert line_of(lines, "spent").split(maxsplit=1)[1] == "updates 5 B, digests 0 B, repair 1.24 kB"
    assert line_of(drawn(report(state([], []), 80)), "dropped").split() == ["dropped", "nothing"]


def test_bytes_are_told_to_three_digits() -> None:
    spent = {"updates": 999, "digests": 999_499, "requests": 999_500}
    lines = drawn(report(state([], [], spent=spent), 80))
    assert line_of(lines, "spent").split(maxsplit=1)[1] == "updates 999 B, digests 999 kB, repair 1 MB"


def test_a_report_leaves_out_no_word() -> None:
    reason = "cell size 0.05 m, ours is 0.02 m; two live robots are called r1; silent for 14 s"
    text = " ".join(" ".join(drawn(report(state([session(summed=False, reason=reason)], [peer()]), 60), 60)).split())
    assert all(word in text for word in reason.split())


# Sizes


@settings(max_examples=15)
@given(st.integers(60, 200), st.integers(10, 60), st.integers(0, 40), st.booleans())
def test_it_fits_and_shows_the_map_and_as_many_robots_as_there_is_room_for(width, height, robots, colours) -> None:
    names = [f"robot{k}" for k in range(robots)]
    told = state([session(name) for name in names], [peer(name) for name in names])
    lines = drawn(screen(told, grid(ROOM), width, height, colours=colours), width, height)
    assert len(lines) <= height
    assert max(map(len, lines)) <= width
    assert any(mark in line for line in lines for mark in "█▀▄")
    shown = sum("●" in line for line in lines)
    assert shown == robots or line_of(lines, "more").split()[:2] == ["and", str(robots - shown)]


@pytest.mark.parametrize("width", [20, 160])
def test_a_terminal_that_is_hardly_there_is_drawn_on_too(width: int) -> None:
    for height in (1, 2, 3):
        assert drawn(screen(state([session()], [peer()]), grid(ROOM), width, height, colours=True), width, height)


def test_the_map_lies_beside_the_table_where_there_is_room() -> None:
    wide = drawn(screen(state([session()], [peer()]), grid(ROOM), 160, 50, colours=False), 160, 50)
    assert "█" in line_of(wide, " r1 ") or "▀" in line_of(wide, "robot  ")
    narrow = drawn(screen(state([session()], [peer()]), grid(ROOM), 80, 24, colours=False), 80, 24)
    assert "█" not in line_of(narrow, " r1 ")


# The map


def halves(evidence: Any, *, colours: bool, sessions: tuple = ()) -> list[tuple[str, str | None, str | None]]:
    """Glyphs with their ink and ground."""
    text = picture(state(list(sessions), []), grid(evidence), 80, 24, colours=colours)
    glyphs = []
    for place, glyph in enumerate(text.plain):
        style = text.get_style_at_offset(Console(), place)
        glyphs.append((glyph, style.color and style.color.name, style.bgcolor and style.bgcolor.name))
    return glyphs


@given(st.lists(st.lists(st.integers(-1, 1), min_size=5, max_size=5), min_size=2, max_size=8))
def test_colours_and_glyphs_together_are_the_map(evidence) -> None:
    small = Thumbnail.of(grid(evidence), 48, 80).cells
    found = np.full((len(small) + len(small) % 2, 5), 9)
    text = picture(state([], []), grid(evidence), 80, 24, colours=True)
    lines = text.split("\n")
    for k, line in enumerate(lines[: len(found) // 2]):
        for column in range(5):
            style = line.get_style_at_offset(Console(), column)
            ink = FREE if style.color else OCCUPIED
            ground = FREE if style.bgcolor else UNKNOWN
            pair = {"█": (ink, ink), "▀": (ink, ground), "▄": (ground, ink), " ": (UNKNOWN, UNKNOWN)}
            found[2 * k : 2 * k + 2, column] = pair[line.plain[column]]
    assert found[: len(small)].tolist() == small.tolist()


def test_without_colours_walls_are_blocks_and_what_is_free_is_dots() -> None:
    evidence = [[9, -9, 0, 9, 0], [9, -9, 0, 0, -9]]
    assert picture(state([], []), grid(evidence), 80, 24, colours=False).plain == "█· ▄·"


def test_a_robot_is_drawn_where_it_is_in_its_colour() -> None:
    ground = [[-9] * 4] * 4
    (column,) = [
        k for k, glyph in enumerate(halves(ground, colours=True, sessions=(session(),))) if glyph[1] == "#0072b2"
    ]
    assert (
        column == 4 + 1 + 1
    )  # after the first line and its end; x = y = 75 mm is the second cell from the west and from the south
    assert picture(state([session()], []), grid(ground), 80, 24, colours=False).plain == "····\n·o··"
    assert Color.parse(session()["colour"]).name == "#0072b2"


def test_robots_outside_the_map_or_gone_are_not_drawn() -> None:
    gone = [session(pose=[9000, 9000, 0]), session(live=False), session(pose=None)]
    assert "o" not in picture(state(gone, []), grid([[-9] * 4] * 4), 80, 24, colours=False).plain


def test_an_empty_map_is_no_picture() -> None:
    assert picture(state([session()], []), NOTHING, 80, 24, colours=True).plain == ""
