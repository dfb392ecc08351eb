"""What operators decide in a running swarm of real processes: the map is that of a run that had it right all along."""

from __future__ import annotations

import math
from typing import Any

import pytest

from agent.map_files import save_map
from agent.playback import read
from mapping.pose import Pose

pytestmark = pytest.mark.processes

CELL = 0.05
ROBOTS = ("r1", "r2", "r3")
RIGHT = {"r1": Pose(), "r2": Pose(0.35, -0.2, math.radians(25)), "r3": Pose(-1.0, 0.5, math.radians(-90))}


@pytest.fixture
def lab(swarm):
    """The TOML of three robots that need four seconds each; it has r2 start where it did not, and nothing of r3's."""
    robots = {}
    for name, scans in zip(ROBOTS, (55, 60, 50), strict=True):
        log = swarm.log(f"{name}.log", scans=scans, seconds=4.0)
        robots[name] = {"body": {"kind": "recording", "path": str(log), "speed": 1.0}}
    robots["r1"]["start"] = {}
    robots["r2"]["start"] = {"x": 1.0, "y": 1.0, "yaw_deg": 77.0}
    return swarm.toml(robots, cell=CELL)


def start_pose(orion, lab, robot):
    """``orion start-pose`` with the right one; gives what it says."""
    pose = RIGHT[robot]
    where = ("--x", pose.x, "--y", pose.y, "--yaw-deg", math.degrees(pose.yaw))
    return orion("start-pose", robot, *where, "-c", lab, "--json").report()


def test_start_poses_given_on_the_way_and_robots_taken_out_and_in_again(orion, swarm, lab, truth) -> None:
    recordings = {name: read(swarm.folder / f"{name}.log")[0] for name in ROBOTS}

    def agree(*members) -> dict[str, int]:
        """Wait until all have the same, and have had no news for a while."""
        known = members[0].hears_no_more()
        for member in members[1:]:
            member.knows(lambda positions: positions == known)
        return known

    def observer(name: str) -> Any:
        return orion("observe", "-c", lab, "--out", swarm.folder / name, "--supervised")

    def ends_with_the_map_of(member, *names: str) -> str:
        """What an observer writes is, cell for cell, the map made of those robots' scans without any network."""
        report = member.finish()
        grid = truth.map_of([recordings[name] for name in names], CELL, [RIGHT[name] for name in names])
        right = save_map(swarm.folder, "right", grid)["npz"]
        diff = orion("map", "diff", report["files"]["npz"], right, "--json").report()
        assert (diff["equal"], diff["differing"]) == (True, 0)
        assert set(diff["digests"]) == {report["map_digest"]}
        return str(report["map_digest"])

    watch = observer("watch")
    agents = [orion("agent", "-c", lab, "--robot", name, "--supervised") for name in ROBOTS]
    for member in (watch, *agents):
        member.is_ready()
    for agent in agents:
        agent.order("go")

    # in the middle of the run: one robot was started elsewhere, of the other nobody knew where
    watch.knows(lambda known: len(known) == 3 and min(known.values()) >= 10)
    assert any("no start pose" in reason for reason in watch.status["apart"].values())
    result = start_pose(orion, lab, "r2")
    assert (result["before"]["x"], result["pending"], result["missing"]) == (1.0, False, [])
    assert start_pose(orion, lab, "r3")["before"] is None
    for agent in agents:
        if not agent.status.get("done"):
            agent.says(lambda event: event.get("done") is True)
    wrong = {session for session, reason in watch.status["apart"].items() if "replaced by" in reason}
    known = agree(watch, *agents)
    assert len(known) == 3
    assert len(wrong | {s for s, reason in watch.status["apart"].items() if "replaced by" in reason}) == 2

    # taken out: also for who was away
    evicted = orion("evict", "r2", "-c", lab, "--json").report()
    assert evicted["session"] in known
    assert (evicted["changed"], evicted["missing"]) == (True, [])
    late = observer("late")
    late.knows(lambda positions: positions == known)
    for each in (watch, late):
        ends_with_the_map_of(each, "r1", "r3")

    # taken in again
    readmitted = orion("evict", evicted["session"][:6], "--readmit", "-c", lab, "--json").report()
    assert (readmitted["session"], readmitted["changed"], readmitted["missing"]) == (evicted["session"], True, [])
    last = observer("last")
    last.knows(lambda positions: positions == known)
    reports = [agent.finish() for agent in agents]
    digest = ends_with_the_map_of(last, *ROBOTS)
    assert {report["map_digest"] for report in reports} == {digest}
    assert [report["scans"] for report in reports] == [55, 60, 50]


def test_where_nobody_is_or_the_robot_is_unknown_it_is_said_and_nothing_is_decided(orion, lab) -> None:
    nobody = orion("evict", "r2", "-c", lab)
    assert nobody.ends() == 1
    assert "nobody of swarm orion is there" in nobody.errors
    observer = orion("agent", "-c", lab, "--robot", "r1", "--supervised")
    observer.is_ready()
    unknown = orion("start-pose", "r9", "--x", 0, "--y", 0, "--yaw-deg", 0, "-c", lab)
    assert unknown.ends() == 2
    assert unknown.errors.strip() == "orion: ROBOT: 'r9' is unknown; robots there are: r1, r2, r3"
    no_session = orion("evict", "ffff", "-c", lab)
    assert no_session.ends() == 2
    assert "'ffff' is no session or robot; give one of" in no_session.errors
