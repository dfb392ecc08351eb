"""Whatever happens to the network and to peers, all end up with one map, and it is the sum of all scans."""

from dataclasses import replace

import numpy as np
import pytest

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice, TileKey
from mapping.scan import Scans
from mapping.sensor import laser
from mapping.tiles import frozen
from swarm.messages import Digest, Manifest, Need, TilesMessage, Update, Want, encode
from swarm.radio import LAN
from swarm.session import Rules
from swarm.tile_block import decode_tiles, encode_tile
from swarm.timers import RADIO
from transport.in_process import Link, Network


def silent(swarm, one, other):
    """Nothing that one says reaches the other, either way; they see each other all the same."""
    for pair in ((one, other), (other, one)):
        swarm.network.links[pair] = Link(loss=1.0)


def test_robots_that_hear_each_other_agree_at_once(swarm):
    for name in ("r1", "r2", "r3"):
        swarm.robot(name)
    swarm.observer("o")
    swarm.run(0.1)  # else a first update may overtake its session's descriptor
    swarm.drive(3.0)
    assert swarm.settle(0.1) < 0.1
    assert not [*swarm.messages(Want, "r1")]


@pytest.mark.parametrize("updates", [0, 1, 19, 20, 21, 40, 45, 70])
def test_a_late_joiner_gets_everything_from_whoever_is_there(swarm, updates):
    swarm.robot("r1")
    swarm.observer("o")
    for seed in range(updates):
        swarm.sense("r1", swarm_scans(seed))
        swarm.run(0.06)
    swarm.settle(1.0)
    swarm.crash("r1")
    swarm.observer("late")
    assert swarm.settle(2.0) < 0.5
    if updates > 40:
        assert [*swarm.messages(Manifest, "o")]


def swarm_scans(seed, count=2):
    """Scans that need no fixture."""
    chance = np.random.default_rng(seed)
    poses = np.column_stack([chance.integers(-2500, 2500, (count, 2)), chance.integers(0, 65536, count)])
    return Scans(
        np.arange(count, dtype=np.int64), poses.astype(np.int32), chance.integers(0, 801, (count, 5)).astype(np.uint16)
    )


def test_a_writer_that_died_is_caught_up_with_through_a_peer_that_never_met_it(swarm):
    swarm.robot("r1")
    swarm.observer("o1")
    swarm.drive(5.0)
    swarm.crash("r1")
    for name in ("o2", "o3", "o4"):
        swarm.observer(name)
        swarm.settle(2.0)
        swarm.crash(min(swarm.peers))
    assert [*swarm.peers] == ["o4"]


def test_a_late_joiner_of_a_dozen_robots_agrees_soon(make_swarm):
    swarm = make_swarm(Network(seed=1, delay=(0.0002, 0.001)), tick=0.005)
    for k in range(12):
        swarm.robot(f"r{k}")
    for step in range(3):
        for k in range(12):
            swarm.sense(f"r{k}", swarm_scans(100 * step + k, 4))
        swarm.run(0.1)
    swarm.settle(2.0)
    swarm.observer("late")
    assert swarm.settle(3.0) < 0.5


def test_a_gap_closes_from_the_ring(swarm):
    swarm.robot("r1")
    swarm.observer("o")
    swarm.drive(1.0)
    swarm.network.links["r1", "o"] = Link(loss=1.0)
    swarm.drive(0.5, seed=1)
    del swarm.network.links["r1", "o"]
    swarm.drive(0.2, seed=2)
    assert swarm.settle(0.5) < 0.2
    assert not [*swarm.messages(Manifest)]
    wants = [*swarm.messages(Want, "o")]
    assert wants[-1].through > wants[-1].n


def test_the_last_update_is_missed_and_the_next_digest_tells(swarm):
    swarm.robot("r1")
    swarm.observer("o")
    swarm.drive(1.0)
    swarm.settle(1.0)
    swarm.network.links["r1", "o"] = Link(loss=1.0)
    swarm.drive(0.1, seed=1)
    del swarm.network.links["r1", "o"]
    assert not swarm.agree()
    assert swarm.settle(5.0) < 1.0


@pytest.mark.parametrize("seed", range(6))
def test_loss_duplicates_and_reordering_are_healed(make_swarm, seed):
    swarm = make_swarm(Network(seed=seed, loss=0.3, duplicate=0.1, delay=(0.001, 0.1)))
    for name in ("r1", "r2", "r3"):
        swarm.robot(name)
    swarm.observer("o")
    swarm.drive(2.0, seed=seed)
    swarm.settle(30.0)


def test_on_half_of_all_messages_lost_they_still_agree(make_swarm):
    swarm = make_swarm(Network(seed=5, loss=0.5, delay=(0.001, 0.05)))
    for name in ("r1", "r2"):
        swarm.robot(name)
    swarm.drive(2.0)
    swarm.observer("late")
    swarm.settle(120.0)


def test_a_partition_heals(swarm):
    for name in ("r1", "r2", "r3", "r4"):
        swarm.robot(name)
    swarm.drive(1.0)
    swarm.network.partition(["r1", "r2"], ["r3", "r4"])
    swarm.drive(2.5, seed=1)
    assert len(swarm.digests()) == 2
    swarm.network.heal()
    assert swarm.settle(10.0) < 2.0


def test_a_partition_through_a_lossy_network_heals(make_swarm):
    swarm = make_swarm(Network(seed=3, loss=0.2, duplicate=0.1, delay=(0.001, 0.05), lease=1.0))
    for name in ("r1", "r2", "r3"):
        swarm.robot(name)
    swarm.drive(1.0)
    for round_ in range(3):
        swarm.network.partition([f"r{round_ + 1}"])
        swarm.drive(1.5, seed=round_)
    swarm.network.heal()
    swarm.settle(30.0)


def test_robots_that_never_meet_agree_through_one_between_them(swarm):
    for name in ("r1", "middle", "r3"):
        swarm.robot(name)
    silent(swarm, "r1", "r3")
    swarm.drive(4.0)
    swarm.settle(5.0)
    swarm.crash("r1")
    swarm.observer("r4")
    for name in ("middle", "r1"):
        silent(swarm, name, "r4")
    assert swarm.settle(5.0) < 3.0


def test_a_chain_of_six_agrees_hop_by_hop(swarm):
    names = [f"r{k}" for k in range(6)]
    for name in names:
        swarm.robot(name)
    for k, one in enumerate(names):
        for other in names[k + 2 :]:
            silent(swarm, one, other)
    swarm.drive(1.0)
    assert swarm.settle(20.0) < 10.0


def test_packets_of_84_bytes_are_enough(make_swarm):
    swarm = make_swarm(Network(seed=1, delay=(0.005, 0.02), mtu=84), mtu=84, profile=replace(LAN, timers=RADIO))
    swarm.robot("r1")
    swarm.robot("r2", publish="tiles")
    swarm.drive(4.0, every=1.0, scans=3)
    swarm.settle(60.0)
    swarm.observer("late")
    swarm.settle(60.0)
    assert swarm.parts() > 20
    assert max(len(payload) for _, _, payload in swarm.said) <= 84


def test_packets_of_84_bytes_and_a_lossy_radio_are_enough(make_swarm):
    swarm = make_swarm(
        Network(seed=2, loss=0.15, delay=(0.005, 0.05), mtu=84), mtu=84, profile=replace(LAN, timers=RADIO)
    )
    for name in ("r1", "r2"):
        swarm.robot(name)
    swarm.drive(20.0, every=1.0, scans=4)
    swarm.observer("late")
    swarm.settle(300.0)


def update_bytes(swarm, name):
    return swarm.peers[name].sent_bytes["update"]


def test_scans_and_tiles_give_the_same_map_and_scans_are_cheaper(make_swarm):
    digests, costs = set(), {}
    for publish in ("auto", "scans", "tiles"):
        swarm = make_swarm(Network(seed=1))
        swarm.robot("r1", publish=publish)
        swarm.observer("o")
        swarm.drive(3.0)
        swarm.settle(1.0)
        digests |= swarm.digests()
        costs[publish] = update_bytes(swarm, "r1")
    assert len(digests) == 1
    assert costs["auto"] == costs["scans"]
    assert costs["scans"] * 2 < costs["tiles"]


def test_robots_with_different_sensors_that_publish_in_different_forms_share_one_map(swarm):
    swarm.robot("r1", sensor=laser(60, first=-1.5, step=0.05, max_range=4.0))
    swarm.robot("r2", publish="tiles", sensor=laser(9, first=-1.5, step=0.375, max_range=3.0))
    swarm.robot("r3")
    swarm.drive(2.0)
    swarm.settle(1.0)


def test_with_a_limit_all_agree_too(make_swarm):
    swarm = make_swarm(Network(seed=1, loss=0.1), rules=Rules(Lattice(50), EvidenceModel(limit=150)))
    swarm.robot("r1")
    swarm.robot("r2", publish="tiles")
    swarm.drive(2.0)
    swarm.observer("late")
    swarm.settle(10.0)


@pytest.mark.parametrize("mtu", [200, 32768])
def test_a_correction_reaches_everybody_and_late_joiners(make_swarm, mtu):
    swarm = make_swarm(Network(seed=1, mtu=mtu), mtu=mtu)
    swarm.robot("r1")
    swarm.robot("r2")
    swarm.observer("o")
    swarm.drive(3.0)
    swarm.settle(2.0)
    wrong = Scans.join(swarm.journals["r1"][1])
    moved = Scans(wrong.stamps_ms, wrong.poses + np.array([2000, -700, 0], np.int32), wrong.ranges)
    swarm.correct("r1", moved)
    swarm.drive(0.5, seed=1)
    swarm.settle(2.0)
    assert any(update.form == Update.CELLS for update in swarm.messages(Update, "r1"))
    swarm.observer("late")
    swarm.settle(2.0)


def test_another_cell_size_is_refused_with_its_reason_and_disturbs_nobody(swarm):
    swarm.robot("r1")
    swarm.robot("r2")
    swarm.drive(1.0)
    stranger = swarm.robot("r3", rules=Rules(Lattice(20), EvidenceModel()))
    for seed in range(20):
        swarm.sense("r3", swarm_scans(seed))
        swarm.run(0.1)
    assert stranger.refused.keys() == {b"r1r1r1r1", b"r2r2r2r2"}
    assert set(stranger.refused.values()) == {
        "r1: cell size 0.05 m, ours is 0.02 m",
        "r2: cell size 0.05 m, ours is 0.02 m",
    }
    for name in ("r1", "r2"):
        assert swarm.peers[name].refused == {b"r3r3r3r3": "r3: cell size 0.02 m, ours is 0.05 m"}
        assert swarm.peers[name].dropped["refused_session"] >= 20
    swarm.run(20.0)
    before = {name: peer.sent_bytes["digest"] for name, peer in swarm.peers.items()}
    swarm.run(60.0)
    assert all(peer.sent_bytes["digest"] - before[name] < 60 * 30 for name, peer in swarm.peers.items())
    swarm.crash("r3")
    del swarm.journals["r3"]
    swarm.settle(1.0)


def test_two_sessions_of_one_robot_are_both_summed(swarm):
    swarm.observer("o")
    swarm.robot("r1.first", robot="r1", session=b"session1")
    swarm.drive(2.0)
    swarm.settle(1.0)
    swarm.crash("r1.first")
    swarm.robot("r1.second", robot="r1", session=b"session2")
    swarm.drive(2.0, seed=1)
    swarm.settle(2.0)
    assert [replica.descriptor.robot for replica in swarm.peers["o"].replicas.values()] == ["r1", "r1"]


def test_a_session_without_a_start_pose_travels_but_is_not_summed(swarm):
    swarm.robot("r1", start=None)
    swarm.robot("r2")
    swarm.drive(2.0)
    swarm.settle(1.0)
    late = swarm.observer("late")
    swarm.settle(2.0)
    assert late.replicas[b"r1r1r1r1"].state.cells
    assert late.fusion.tiles.keys() == late.replicas[b"r2r2r2r2"].state.cells.keys()


def test_a_bad_copy_is_repaired_tile_by_tile(swarm):
    swarm.robot("r1")
    swarm.robot("r2")
    observer = swarm.observer("o")
    for seed in range(42):
        for k, name in enumerate(("r1", "r2")):
            swarm.sense(name, swarm_scans(seed + 100 * k))
        swarm.run(0.06)
    swarm.settle(1.0)
    cells = observer.replicas[b"r1r1r1r1"].state.cells
    key = TileKey(0, 0)
    wrong = cells[key].copy()
    wrong[::7, ::5] += 1000
    cells[key] = frozen(wrong)
    assert not observer.replicas[b"r1r1r1r1"].state.sound()
    assert len(cells) > 12
    del swarm.said[:]
    here = Scans(np.zeros(1, np.int64), np.array([[800, 800, 0]], np.int32), np.full((1, 5), 300, np.uint16))
    swarm.sense("r1", here)
    swarm.settle(5.0)
    assert observer.dropped["bad_check"] == 1
    fetched = [key for message in swarm.messages(TilesMessage) for key in decode_tiles(message.payload)]
    assert len(fetched) <= 8  # the damaged one, and those that have changed since the last checkpoint


def test_a_late_joiner_goes_on_with_another_peer_when_its_provider_dies(make_swarm):
    swarm = make_swarm(Network(seed=1, delay=(0.001, 0.002), mtu=400), mtu=400)
    swarm.robot("r1")
    for name in ("o1", "o2"):
        swarm.observer(name)
    for seed in range(45):
        swarm.sense("r1", swarm_scans(seed, 3))
        swarm.run(0.06)
    swarm.settle(5.0)
    swarm.crash("r1")
    late = swarm.observer("late")
    tiles = len(swarm.peers["o1"].replicas[b"r1r1r1r1"].checkpoint.cells)
    del swarm.said[:]

    def supplied(name):
        return sum(len(decode_tiles(message.payload)) for message in swarm.messages(TilesMessage, name))

    swarm.run(5.0, until=lambda: supplied("o1") + supplied("o2") >= tiles // 3)
    assert b"r1r1r1r1" in late.replicas
    assert late.replicas[b"r1r1r1r1"].state.n == 0
    dead = max(("o1", "o2"), key=supplied)
    first = supplied(dead)
    swarm.crash(dead)
    swarm.settle(5.0)
    assert tiles <= supplied("o1") + supplied("o2") <= tiles + 30  # what was under way is asked for again
    assert first > 0
    assert [*swarm.messages(Need, "late")]


def test_all_who_come_late_together_agree(swarm):
    swarm.robot("r1")
    swarm.robot("r2")
    swarm.drive(4.0, stride=300)
    for k in range(8):
        swarm.observer(f"o{k}")
    swarm.settle(3.0)


def test_a_writer_that_goes_on_while_others_catch_up_is_caught_up_with(make_swarm):
    swarm = make_swarm(Network(seed=4, loss=0.1, delay=(0.01, 0.03), mtu=400), mtu=400)
    swarm.robot("r1")
    swarm.robot("r2")
    swarm.drive(4.0, stride=300)
    swarm.observer("late")
    swarm.drive(6.0, seed=1, stride=300)
    swarm.settle(20.0)


def test_a_quiet_swarm_says_little(swarm):
    for name in ("r1", "r2", "r3"):
        swarm.robot(name)
    swarm.observer("o")
    swarm.drive(1.0)
    swarm.settle(1.0)
    swarm.run(30.0)
    before = swarm.network.counters["delivered"], sum(peer.sent_bytes.total() for peer in swarm.peers.values())
    assert {type(message) for message in swarm.messages(Digest)} == {Digest}
    swarm.run(100.0)
    said = sum(peer.sent_bytes.total() for peer in swarm.peers.values()) - before[1]
    assert said / 100 < 45  # bytes a second, of all four together
    swarm.settle(0.1)


def test_twenty_peers_agree(make_swarm):
    swarm = make_swarm(Network(seed=7, loss=0.05, delay=(0.001, 0.01)), tick=0.005)
    for k in range(20):
        swarm.robot(f"r{k}")
    for k in range(20):
        swarm.sense(f"r{k}", swarm_scans(k, 5))
    swarm.run(0.5)
    swarm.settle(20.0)


@pytest.mark.parametrize("seed", range(2))
def test_the_same_seed_gives_the_same_run(make_swarm, seed):
    def run():
        swarm = make_swarm(Network(seed=seed, loss=0.3, delay=(0.001, 0.05)))
        swarm.robot("r1")
        swarm.robot("r2")
        swarm.drive(1.0)
        return swarm.settle(30.0), swarm.said

    assert run() == run()


def test_a_lost_answer_is_asked_for_again_while_the_writer_goes_on(swarm):
    """Every update that came too early used to put off the next request: a copy stood still until the writer paused."""
    swarm.robot("r1")
    observer = swarm.observer("o")
    swarm.drive(1.0)
    swarm.network.links["r1", "o"] = Link(loss=1.0)
    swarm.drive(0.3, seed=1)
    swarm.network.links["o", "r1"] = Link(loss=1.0)
    del swarm.network.links["r1", "o"]
    swarm.drive(0.2, seed=2)  # the gap is noticed, but the want for it is lost
    del swarm.network.links["o", "r1"]
    swarm.drive(3.0, seed=3)
    writer = swarm.peers["r1"].writer
    assert writer is not None
    assert writer.replica.state.n - observer.replicas[b"r1r1r1r1"].state.n <= 1
    swarm.settle(1.0)


def test_a_copy_that_was_made_to_believe_a_forged_update_comes_right_once_a_checkpoint_is_past(swarm):
    """Without keys nobody can tell at once; the next updates do not fit, and then the checkpoint's root does not."""
    swarm.robot("r1")
    observer = swarm.observer("o")
    swarm.drive(0.5)
    state = observer.replicas[b"r1r1r1r1"].state
    key, cells = TileKey(50, 50), frozen(np.ones((32, 32), np.int32))
    step = state.step({key: cells})
    forged = Update(b"r1r1r1r1", step.n, Update.TILES, encode_tile(key, cells), b"", step.check)
    observer.receive("stranger", encode(forged), swarm.network.now)
    assert not swarm.agree()
    swarm.drive(8.0, seed=1)
    swarm.settle(5.0)
    assert observer.dropped["bad_root"] == 1
