"""Start poses corrected, sessions evicted and readmitted: everybody ends as if it had been right from the start."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mapping.pose import QuantisedPose
from mapping.tiles import map_digest
from swarm.contributions import contributions
from swarm.messages import AskControls, Control
from swarm.radio import LAN
from swarm.timers import RADIO
from transport.in_process import Network


def test_a_corrected_start_pose_ends_as_if_it_had_been_right_from_the_start(swarm):
    swarm.robot("r1", start=QuantisedPose(100, 0, 0))
    swarm.robot("r2")
    swarm.observer("o")
    swarm.drive(3.0)
    swarm.settle(1.0)
    swarm.peers["o"].set_start_pose("r1", QuantisedPose(2150, 1450, 0), swarm.network.now)
    swarm.run(0.1)
    decided = swarm.peers["r1"].controls.start_pose("r1")
    assert decided == (QuantisedPose(2150, 1450, 0), b"r1r1r1r1")
    swarm.replace("r1", b"r1second", decided.pose.x_mm, decided.pose.y_mm)
    swarm.drive(1.0, seed=1)
    swarm.settle(2.0)
    swarm.crash("r1")
    swarm.observer("late")
    swarm.settle(2.0)
    assert not any(b"r1r1r1r1" in peer.replicas for peer in swarm.peers.values())


def test_at_no_time_does_anybody_sum_a_robot_twice(make_swarm):
    """While the new session travels, a peer's map is that of the old one, or as far as it is of the new one."""
    swarm = make_swarm(Network(seed=3, loss=0.3, delay=(0.001, 0.05)))
    swarm.robot("r1")
    swarm.observer("o")
    swarm.drive(1.0)
    swarm.settle(20.0)
    before = swarm.truth()
    swarm.replace("r1", b"r1second", 500, 0)
    for _ in range(200):
        swarm.run(0.005)
        for peer in swarm.peers.values():
            [replica] = peer.replicas.values()
            assert replica.descriptor.session == b"r1second" or peer.fusion.digest() == before
            assert peer.fusion.digest() == map_digest(replica.state.cells)
    swarm.settle(20.0)


@pytest.mark.parametrize("seed", range(2))
def test_corrections_and_evictions_in_flight_through_loss_duplicates_and_partitions(make_swarm, seed):
    swarm = make_swarm(Network(seed=seed, loss=0.3, duplicate=0.1, delay=(0.001, 0.1), lease=1.0))
    for name in ("r1", "r2", "r3"):
        swarm.robot(name, start=None if name == "r3" else QuantisedPose(0, 0, 0))
    swarm.observer("o")
    swarm.drive(1.0, seed=seed)
    swarm.network.partition(["r1", "o"], ["r2", "r3"])
    swarm.evict("o", b"r2r2r2r2")
    swarm.replace("r2", b"r2second", 300, -200)
    swarm.drive(0.5, seed=seed + 10)
    swarm.replace("r2", b"r2.third", 400, -200)
    swarm.replace("r3", b"r3second", 1000, 1000)
    swarm.evict("r3", b"r1r1r1r1")
    swarm.drive(0.5, seed=seed + 20)
    swarm.network.heal()
    late = swarm.observer("late")
    swarm.drive(0.5, seed=seed + 30)
    swarm.settle(40.0)
    assert late.replicas.keys() == {b"r1r1r1r1", b"r2.third", b"r3second"}
    swarm.readmit("late", b"r1r1r1r1")
    swarm.settle(40.0)
    assert all(peer.controls.evicted == {b"r2r2r2r2"} for peer in swarm.peers.values())


@pytest.mark.parametrize("seed", range(2))
def test_operators_on_both_sides_of_a_partition_get_one_decision(make_swarm, seed):
    swarm = make_swarm(Network(seed=seed, loss=0.2, delay=(0.001, 0.05)))
    swarm.robot("r1")
    for name in ("o1", "o2", "o3"):
        swarm.observer(name)
    swarm.drive(1.0)
    swarm.settle(20.0)
    swarm.network.partition(["r1", "o1"], ["o2", "o3"])
    swarm.evict("o1", b"r1r1r1r1")
    for _ in range(2):
        swarm.readmit("o2", b"r1r1r1r1")
        swarm.run(2.0)
    for k, name in enumerate(("o1", "o3")):
        swarm.peers[name].set_start_pose("r1", QuantisedPose(k, 0, 0), swarm.network.now)
    assert len(swarm.digests()) == 2
    swarm.network.heal()
    swarm.settle(20.0)  # the greater revision: readmitted
    assert {peer.controls.start_pose("r1").pose for peer in swarm.peers.values()} == {QuantisedPose(1, 0, 0)}


def test_decisions_reach_those_who_never_meet_who_decided_even_after_it_is_gone(swarm):
    swarm.robot("r1")
    swarm.observer("o1")
    swarm.drive(1.0)
    swarm.evict("o1", b"r1r1r1r1")
    swarm.settle(1.0)
    swarm.crash("o1")
    swarm.observer("o2")
    swarm.settle(2.0)
    swarm.crash("r1")
    swarm.observer("o3")
    swarm.settle(2.0)
    assert swarm.peers["o3"].replicas[b"r1r1r1r1"].state.n > 0


@pytest.mark.parametrize("mtu", [64, 84])
def test_small_packets_and_a_lossy_radio_are_enough(make_swarm, mtu):
    swarm = make_swarm(
        Network(seed=2, loss=0.15, delay=(0.005, 0.05), mtu=mtu), mtu=mtu, profile=replace(LAN, timers=RADIO)
    )
    for name in ("r1", "r2"):
        swarm.robot(name)
    swarm.drive(5.0, every=1.0, scans=4)
    swarm.evict("r1", b"r2r2r2r2")
    swarm.peers["r2"].set_start_pose("r1", QuantisedPose(500, 500, 0), swarm.network.now)
    swarm.replace("r1", b"r1second", 500, 500)
    swarm.observer("late")
    swarm.settle(300.0)
    swarm.readmit("late", b"r2r2r2r2")
    swarm.settle(300.0)
    assert max(len(payload) for _, _, payload in swarm.said) <= mtu


def test_a_swarm_that_agrees_says_nothing_of_its_decisions(swarm):
    for name in ("r1", "r2", "r3"):
        swarm.robot(name)
    for k in range(50):
        swarm.peers["r1"].set_start_pose(f"x{k}", QuantisedPose(k, 0, 0), swarm.network.now)
    swarm.drive(1.0)
    swarm.replace("r1", b"r1second", 100, 0)
    swarm.settle(1.0)
    swarm.run(5.0)
    asked = len([*swarm.messages(AskControls)])
    swarm.run(60.0)
    assert len([*swarm.messages(AskControls)]) == asked
    assert len([*swarm.messages(Control, "r1")]) == 50


def test_a_cloned_robot_is_summed_twice_and_flagged_loudly(swarm):
    swarm.robot("r1.a", robot="r1", session=b"session1")
    swarm.robot("r1.b", robot="r1", session=b"session2")
    observer = swarm.observer("o")
    swarm.drive(1.0)
    swarm.settle(1.0)
    for peer in swarm.peers.values():
        assert {each.reason for each in contributions(peer, swarm.network.now)} == {"two live robots are called r1"}
    swarm.crash("r1.b")
    swarm.run(30.0)
    first, second = contributions(observer, swarm.network.now)
    assert first.reason == ""
    assert second.reason.startswith("silent for ")
    assert second.summed


def test_both_sessions_that_replace_one_are_summed(swarm):
    swarm.robot("r1")
    swarm.drive(1.0)
    swarm.settle(1.0)
    old, journal = swarm.journals["r1"]
    clone = swarm.observer("clone")
    swarm.settle(1.0)
    swarm.network.partition(["r1"], ["clone"])
    swarm.replace("r1", b"r1second", 100, 0)
    descriptor = replace(old, session=b"r1cloned", replaces=old.session)
    clone.open_session(descriptor).sense(journal[0])
    swarm.journals["clone"] = descriptor, journal[:1]
    swarm.run(1.0)
    swarm.network.heal()
    swarm.settle(5.0)
    assert clone.replicas.keys() == {b"r1second", b"r1cloned"}
    assert [each.duplicate for each in contributions(clone, swarm.network.now) if each.live] == [True, True]
