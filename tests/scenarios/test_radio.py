"""A few kbit/s that all share: nobody says more than its share, and all still have one map."""

from collections import Counter
from itertools import accumulate, pairwise

import numpy as np
import pytest

from mapping.pose import FULL_TURN
from mapping.scan import quantise
from mapping.sensor import orion
from swarm.messages import Manifest
from swarm.radio import PROFILES
from transport.in_process import Network

ORION = orion()
ROOM = np.array([6.0, 4.0])
SPEED, RATE = 0.1, 10.0  # m/s, scans a second


def room_scans(robot, begin, count):
    """What an Orion senses that drives around in a room at 0.1 m/s, each robot on a loop of its own; at 10 Hz."""
    chance = np.random.default_rng([robot, begin])
    margin = 0.35 + 0.3 * robot
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * (ROOM - 2 * margin) + margin
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    way = (begin + np.arange(count)) * SPEED / RATE % starts[-1]
    leg = np.searchsorted(starts, way, side="right") - 1
    heading = np.arctan2(*np.diff(corners, axis=0).T[::-1])
    points = corners[leg] + (way - starts[leg])[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])[leg]
    yaw = heading[leg] + chance.normal(0, 0.003, count)
    bearing = yaw[:, None] + ORION.table[:, 2] / FULL_TURN * 2 * np.pi
    origin = points[:, None, :] + 0.001 * np.stack([
        np.cos(yaw)[:, None] * ORION.table[:, 0] - np.sin(yaw)[:, None] * ORION.table[:, 1],
        np.sin(yaw)[:, None] * ORION.table[:, 0] + np.cos(yaw)[:, None] * ORION.table[:, 1],
    ], axis=-1)  # fmt: skip
    look = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    with np.errstate(divide="ignore"):
        true = np.where(look > 0, ROOM - origin, -origin) / look
    true = np.abs(true).min(axis=-1)
    ranges = true + chance.normal(0, 0.003 + 0.01 * true)
    ranges = np.where(ranges > ORION.max_range_mm / 1000, np.inf, ranges)
    return quantise((begin + np.arange(count)) / RATE, np.column_stack([points, yaw]), ranges, ORION)


class Drive:
    """Robots on a radio that drive about in a room while the channel is listened to.

    Attributes:
        heard: bytes that all said, by second.
        ages: how many seconds old, second by second, the newest scans were that the other peers had of each robot.
    """

    def __init__(self, swarm, robots):
        self.swarm = swarm
        self.robots = robots
        self.second = 0
        self.heard = []
        self.ages = []
        self.written = {name: {0: 0} for name in robots}

    def go(self, seconds, *, sense=True):
        swarm = self.swarm
        for _ in range(seconds):
            for k, name in enumerate(self.robots):
                if sense and name in swarm.peers:
                    swarm.sense(name, room_scans(k, 10 * self.second, 10))
            swarm.run(1.0)
            self.second += 1
            self.heard.append(sum(len(payload) for _, _, payload in swarm.said))
            self._look()

    def _look(self):
        """What each update brought with it is known by when it was written."""
        now = self.second
        for name in self.robots:
            if name not in self.swarm.peers:
                continue
            own = self.swarm.peers[name].writer.replica
            waiting = sum(map(len, self.swarm.peers[name].writer._sensed)) / RATE
            self.written[name][own.state.n] = now - waiting
            for other, peer in self.swarm.peers.items():
                copy = peer.replicas.get(own.descriptor.session)
                if other != name and copy is not None:
                    n = max(n for n in self.written[name] if n <= copy.state.n)
                    self.ages.append(now - self.written[name][n])

    def per_second(self):
        return [b - a for a, b in pairwise([0, *self.heard])]


def spent(swarm):
    total = Counter()
    for peer in swarm.peers.values():
        total += peer.outbox.spent
    return total


def radio(make_swarm, profile, *, robots=4, seed=1, **faults):
    profile = PROFILES[profile]
    network = Network(seed=seed, mtu=profile.mtu, delay=(0.01, 0.05), **faults)
    swarm = make_swarm(network, mtu=profile.mtu, profile=profile, tick=0.01)
    names = [f"r{k + 1}" for k in range(robots)]
    for name in names:
        swarm.robot(name)
    swarm.observer("o")
    return swarm, Drive(swarm, names)


def check_budget(drive, profile):
    """Over any whole seconds no more than the channel carries, each peer's burst and last payload excepted."""
    rate, allowance = profile.rate, profile.rate * profile.burst + profile.mtu * len(drive.swarm.peers)
    sums = [0, *accumulate(drive.per_second())]
    for begin in range(len(sums)):
        for end in range(begin + 1, len(sums)):
            assert sums[end] - sums[begin] <= rate * (end - begin) + allowance
    assert max(len(payload) for _, _, payload in drive.swarm.said) <= profile.mtu


def hourly(drive, seconds):
    """Megabytes an hour of each robot."""
    return {name: drive.swarm.peers[name].outbox.spent.total() * 3600 / seconds / 1e6 for name in drive.robots}


def test_four_orions_and_an_observer_keep_up_over_three_hops(make_swarm):
    swarm, drive = radio(make_swarm, "digimesh-3hop")
    drive.go(60)
    check_budget(drive, PROFILES["digimesh-3hop"])
    assert max(hourly(drive, 60).values()) < 1.0
    assert np.quantile(drive.ages, 0.95) < 5.0
    swarm.settle(30.0)
    before = spent(swarm).total()
    swarm.run(600.0)
    assert (spent(swarm).total() - before) / 600 / 5 < 5  # bytes a second of a peer in a quiet swarm


@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_a_lossy_radio_stays_within_its_budget_and_agrees(make_swarm, loss):
    swarm, drive = radio(make_swarm, "digimesh-3hop", robots=2, loss=loss)
    drive.go(40)
    check_budget(drive, PROFILES["digimesh-3hop"])
    swarm.settle(300.0)


def test_a_late_joiner_gets_the_map_over_the_radio(make_swarm):
    swarm, drive = radio(make_swarm, "digimesh-3hop", robots=2)
    drive.go(90)
    late = swarm.observer("late")
    assert swarm.settle(300.0) < 120.0
    assert [*swarm.messages(Manifest)] or swarm.parts()
    assert late.fusion.tiles
    check_budget(drive, PROFILES["digimesh-3hop"])


def test_a_partition_on_the_radio_heals(make_swarm):
    swarm, drive = radio(make_swarm, "digimesh-3hop", robots=2)
    drive.go(10)
    swarm.network.partition(["r1"], ["r2", "o"])
    drive.go(60)
    assert len(swarm.digests()) > 1
    swarm.network.heal()
    assert swarm.settle(300.0) < 120.0


def test_robots_that_sense_more_than_the_radio_carries_agree_in_the_end(make_swarm):
    """Six hops and seven robots: more than half of what they sense has to wait."""
    swarm, drive = radio(make_swarm, "digimesh-6hop", robots=7)
    drive.go(60)
    check_budget(drive, PROFILES["digimesh-6hop"])
    assert any(swarm.peers[name].writer.waiting for name in drive.robots)
    swarm.settle(600.0)


@pytest.mark.soak
@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_an_hour_over_three_hops(make_swarm, loss):
    swarm, drive = radio(make_swarm, "digimesh-3hop", loss=loss)
    drive.go(3600)
    took = swarm.settle(300.0)
    print(f"\nloss {loss:.0%}: MB a robot { ({k: round(v, 3) for k, v in hourly(drive, 3600).items()}) }")
    print(f"bytes by class {dict(spent(swarm))}, age of copies p95 {np.quantile(drive.ages, 0.95):.1f} s")
    print(f"agreed {took:.1f} s after the end")
    check = drive.per_second()
    assert max(check) <= 2 * PROFILES["digimesh-3hop"].rate
    assert np.mean([*hourly(drive, 3600).values()]) <= 1.0
