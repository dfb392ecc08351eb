"""From options to a whole swarm: which robot gets which start, which recording, which piece."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import pytest

from agent.config import Config, RecordedBody, Robot, SerialBody, load, resolve
from agent.errors import UserError
from agent.launch import demo_config, replay_config
from agent.world import load_world


def log(path: Path, scans: int = 10) -> Path:
    """A CARMEN log of a robot that drives 1 m a scan."""
    path.write_text("".join(f"FLASER 2 1.0 2.0 {k} 0 0 {k} 0 0 {k} host {k}\n" for k in range(scans)))
    return path


def demo(base: Config, **options: Any) -> Config:
    return demo_config(base, **{"world": "paper", "robots": None, "speed": 10.0, "seed": 1} | options)


def replay(base: Config, *recordings: Path, **options: Any) -> Config:
    return replay_config(
        base, recordings, **{"robots": None, "poses": None, "max_range": None, "speed": "max"} | options
    )


def wired(robot: Robot) -> SerialBody:
    assert isinstance(robot.body, SerialBody)
    return robot.body


def recorded(robot: Robot) -> RecordedBody:
    assert isinstance(robot.body, RecordedBody)
    return robot.body


# demo


def test_a_demo_has_a_robot_for_each_of_the_worlds_starts() -> None:
    config = demo(Config(), world="rooms", seed=7)
    assert config.roster == ["r1", "r2", "r3", "r4"]
    world = load_world("rooms")
    for robot, start in zip(config.robots.values(), world.starts, strict=True):
        assert robot.start is not None
        assert (robot.start.x, robot.start.y) == (start.x, start.y)
        assert math.isclose(math.radians(robot.start.yaw_deg), start.yaw, abs_tol=1e-9)
    assert [wired(robot).port for robot in config.robots.values()] == ["r1.tty", "r2.tty", "r3.tty", "r4.tty"]
    for robot, waypoints in zip(config.robots.values(), world.waypoints, strict=True):
        assert wired(robot).waypoints == [tuple(waypoint) for waypoint in waypoints.tolist()]
    assert (config.simulation.world, config.simulation.seed, config.simulation.speed) == ("rooms", 7, 10.0)


def test_a_demo_of_fewer_robots_takes_the_first_starts() -> None:
    config = demo(Config(), world="rooms", robots=2, speed="max")
    assert config.roster == ["r1", "r2"]
    starts = [robot.start for robot in config.robots.values()]
    assert [(start.x, start.y) for start in starts if start] == [(s.x, s.y) for s in load_world("rooms").starts[:2]]
    assert config.simulation.speed == "max"


def test_the_files_roster_and_starts_stand_in_a_demo() -> None:
    base = resolve(
        {"cell": 0.05, "robots": {"b": {"start": {"x": 1.0}, "publish": "tiles"}, "a": {"host": "127.0.0.2"}}}
    )
    config = demo(base)
    assert config.roster == ["b", "a"]
    assert config.cell == 0.05
    b, a = config.robots.values()
    assert b.start is not None
    assert (b.start.x, b.start.y, b.start.yaw_deg, b.publish) == (1.0, 0.0, 0.0, "tiles")  # believed, not true
    assert a.start is not None
    assert (a.start.x, a.start.y, a.start.yaw_deg, a.host) == (2.15, 1.45, 10.0, "127.0.0.2")
    assert [wired(robot).port for robot in (b, a)] == ["b.tty", "a.tty"]
    first, second = (waypoints.tolist() for waypoints in load_world("paper").waypoints)
    assert wired(b).waypoints == [tuple(waypoint) for waypoint in first]
    assert wired(a).waypoints == [tuple(waypoint) for waypoint in second]


def test_the_files_noise_stands_in_a_demo_that_chooses_world_seed_and_speed() -> None:
    base = resolve({"simulation": {"world": "rooms", "seed": 5, "noise": {"slip": 0.2}}})
    config = demo(base, seed=9)
    assert config.simulation.noise == base.simulation.noise
    assert (config.simulation.world, config.simulation.seed) == ("paper", 9)


@pytest.mark.parametrize("robots", [-1, 0, 3])
def test_a_demo_of_more_robots_than_starts_is_refused(robots: int) -> None:
    with pytest.raises(UserError, match=f"--robots: is {robots}, but world 'paper' has 2 starts; give 1 to 2"):
        demo(Config(), robots=robots)


def test_a_roster_and_another_number_of_robots_is_refused() -> None:
    base = resolve({"robots": {"a": {}}})
    assert demo(base, robots=1).roster == ["a"]
    with pytest.raises(UserError, match="--robots: is 2, but the file names 1; give one or the other"):
        demo(base, robots=2)
    with pytest.raises(UserError, match="--robots: is 3, but world 'paper' has 2 starts"):
        demo(resolve({"robots": {name: {} for name in "abc"}}))


def test_a_world_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UserError, match="world atlantis"):
        demo(Config(), world="atlantis")


def test_a_worlds_file_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.yaml").write_text(
        "walls: [[0, 0, 1, 0]]\nstarts: [{x: 0, y: 1, yaw_deg: 0, waypoints: [[1, 1]]}]\n"
    )
    monkeypatch.chdir(tmp_path)
    assert demo(Config(), world="mine.yaml").simulation.world == str(tmp_path / "mine.yaml")


# replay


def test_recordings_without_a_roster_become_r1_r2_at_the_origin(tmp_path: Path) -> None:
    logs = [log(tmp_path / "b.log"), log(tmp_path / "a.log")]
    config = replay(Config(), *logs, poses="slam", max_range=5.0)
    assert config.roster == ["r1", "r2"]
    for robot, path in zip(config.robots.values(), logs, strict=True):
        assert robot.start is not None
        assert (robot.start.x, robot.start.y, robot.start.yaw_deg) == (0, 0, 0)
        assert recorded(robot).path == str(path)
        assert (recorded(robot).poses, recorded(robot).max_range, recorded(robot).speed) == ("slam", 5.0, "max")


def test_the_kth_recording_is_the_kth_robot_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("[robots.z]\nstart = {x = 1.0}\n[robots.a]\nstart = {y = 2.0}\n[robots.m]\n")
    logs = [log(tmp_path / f"{k}.log") for k in (3, 1, 2)]
    config = replay(load(file, {}, {}), *logs)
    assert config.roster == ["z", "a", "m"]
    assert [recorded(robot).path for robot in config.robots.values()] == [str(path) for path in logs]
    starts = [robot.start for robot in config.robots.values()]
    assert [(start.x, start.y) for start in starts if start] == [(1.0, 0.0), (0.0, 2.0), (0.0, 0.0)]


def test_one_log_is_cut_into_robots_that_share_its_frame(tmp_path: Path) -> None:
    config = replay(Config(), log(tmp_path / "a.log"), robots=3)
    bodies = [recorded(robot) for robot in config.robots.values()]
    assert [(body.part, body.parts) for body in bodies] == [(1, 3), (2, 3), (3, 3)]
    assert len({body.path for body in bodies}) == 1
    assert [robot.start for robot in config.robots.values()] == [
        replay(Config(), log(tmp_path / "a.log")).robots["r1"].start
    ] * 3


def test_one_log_is_cut_for_a_roster(tmp_path: Path) -> None:
    base = resolve({"robots": {"a": {}, "b": {}}})
    config = replay(base, log(tmp_path / "a.log"), robots=2)
    assert {name: recorded(robot).part for name, robot in config.robots.items()} == {"a": 1, "b": 2}


@pytest.mark.parametrize("count", [1, 3])
def test_a_roster_of_another_length_is_refused(tmp_path: Path, count: int) -> None:
    base = resolve({"robots": {f"r{k}": {} for k in range(count)}})
    with pytest.raises(
        UserError, match=f"robots: {count} in the file, but the recordings hold 2; name a robot for each"
    ):
        replay(base, log(tmp_path / "a.log"), log(tmp_path / "b.log"))


def test_a_number_of_robots_that_the_recordings_do_not_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="--robots: is 3, but the recordings hold 2; leave the option out"):
        replay(Config(), log(tmp_path / "a.log"), log(tmp_path / "b.log"), robots=3)
    assert len(replay(Config(), log(tmp_path / "a.log"), log(tmp_path / "b.log"), robots=2).robots) == 2


def test_a_log_that_cannot_be_cut_so_often_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="3 scans cannot become 4 robots"):
        replay(Config(), log(tmp_path / "a.log", scans=3), robots=4)


def test_a_bad_recording_among_good_ones_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.log: there is no such file"):
        replay(Config(), log(tmp_path / "a.log"), tmp_path / "none.log")


def test_a_range_too_long_for_the_cells_is_refused_before_anything_starts(tmp_path: Path) -> None:
    """It once came from the robots, when the observer had an empty map written over the last one."""
    with pytest.raises(
        UserError, match=r"a\.log: max_range: 20\.0 m is more than 4095 cells .* give a shorter --max-r"
    ):
        replay(resolve({"cell": 0.004}), log(tmp_path / "a.log"))
    assert replay(resolve({"cell": 0.004}), log(tmp_path / "a.log"), max_range=16.0).cell == 0.004


def test_a_recording_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log(tmp_path / "a.log")
    monkeypatch.chdir(tmp_path)
    assert recorded(replay(Config(), Path("a.log")).robots["r1"]).path == str(tmp_path / "a.log")


def test_a_recordings_name_that_no_toml_can_hold_is_refused(tmp_path: Path) -> None:
    """It once was a UnicodeEncodeError when the resolved configuration was written."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.log"))
    with pytest.raises(UserError, match=r"udcff\.log: is no name in UTF-8"):
        replay(Config(), log(path))


def test_a_nano_swarm_folder_is_as_many_robots_as_it_holds(tmp_path: Path) -> None:
    node = "".join(["00000000"] + [("6400" * 32) + "00" * 12 for _ in range(15)])
    (tmp_path / "scans.csv").write_text(f"0/0,{node}\n1/0,{node}\n")
    (tmp_path / "vicon_poses.csv").write_text("0/0,0,0,0,1,0,0,0\n1/0,1,0,0,1,0,0,0\n")
    config = replay(Config(), tmp_path)
    assert [recorded(robot).robot for robot in config.robots.values()] == [0, 1]
    with pytest.raises(UserError, match="--robots: is 3, but the recordings hold 2"):
        replay(Config(), tmp_path, robots=3)


def test_what_is_resolved_loads_again_as_itself(tmp_path: Path) -> None:
    file = tmp_path / "orion.toml"
    config = replay(Config(), log(tmp_path / "a.log"), robots=3, max_range=3.0)
    file.write_bytes(config.toml())
    assert load(file, {}, {}) == config


def test_a_resolved_demo_finds_its_ports_beside_it_and_makes_the_same_demo_again(tmp_path: Path) -> None:
    file = tmp_path / "orion.toml"
    config = demo(Config(), world="rooms")
    file.write_bytes(config.toml())
    loaded = load(file, {}, {})
    assert [wired(robot).port for robot in loaded.robots.values()] == [str(tmp_path / f"r{k}.tty") for k in range(1, 5)]
    assert demo(loaded, world="rooms") == config
