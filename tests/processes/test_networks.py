"""Peers on machines of their own, as far as the kernel can tell, with little bandwidth, loss, and a pulled cable.

Each process runs in a network namespace of its own; a bridge joins them. `tc tbf` bounds what leaves each, nftables
drops a share of what comes in.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.playback import read

pytestmark = [pytest.mark.processes, pytest.mark.networks]

CELL = 0.05
PATIENCE = 120.0


class Machines:
    """Namespaces on one bridge: ``r1``, ``r2`` and ``observer``, at 10.77.0.1 to 3.

    All is undone by `close`: the cables go before the namespaces, which must be empty of processes by then.
    """

    NAMES = ("r1", "r2", "observer")
    HOSTS = ("10.77.0.1", "10.77.0.2")

    def __init__(self, swarm: str) -> None:
        self._hub = f"orion-{swarm}-hub"
        self._spaces = {name: f"orion-{swarm}-{name}" for name in self.NAMES}

    def open(self, *, kbit: int, loss: int) -> None:
        """Make them.

        Args:
            kbit: what each may send, 1000 bit/s.
            loss: what share of what comes in is lost, percent.
        """
        for space in (self._hub, *self._spaces.values()):
            _run(f"ip netns add {space}")
        _run(f"ip -n {self._hub} link add bridge type bridge")
        _run(f"ip -n {self._hub} link set bridge up")
        for number, (name, space) in enumerate(self._spaces.items(), start=1):
            _run(f"ip -n {self._hub} link add {name} type veth peer name eth0 netns {space}")
            _run(f"ip -n {self._hub} link set {name} master bridge up")
            _run(f"ip -n {space} addr add 10.77.0.{number}/24 dev eth0")
            _run(f"ip -n {space} link set lo up")
            _run(f"ip -n {space} link set eth0 up")
            _run(f"tc -n {space} qdisc add dev eth0 root tbf rate {kbit}kbit burst 2k limit 16k")
            if loss:
                nft = " ".join([*self.inside(name), "nft"])
                _run(f"{nft} add table ip orion")
                _run(f"{nft} add chain ip orion in {{ type filter hook input priority 0 ; }}")
                _run(f"{nft} add rule ip orion in iifname eth0 numgen random mod 100 < {loss} drop")

    def inside(self, name: str) -> list[str]:
        """The words that make a command run there."""
        return ["nsenter", f"--net=/run/netns/{self._spaces[name]}"]

    def cable(self, name: str, state: str) -> None:
        """Pull somebody's cable (``down``) or put it in again (``up``)."""
        _run(f"ip -n {self._hub} link set {name} {state}")

    def close(self) -> None:
        """Undo what `open` has done, however far that was."""
        for name in self._spaces:
            subprocess.run(["ip", "-n", self._hub, "link", "del", name], capture_output=True, check=False)
        for space in (*self._spaces.values(), self._hub):
            subprocess.run(["ip", "netns", "del", space], capture_output=True, check=False)


def _run(command: str) -> None:
    done = subprocess.run(command.split(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}: {done.stderr}"


@pytest.fixture
def machines() -> Iterator[Machines]:
    """Three machines, not yet made; requested before ``orion``, so that they go after its processes."""
    if os.geteuid():
        pytest.skip("network namespaces need root")
    missing = [tool for tool in ("ip", "tc", "nft", "nsenter") if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"network namespaces need {', '.join(missing)}: apt-get install iproute2 nftables")
    machines = Machines(os.urandom(3).hex())
    yield machines
    machines.close()


@pytest.fixture
def everybody(machines, orion, swarm):
    """Starts two robots and an observer, each on its machine, ready to go; the robots have three seconds to map."""

    def start(transport: str) -> list[Any]:
        robots = {}
        for name, host, scans in zip(("r1", "r2"), Machines.HOSTS, (30, 40), strict=True):
            log = swarm.log(f"{name}.log", scans=scans, seconds=3.0)
            robots[name] = {"host": host, "start": {}, "body": {"kind": "recording", "path": str(log), "speed": 1.0}}
        toml = swarm.toml(robots, cell=CELL, transport=transport)
        words = {"r1": ["agent", "--robot", "r1"], "r2": ["agent", "--robot", "r2"], "observer": ["observe"]}
        return [
            orion(*words[name], "-c", toml, "--supervised", inside=machines.inside(name)) for name in Machines.NAMES
        ]

    return start


def all_meet_and_map(everybody) -> None:
    for each in everybody:
        each.shows("around", len(everybody) - 1, PATIENCE)
    for robot in everybody[:2]:
        robot.order("go")


def all_end_with_the_one_map(everybody, swarm, truth) -> None:
    """All know all that was sensed, and report the map that one would make of it."""
    for robot in everybody[:2]:
        robot.shows("done", True, PATIENCE)
    newest = {session: n for robot in everybody[:2] for session, n in own(robot).items()}
    for each in everybody:
        each.knows(lambda known: known == newest, PATIENCE)
    digest = truth.digest_of([read(Path(swarm.folder / f"r{k}.log"))[0] for k in (1, 2)], CELL)
    assert [each.finish()["map_digest"] for each in everybody] == [digest] * 3


def own(robot) -> dict[str, int]:
    """A robot's own session and how far it is: a peer opens it before it hears of another."""
    session = next(iter(robot.status["positions"]))
    return {session: robot.status["positions"][session]}


IN_SHORT = [("zenoh", 250, 30), ("zmq", 250, 10), ("zenoh", 20, 0)]
AT_LENGTH = [("zenoh", 250, 0), ("zenoh", 250, 10), ("zmq", 250, 0), ("zmq", 250, 30), ("zmq", 20, 0)]


@pytest.mark.parametrize(
    ("transport", "kbit", "loss"), [*IN_SHORT, *(pytest.param(*each, marks=pytest.mark.soak) for each in AT_LENGTH)]
)
def test_a_bad_network_delays_the_map_and_does_not_change_it(
    machines, everybody, swarm, truth, transport: str, kbit: int, loss: int
) -> None:
    machines.open(kbit=kbit, loss=loss)
    swarm_of_three = everybody(transport)
    all_meet_and_map(swarm_of_three)
    all_end_with_the_one_map(swarm_of_three, swarm, truth)


@pytest.mark.parametrize(
    ("transport", "seconds"),
    [
        ("zenoh", 0.0),
        *(pytest.param(*each, marks=pytest.mark.soak) for each in (("zmq", 0.0), ("zenoh", 30.0), ("zmq", 30.0))),
    ],
)
def test_a_partition_heals(machines, everybody, swarm, truth, transport: str, seconds: float) -> None:
    """r1 maps on behind a pulled cable, and nobody knows; it is put in again when all noticed, or after so long."""
    machines.open(kbit=250, loss=0)
    r1, r2, observer = swarm_of_three = everybody(transport)
    all_meet_and_map(swarm_of_three)
    observer.knows(lambda known: len(known) == 2)
    machines.cable("r1", "down")
    began = time.monotonic()
    r1.shows("around", 0)
    for each in (r2, observer):
        each.shows("around", 1)
    for robot in (r1, r2):
        robot.shows("done", True)
    assert not own(r1).items() <= observer.status["positions"].items()
    observer.idle(began + seconds - time.monotonic())
    machines.cable("r1", "up")
    all_end_with_the_one_map(swarm_of_three, swarm, truth)
