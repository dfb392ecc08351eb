"""Worlds: what a file may hold, how far a ray goes, and that the packaged worlds are good places to drive in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.errors import UserError
from agent.kinematics import ORION_CHASSIS
from agent.packaged_worlds import world_names
from agent.world import NEAR, World, load_world
from mapping.pose import FULL_TURN
from mapping.sensor import orion

SQUARE = """
walls:
  - [0, 0, 2, 0, 2, 2, 0, 2, 0, 0]
starts:
  - {x: 1, y: 1, yaw_deg: 90, waypoints: [[1.0, 1.5], [1, 1]]}
"""

PICTURE = """
image: map.pgm
resolution: 0.1
origin: [-0.2, -0.2, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""

ROBOT_CLEARANCE = 0.10
"""Metres from the centre of a robot of 12 x 12 cm to the nearest wall: its corners reach 8.5 cm."""

ERRANDS = ["paper", "rooms"]
"""The packaged worlds whose robots have waypoints."""

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


def along_walls(place: World) -> NDArray[np.float64]:
    """Points at most 1 cm apart along all walls."""
    lengths = np.hypot(*(place.walls[:, 2:] - place.walls[:, :2]).T)
    pairs = zip(place.walls, lengths, strict=True)
    return np.concatenate([np.linspace(wall[:2], wall[2:], math.ceil(length / 0.01) + 1) for wall, length in pairs])


def way(place: World, index: int) -> NDArray[np.float64]:
    """Poses on a robot's errand, shape (N, 3): every centimetre of the way and every 3 degrees of the turns."""
    start = place.starts[index]
    poses = [np.array([[start.x, start.y, start.yaw]])]
    for there in place.waypoints[index]:
        x, y, yaw = poses[-1][-1]
        towards = math.atan2(there[1] - y, there[0] - x)
        turn = (towards - yaw + math.pi) % (2 * math.pi) - math.pi
        poses.append(np.linspace([x, y, yaw], [x, y, yaw + turn], 61))
        poses.append(
            np.linspace([x, y, yaw + turn], [*there, yaw + turn], math.ceil(math.hypot(*(there - [x, y])) * 100))
        )
    return np.concatenate(poses)


def hits(place: World, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where an Orion's beams meet walls from there, as far as they see."""
    x_mm, y_mm, bearing, _ = orion().table.T
    x, y, yaw = poses.T[:, :, None]
    origins = np.stack(
        [x + (np.cos(yaw) * x_mm - np.sin(yaw) * y_mm) / 1000, y + (np.sin(yaw) * x_mm + np.cos(yaw) * y_mm) / 1000], -1
    ).reshape(-1, 2)
    bearings = (yaw + bearing / FULL_TURN * 2 * np.pi).ravel()
    reach = place.cast(origins, bearings)
    seen = reach <= 0.8
    return (origins + reach[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)]))[seen]


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


def test_a_robot_may_be_without_waypoints(tmp_path: Path) -> None:
    place = load_world(write(tmp_path, SQUARE.replace(", waypoints: [[1.0, 1.5], [1, 1]]", "")))
    assert place.waypoints[0].shape == (0, 2)


def test_obstacles_move_along_their_waypoints(tmp_path: Path) -> None:
    more = """
obstacles:
  - {shape: disc, radius: 0.1, speed: 0.2, waypoints: [[1, 1], [2, 1]]}
  - {shape: box, radius: 0.2, speed: 0.0, waypoints: [[0.5, 0.5]], loop: true}
"""
    cat, crate = load_world(write(tmp_path, SQUARE + more)).obstacles
    assert (cat.shape, cat.radius, cat.speed, cat.loop) == ("disc", 0.1, 0.2, False)
    assert cat.at(1.25).tolist() == [1.75, 1.0]
    assert (crate.shape, crate.loop, crate.at(3.0).tolist()) == ("box", True, [0.5, 0.5])


def picture(folder: Path) -> None:
    """A room of 1.2 x 0.8 m, its lower left corner at the origin, unknown (205) beyond its walls."""
    pixels = np.full((14, 18), 205, np.uint8)
    pixels[1:13, 1:17] = 0
    pixels[3:11, 3:15] = 254
    (folder / "map.pgm").write_bytes(b"P5 18 14 255\n" + pixels.tobytes())
    (folder / "map.yaml").write_text(PICTURE.replace("-0.2, -0.2", "-0.3, -0.3"))


def test_the_occupied_cells_of_an_image_are_walls(tmp_path: Path) -> None:
    picture(tmp_path)
    place = load_world(write(tmp_path, "image: map.yaml\nstarts: [{x: 0.5, y: 0.5, yaw_deg: 0}]"))
    assert place.walls.shape == (0, 4)
    assert one_ray(place, 0.5, 0.5, 0.0) == pytest.approx(0.7)
    assert one_ray(place, 0.5, 0.5, math.pi / 2) == pytest.approx(0.3)
    assert place.clearance(np.array([[0.1, 0.45], [0.6, 0.4]])) == pytest.approx([0.1, 0.4])


def test_an_image_and_walls_make_one_world(tmp_path: Path) -> None:
    picture(tmp_path)
    walls = "walls: [[0.8, 0, 0.8, 0.8]]"
    place = load_world(write(tmp_path, f"image: map.yaml\n{walls}\nstarts: [{{x: 0.5, y: 0.5, yaw_deg: 0}}]"))
    assert one_ray(place, 0.5, 0.5, 0.0) == pytest.approx(0.3)
    assert one_ray(place, 0.5, 0.5, math.pi) == pytest.approx(0.5)
    assert place.clearance(np.array([[0.7, 0.4], [0.2, 0.4], [9.0, 0.4]])) == pytest.approx([0.1, 0.2, NEAR])


def test_a_missing_image_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"nowhere\.yaml.*cannot be read"):
        load_world(write(tmp_path, "image: nowhere.yaml\nstarts: [{x: 0.5, y: 0.5, yaw_deg: 0}]"))


def test_how_far_one_may_look_does_not_change_what_is_near(tmp_path: Path) -> None:
    picture(tmp_path)
    place = load_world(write(tmp_path, "image: map.yaml\nstarts: [{x: 0.5, y: 0.5, yaw_deg: 0}]"))
    origins, bearings = np.full((90, 2), 0.41), np.linspace(0, 6, 90)
    whole, near = place.cast(origins, bearings), place.cast(origins, bearings, 0.5)
    np.testing.assert_array_equal(near[near <= 0.5], whole[whole <= 0.5])
    assert (near[whole > 0.5] > 0.5).all()


def test_many_rays_are_one_by_one_the_same() -> None:
    """They are cast in batches."""
    place = load_world("office")
    origins, bearings = np.tile([[0.6, 3.0]], (5000, 1)), np.linspace(0, 6, 5000)
    distances = place.cast(origins, bearings)
    np.testing.assert_array_equal(distances[::500], [one_ray(place, 0.6, 3.0, b) for b in bearings[::500]])


BOX = "obstacles: [{shape: box, radius: 0.1, speed: 0.2, waypoints: [[1, 1]]}]"

BAD = {
    "a misspelt key": (SQUARE.replace("walls:", "wals:"), "wals", "unknown key", "did you mean walls?"),
    "a misspelt key of a start": (SQUARE.replace("yaw_deg", "yaw"), "starts[0].yaw", "unknown key", "yaw_deg"),
    "a key too many": (SQUARE + "robots: 3\n", "robots", "unknown key", "Known are walls, image, starts, obstacles"),
    "a key that is a number": ("1: 2\n" + SQUARE, "1", "keys should be strings", ""),
    "no walls": ("walls: []\n" + SQUARE[SQUARE.index("starts") :], "walls", "at least 1 item", ""),
    "walls left out": (SQUARE[SQUARE.index("starts") :], "walls", "is missing", "add it, or an image"),
    "starts left out": (SQUARE[: SQUARE.index("starts")], "starts", "is missing", "add it"),
    "a misspelt key of an obstacle": (SQUARE + BOX.replace("speed", "sped"), "obstacles[0].sped", "unknown", "speed"),
    "an obstacle of no shape": (SQUARE + BOX.replace("box", "cube"), "obstacles[0].shape", "'disc' or 'box'", ""),
    "an obstacle without size": (SQUARE + BOX.replace("0.1", "0"), "obstacles[0].radius", "greater than 0", ""),
    "an obstacle that is nowhere": (SQUARE + BOX.replace("[[1, 1]]", "[]"), "obstacles[0].waypoints", "at least 1", ""),
    "a loop that is text": (SQUARE + BOX.replace("}", ", loop: 'no'}"), "obstacles[0].loop", "boolean", ""),
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
    with pytest.raises(UserError, match=r"no such file.*office, paper, rectangle, rooms"):
        load_world(tmp_path / "nowhere.yaml")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError):
        load_world(tmp_path)


def test_an_unknown_name_lists_the_worlds_there_are() -> None:
    with pytest.raises(UserError, match="crossing, office, paper, rectangle, rooms"):
        load_world("paperr")


# The packaged worlds


def test_the_packaged_worlds_are_the_papers_the_rooms_and_the_office() -> None:
    assert world_names() == ["crossing", "office", "paper", "rectangle", "rooms"]


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
    for index in range(len(place.starts)):
        assert place.clearance(way(place, index)[:, :2]).min() >= ROBOT_CLEARANCE


@pytest.mark.parametrize("name", world_names())
def test_robots_start_clear_of_each_other(name: str) -> None:
    starts = np.array([(start.x, start.y) for start in load_world(name).starts])
    apart = np.hypot(*(starts[:, None] - starts).transpose(2, 0, 1))
    assert apart[~np.eye(len(starts), dtype=np.bool_)].min(initial=np.inf) > 4 * ORION_CHASSIS.radius


@pytest.mark.parametrize("name", world_names())
def test_every_robot_is_walled_in(name: str) -> None:
    """Whatever way a robot looks from its start or any of its waypoints, there is a wall at the end."""
    place = load_world(name)
    bearings = np.linspace(0, 2 * np.pi, 360)
    starts = np.array([(start.x, start.y) for start in place.starts])
    for point in np.concatenate([starts, *place.waypoints]):
        assert np.isfinite(place.cast(np.tile(point, (len(bearings), 1)), bearings)).all()


@pytest.mark.parametrize("name", ERRANDS)
def test_the_robots_together_see_the_walls(name: str) -> None:
    """At least 95 % of the points every 1 cm along the walls lie within 4 cm of where a beam ends."""
    place = load_world(name)
    seen = np.concatenate([hits(place, way(place, index)) for index in range(len(place.starts))])
    points = np.unique(np.rint(seen * 200), axis=0) / 200  # 5 mm, for speed
    gaps = [np.hypot(*(points - wall_point).T).min() for wall_point in along_walls(place)]
    assert np.mean(np.array(gaps) <= 0.04) >= 0.95


def test_every_room_is_seen_by_its_own_robot_and_by_another() -> None:
    """Else the overlap of the robots' maps would be the corridor alone."""
    rooms = {"r1": (0, 2.2, 0, 1.48), "r2": (2.2, 5, 0, 1.48), "r3": (0, 2.9, 2.52, 4), "r4": (2.9, 5, 2.52, 4)}
    place = load_world("rooms")
    visitors = dict.fromkeys(rooms, 0)
    for index in range(4):
        x, y = hits(place, way(place, index)).T
        for room, (west, east, south, north) in rooms.items():
            inside = (x > west - 0.02) & (x < east + 0.02) & (y > south - 0.02) & (y < north + 0.02)
            visitors[room] += int(inside.sum() > 20)
    assert visitors == {"r1": 2, "r2": 2, "r3": 2, "r4": 2}


def test_the_offices_robots_find_their_own_way_and_there_are_six_or_more() -> None:
    place = load_world("office")
    assert len(place.starts) >= 6
    assert all(len(waypoints) == 0 for waypoints in place.waypoints)
    np.testing.assert_allclose(np.ptp(place.walls.reshape(-1, 2), axis=0), [8.0, 6.0])


def test_every_robot_can_drive_up_to_every_wall_of_the_office() -> None:
    """A flood from one start, on a lattice of 4 cm, through all that is clear by a robot's radius and 1.5 cm."""
    place, step = load_world("office"), 0.04
    columns, rows = round(8 / step), round(6 / step)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * step, (np.arange(rows) + 0.5) * step)
    clear = place.clearance(np.column_stack([x.ravel(), y.ravel()])).reshape(rows, columns) >= ROBOT_CLEARANCE
    starts = [(int(start.y / step), int(start.x / step)) for start in place.starts]
    reached, edge = np.zeros_like(clear), {starts[0]}
    while edge:
        for cell in edge:
            reached[cell] = True
        beside = {(j + dj, i + di) for j, i in edge for dj, di in ((0, 1), (0, -1), (1, 0), (-1, 0))}
        edge = {cell for cell in beside if clear[cell] and not reached[cell]}
    assert all(reached[start] for start in starts)
    there = np.column_stack([x[reached], y[reached]])
    away = [np.hypot(*(there - point).T).min() for point in along_walls(place)[::10]]
    assert max(away) < 0.2


def test_the_offices_doors_are_wide_enough_for_a_robot_that_is_a_little_lost() -> None:
    """Through the middle of each door, along the wall: 0.6 m or more from post to post."""
    place = load_world("office")
    doors = [(1.95, 2.45), (3.325, 2.45), (6.35, 2.45), (1.35, 3.55), (4.125, 3.55), (6.6, 3.55)]
    for x, y in doors:
        assert one_ray(place, x, y, 0.0) + one_ray(place, x, y, math.pi) >= 0.6
    assert one_ray(place, 5.25, 0.85, math.pi / 2) + one_ray(place, 5.25, 0.85, -math.pi / 2) >= 0.6


@pytest.mark.parametrize(
    ("waypoints", "at"), [("[[3, 1]]", 0), ("[[1, 1.5], [1.5, 1], [1, 2.5]]", 2), ("[[1, 1], [2, 1]]", None)]
)
def test_a_wall_between_waypoints_is_told_when_the_world_is_loaded(tmp_path, waypoints: str, at: int | None) -> None:
    """A robot drives straight: it would stand before the wall and give its waypoints up one after the other."""
    path = write(tmp_path, SQUARE.replace("[[1.0, 1.5], [1, 1]]", waypoints))
    if at is None:  # on the wall, not behind it
        load_world(path)
        return
    with pytest.raises(UserError, match=rf"starts\[0\].waypoints\[{at}\]: a wall stands"):
        load_world(path)
