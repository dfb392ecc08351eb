"""State that outlives processes: all are killed, one observer comes back, and newcomers get the map."""

from __future__ import annotations

import signal

import pytest

pytestmark = pytest.mark.processes


@pytest.fixture
def roster(swarm):
    """The TOML of three robots that need two seconds each."""
    robots = {}
    for k in (1, 2, 3):
        log = swarm.log(f"r{k}.log", scans=40 + k, seconds=2.0)
        start = {"x": 0.5 * k, "y": 0.25 * k, "yaw_deg": 10 * k}
        robots[f"r{k}"] = {"start": start, "body": {"kind": "recording", "path": str(log), "speed": 1.0}}
    return swarm.toml(robots, cell=0.05)


def test_all_are_killed_and_an_observer_that_restarts_gives_a_newcomer_the_map(orion, swarm, roster) -> None:
    state = swarm.folder / "state"
    observer = orion("observe", "-c", roster, "--state", state, "--supervised")
    robots = [orion("agent", "-c", roster, "--robot", f"r{k}", "--state", state, "--supervised") for k in (1, 2, 3)]
    peers = [observer, *robots]
    for peer in peers:
        peer.is_ready()
    for robot in robots:
        robot.order("go")
    for robot in robots:
        robot.says(lambda event: event["event"] == "status" and event["done"])
    positions = [peer.hears_no_more(quiet=2.5) for peer in peers]  # others' sessions are kept once a second
    assert all(each == positions[0] for each in positions)
    assert len(positions[0]) == 3
    for peer in peers:
        peer.signal(signal.SIGKILL)
    assert [peer.ends() for peer in peers] == [-signal.SIGKILL] * 4

    back = orion("observe", "-c", roster, "--state", state, "--supervised")
    back.is_ready()
    back.knows(lambda known: known == positions[0])
    # a robot whose recording has not begun is the newcomer: observers listen to nobody's connection
    late = orion("agent", "-c", roster, "--robot", "r1", "--supervised")
    late.is_ready()
    late.knows(lambda known: positions[0].items() <= known.items())
    reports = [late.finish(), back.finish()]
    assert len({report["map_digest"] for report in reports}) == 1
    restored = reports[1]["state"]
    assert restored["restored"] == {"sessions": 3, "updates": sum(positions[0].values())}
    assert restored["status"] == ""


def test_a_replay_goes_on_where_the_one_before_has_ended(orion, swarm) -> None:
    words = [
        "replay",
        swarm.log(scans=50),
        "--robots",
        2,
        "--state",
        swarm.folder / "state",
        "--out",
        swarm.folder / "out",
    ]
    results = [orion(*words, "--base-port", swarm.base_port, "--json").report() for _ in range(2)]
    assert [result["converged"] for result in results] == [True, True]
    assert [result["observer"]["state"]["restored"]["sessions"] for result in results] == [0, 2]
    assert results[0]["observer"]["known_m2"] == results[1]["observer"]["known_m2"]
    assert results[0]["observer"]["map_digest"] != results[1]["observer"]["map_digest"]  # the same evidence, twice


def test_a_second_agent_of_a_robot_on_the_same_state_is_refused(orion, swarm, roster) -> None:
    state = swarm.folder / "state"
    first = orion("agent", "-c", roster, "--robot", "r1", "--state", state, "--supervised")
    first.is_ready()
    other = swarm.toml({"r1": {"body": {"kind": "recording", "path": str(swarm.folder / "r1.log")}}}, name="other.toml")
    second = orion("agent", "-c", other, "--robot", "r1", "--state", state)
    assert second.ends() == 2
    assert "r1.lock: is held by process" in second.errors
    assert "end that one, or give another --state" in second.errors
    first.finish()


def test_a_folder_that_cannot_be_made_ends_with_status_2(orion, swarm, roster) -> None:
    (swarm.folder / "file").write_text("in the way")
    observer = orion("observe", "-c", roster, "--state", swarm.folder / "file" / "state")
    assert observer.ends() == 2
    assert "choose another --state" in observer.errors
