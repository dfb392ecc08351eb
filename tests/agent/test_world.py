"""Worlds: what a file may hold, how far a ray goes, and that the packaged worlds are good places to drive in."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.errors import UserError
from agent.world import World, load_world, world_names

SQUARE = """
walls:
  - [0, 0, 2, 0, 2, 2, 0, 2, 0, 0]
starts:
  - {x: 1, y: 1, yaw_deg: 90, waypoints: [[1.0, 1.5], [1, 1]]}
"""

ROBOT_CLEARANCE = 0.10
"""Metres from the centre of a robot of 12 x 12 cm to the nearest wall: its corners reach 8.5 cm."""

metres = st.floats(-3, 3).map(lambda v: round(v, 3))
angles = st.floats(-10, 10)


def world(*walls: tuple[float, float, float, float]) -> World:
    return World("test", np.array(walls, dtype=np.float64), (), ())


def one_ray(place: World, x: float, y: float, bearing: float) -> float:
    return float(place.cast(np.array([[x, y]]), np.array([bearing]))[0])


def write(folder: Path, text: str) -> Path:
    path = folder / "world.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def distance_to_walls(points: NDArray[np.float64], place: World) -> NDArray[np.float64]:
    """From each point to the nearest wall, straight from the definition of a segment."""
    nearest = np.full(len(points), np.inf)
    for wall in place.walls:
        a, along = wall[:2], wall[2:] - wall[:2]
        share = np.clip((points - a) @ along / (along @ along), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(a + share[:, None] * along - points, axis=1))
    return nearest


# Ray casting


@pytest.mark.parametrize(
    ("bearing_deg", "distance"),
    [(0, 1.5), (90, 1.25), (180, 0.5), (270, 0.75), (45, 1.25 * math.sqrt(2)), (-135, 0.5 * math.sqrt(2))],
)
def test_distances_in_a_square_room_are_those_of_a_ruler(tmp_path: Path, bearing_deg: float, distance: float) -> None:
    place = load_world(write(tmp_path, SQUARE))
    assert one_ray(place, 0.5, 0.75, math.radians(bearing_deg)) == pytest.approx(distance, abs=1e-12)


def test_the_nearest_wall_is_seen_and_none_behind() -> None:
    place = world((2, -1, 2, 1), (1, -1, 1, 1), (-0.5, -1, -0.5, 1))
    assert one_ray(place, 0, 0, 0.0) == pytest.approx(1.0)


def test_a_ray_that_meets_nothing_goes_on_for_ever() -> None:
    place = world((1, 1, 2, 1), (-1, -1, -1, 1))
    assert one_ray(place, 0, 0, 0.0) == math.inf


def test_a_wall_seen_along_its_length_is_met_at_its_end() -> None:
    assert one_ray(world((1, 0, 2, 0)), 0, 0, 0.0) == 1.0
    assert one_ray(world((2, 0, 1, 0)), 0, 0, 0.0) == 1.0


@given(x=metres, y=metres, bearing=angles, radius=st.floats(0.5, 5), corners=st.integers(3, 60))
def test_rays_in_a_regular_polygon_agree_with_its_half_planes(
    x: float, y: float, bearing: float, radius: float, corners: int
) -> None:
    """Inside a convex room the distance is the least over its sides' lines: an oracle without segments."""
    around = np.arange(corners) / corners * 2 * np.pi
    rim = np.column_stack([np.cos(around), np.sin(around)])
    place = world(*np.hstack([rim, np.roll(rim, -1, axis=0)]) * radius)
    inner = math.cos(math.pi / corners)
    origin = np.array([x, y]) / 3 / math.sqrt(2) * radius * inner * 0.99

    normals = np.column_stack([np.cos(around + np.pi / corners), np.sin(around + np.pi / corners)])
    speed = normals @ [math.cos(bearing), math.sin(bearing)]
    left = radius * inner - normals @ origin
    expected = min(gap / towards for gap, towards in zip(left, speed, strict=True) if towards > 1e-12)

    assert one_ray(place, *origin, bearing) == pytest.approx(expected, rel=1e-7)


@given(
    walls=st.lists(st.tuples(metres, metres, metres, metres), min_size=1, max_size=8),
    rays=st.lists(st.tuples(metres, metres, angles), min_size=1, max_size=8),
)
def test_rays_among_any_walls_agree_with_cramers_rule(
    walls: list[tuple[float, float, float, float]], rays: list[tuple[float, float, float]]
) -> None:
    """Wall by wall in plain Python; where a ray grazes a wall's end or lies along it, both answers are right."""
    distances = world(*walls).cast(np.array([ray[:2] for ray in rays]), np.array([ray[2] for ray in rays]))
    for (x, y, bearing), distance in zip(rays, distances.tolist(), strict=True):
        dx, dy = math.cos(bearing), math.sin(bearing)
        surely, perhaps = [], []
        for x0, y0, x1, y1 in walls:
            determinant = dx * (y0 - y1) - dy * (x0 - x1)
            if abs(determinant) < 1e-6:
                perhaps += [math.hypot(x0 - x, y0 - y), math.hypot(x1 - x, y1 - y), 0.0]
                continue
            along_ray = ((x0 - x) * (y0 - y1) - (y0 - y) * (x0 - x1)) / determinant
            along_wall = (dx * (y0 - y) - dy * (x0 - x)) / determinant
            if 1e-6 < along_wall < 1 - 1e-6 and along_ray > 1e-6:
                surely.append(along_ray)
            elif -1e-6 <= along_wall <= 1 + 1e-6 and along_ray > -1e-6:
                perhaps.append(along_ray)
        expected = min(surely, default=math.inf)
        assert distance <= expected + 1e-6
        assert any(distance == pytest.approx(right, abs=1e-5) for right in [expected, *perhaps]) or (
            perhaps and 0.0 in perhaps  # beside a parallel wall anything on it may be met
        )


@given(bearing=angles, x=metres, y=metres, turn=angles)
def test_no_ray_slips_out_between_two_walls_that_share_a_corner(
    bearing: float, x: float, y: float, turn: float
) -> None:
    corners = [(math.cos(turn + k), math.sin(turn + k)) for k in range(6)]
    place = world(*((*a, *b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)))
    inside = 0.1 * x, 0.1 * y
    aimed = [math.atan2(cy - inside[1], cx - inside[0]) for cx, cy in corners]
    for direction in (bearing, *aimed):
        assert one_ray(place, *inside, direction) < 2.0


# Files


def test_a_file_becomes_walls_starts_and_waypoints(tmp_path: Path) -> None:
    place = load_world(write(tmp_path, SQUARE))
    np.testing.assert_array_equal(place.walls, [[0, 0, 2, 0], [2, 0, 2, 2], [2, 2, 0, 2], [0, 2, 0, 0]])
    assert (place.starts[0].x, place.starts[0].y) == (1.0, 1.0)
    assert place.starts[0].yaw == pytest.approx(math.pi / 2)
    np.testing.assert_array_equal(place.waypoints[0], [[1, 1.5], [1, 1]])


def test_a_path_may_be_given_as_text(tmp_path: Path) -> None:
    assert len(load_world(str(write(tmp_path, SQUARE))).walls) == 4


BAD = {
    "a misspelt key": (SQUARE.replace("walls:", "wals:"), "wals", "unknown key", "did you mean walls?"),
    "a misspelt key of a start": (SQUARE.replace("yaw_deg", "yaw"), "starts[0].yaw", "unknown key", "yaw_deg"),
    "a key too many": (SQUARE + "robots: 3\n", "robots", "unknown key", "Known are walls, starts"),
    "a key that is a number": ("1: 2\n" + SQUARE, "1", "keys should be strings", ""),
    "no walls": ("walls: []\n" + SQUARE[SQUARE.index("starts") :], "walls", "at least 1 item", ""),
    "walls left out": (SQUARE[SQUARE.index("starts") :], "walls", "is missing", "add it"),
    "walls that are a number": ("walls: 3\n" + SQUARE[SQUARE.index("starts") :], "walls", "valid list", ""),
    "no starts": (SQUARE[: SQUARE.index("starts")] + "starts: []\n", "starts", "at least 1 item", ""),
    "no waypoints": (SQUARE.replace("[[1.0, 1.5], [1, 1]]", "[]"), "starts[0].waypoints", "at least 1 item", ""),
    "a waypoint of three numbers": (SQUARE.replace("[1.0, 1.5]", "[1, 1, 1]"), "waypoints[0]", "at most 2", ""),
    "not a number": (SQUARE.replace("1.5", ".nan"), "starts[0].waypoints[0][1]", "finite number", ""),
    "an infinite wall": (SQUARE.replace("[0, 0, 2", "[0, 0, .inf"), "walls[0][2]", "finite number", ""),
    "a heading that is text": (SQUARE.replace("90", "north"), "starts[0].yaw_deg", "valid number, got 'north'", ""),
    "a wall of one corner": (SQUARE.replace("[0, 0, 2", "[0, 0]\n  - [0, 0, 2"), "walls[0]", "two corners", ""),
    "half a corner": (SQUARE.replace("[0, 0, 2", "[0, 0, 0, 2"), "walls[0]", "got 11 numbers", ""),
    "a corner twice": (SQUARE.replace("[0, 0, 2", "[0, 0, 0, 0, 2"), "walls[0]", "twice in a row", ""),
    "a wall on the moon": (SQUARE.replace("[0, 0, 2", "[0, 0, 4e8"), "walls[0][2]", "number", ""),
    "a list": ("- 1\n", "world.yaml", "expected a mapping", "walls and starts"),
    "nothing": ("", "world.yaml", "expected a mapping", "walls and starts"),
    "not YAML": ("walls: [1, 2\nstarts: }", "world.yaml:2", "not YAML", "compare it"),
    "a date that is none": ("walls: 2024-99-99", "world.yaml", "not YAML", "compare it"),
    "brackets without end": ("[" * 100_000, "world.yaml", "not YAML", "compare it"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_in_one_line_that_names_place_fault_and_remedy(tmp_path: Path, case: str) -> None:
    text, where, what, remedy = BAD[case]
    with pytest.raises(UserError) as caught:
        load_world(write(tmp_path, text))
    assert where in caught.value.where
    assert what in caught.value.what
    assert remedy in caught.value.remedy
    assert "world.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "world.yaml"
    path.write_bytes(b"\xff\xfe\xfd")
    with pytest.raises(UserError, match="not YAML"):
        load_world(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no such file.*paper, rooms"):
        load_world(tmp_path / "nowhere.yaml")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError):
        load_world(tmp_path)


def test_an_unknown_name_lists_the_worlds_there_are() -> None:
    with pytest.raises(UserError, match="paper, rooms"):
        load_world("paperr")


# The packaged worlds


def test_the_packaged_worlds_are_the_papers_and_the_rooms() -> None:
    assert world_names() == ["paper", "rooms"]


def test_the_papers_robots_start_where_the_paper_says() -> None:
    first, second = load_world("paper").starts
    assert (first.x, first.y, round(math.degrees(first.yaw), 9)) == (0.0, 0.0, 90.0)
    assert (second.x, second.y, round(math.degrees(second.yaw), 9)) == (2.150, 1.450, 10.0)


def test_the_papers_spaces_are_apart() -> None:
    walls = load_world("paper").walls
    first, second = walls[:-4].reshape(-1, 2), walls[-4:].reshape(-1, 2)
    assert second[:, 0].min() - first[:, 0].max() > 0.3


def test_the_papers_second_space_is_a_rectangle_turned_by_ten_degrees() -> None:
    sides = np.diff(load_world("paper").walls[-4:].reshape(-1, 2, 2), axis=1)[:, 0]
    np.testing.assert_allclose(np.linalg.norm(sides, axis=1), [1.6, 1.1, 1.6, 1.1], atol=0.002)
    turned = np.degrees(np.arctan2(sides[:, 1], sides[:, 0])) % 90
    np.testing.assert_allclose(turned, 10.0, atol=0.1)


def test_the_rooms_have_four_robots() -> None:
    place = load_world("rooms")
    assert len(place.starts) == 4
    np.testing.assert_allclose(np.ptp(place.walls.reshape(-1, 2), axis=0), [5.0, 4.0])


@pytest.mark.parametrize("name", world_names())
def test_every_way_keeps_clear_of_the_walls(name: str) -> None:
    place = load_world(name)
    for start, waypoints in zip(place.starts, place.waypoints, strict=True):
        corners = np.vstack([[start.x, start.y], waypoints])
        way = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(corners)])
        assert distance_to_walls(way, place).min() >= ROBOT_CLEARANCE


@pytest.mark.parametrize("name", world_names())
def test_every_robot_is_walled_in(name: str) -> None:
    """Whatever way a robot looks from any of its waypoints, there is a wall at the end."""
    place = load_world(name)
    bearings = np.linspace(0, 2 * np.pi, 360)
    for waypoint in np.concatenate(place.waypoints):
        assert np.isfinite(place.cast(np.tile(waypoint, (len(bearings), 1)), bearings)).all()
