import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.raster import raster
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import laser, orion
from mapping.tiles import map_digest
from swarm import writer as writer_module
from swarm.limits import MAX_N, MIN_MTU
from swarm.messages import Update, encode
from swarm.replica import Replica
from swarm.scan_block import decode_scans
from swarm.session import Descriptor, Rules
from swarm.tile_block import decode_tiles
from swarm.writer import MapFullError, Writer

ORION = orion()
LASER = laser(40, first=-1.0, step=0.05, max_range=4.0)


def some_scans(seed, count, sensor=ORION):
    chance = np.random.default_rng(seed)
    poses = np.column_stack([np.cumsum(chance.integers(-40, 60, (count, 2)), axis=0), chance.integers(0, 65536, count)])
    ranges = chance.integers(1, sensor.max_range_mm + 1, (count, len(sensor.beams)))
    ranges[chance.random(ranges.shape) < 0.1] = NO_RETURN
    ranges[chance.random(ranges.shape) < 0.1] = INVALID
    return Scans(np.arange(count, dtype=np.int64) * 100, poses.astype(np.int32), ranges.astype(np.uint16))


def pair(publish="auto", *, mtu=32768, sensor=ORION, limit=0):
    """A writer, and a copy elsewhere."""
    descriptor = Descriptor("r1", b"session1", Rules(Lattice(50), EvidenceModel(limit=limit)), sensor, None)
    return Writer(Replica(descriptor, raster), raster, mtu=mtu, publish=publish), Replica(descriptor, raster)


def publish(writer, copy):
    updates = [update for update, _ in writer.updates()]
    for update in updates:
        assert len([*copy.offer(update)]) == 1
    return updates


def truth(scans, writer):
    descriptor = writer.replica.descriptor
    return map_digest(
        integrated({}, scans, descriptor.sensor, descriptor.rules.model, descriptor.rules.lattice),
    )


@settings(max_examples=30)
@given(
    st.lists(st.integers(0, 15), min_size=1, max_size=4),
    st.sampled_from(["auto", "scans", "tiles"]),
    st.sampled_from([84, 200, 1000, 32768]),
    st.sampled_from([0, 150]),
    st.sampled_from([ORION, LASER]),
)
def test_whatever_is_sensed_arrives_as_the_map_of_all_scans(batches, form, mtu, limit, sensor):
    writer, copy = pair(form, mtu=mtu, limit=limit, sensor=sensor)
    everything = []
    for seed, count in enumerate(batches):
        scans = some_scans(seed, count, sensor)
        writer.sense(scans)
        everything.append(scans)
        assert writer.waiting == bool(count)
        publish(writer, copy)
        assert not writer.waiting
    assert map_digest(copy.state.cells) == truth(Scans.join(everything), writer)
    assert copy.state.root() == writer.replica.state.root()


@pytest.mark.parametrize("form", ["scans", "tiles"])
@pytest.mark.parametrize("mtu", [84, 200, 2000, 32768])
def test_every_pose_travels_once_and_in_order(form, mtu):
    writer, copy = pair(form, mtu=mtu)
    scans = some_scans(1, 60)
    writer.sense(scans)
    updates = publish(writer, copy)
    blocks = [
        decode_scans(update.payload, 5, 800) if form == "scans" else decode_scans(update.trail, 0, 0)
        for update in updates
        if form == "scans" or update.trail
    ]
    assert np.array_equal(np.concatenate([block.poses for block in blocks]), scans.poses)
    assert np.array_equal(np.concatenate([block.stamps_ms for block in blocks]), scans.stamps_ms)


@pytest.mark.parametrize("mtu", [200, 1000, 32768])
def test_an_update_of_several_scans_fits_the_mtu(mtu):
    writer, copy = pair(mtu=mtu)
    writer.sense(some_scans(1, 9000 if mtu > 1000 else 500))
    updates = publish(writer, copy)
    assert max(len(encode(update)) for update in updates) <= mtu
    assert min(len(encode(update)) for update in updates[:-1]) > mtu // 2


def test_a_radio_packet_of_84_bytes_carries_two_orion_scans_and_more():
    """Nearly twice the bytes that an update needs used to be set aside: there was room for one."""
    writer, copy = pair(mtu=84)
    chance = np.random.default_rng(3)
    poses = np.arange(30)[:, None] * np.array([20, 3, 400]) + 9 + chance.integers(-1, 2, (30, 3))
    ranges = np.array([310, 402, 655, 320, 500]) + chance.integers(-4, 5, (30, 5))
    writer.sense(Scans(np.arange(30, dtype=np.int64) * 100, poses.astype(np.int32), ranges.astype(np.uint16)))
    updates = publish(writer, copy)
    assert len(updates) <= 16
    assert all(len(encode(update)) <= 84 for update in updates)


@pytest.mark.parametrize("mtu", [MIN_MTU, 84, 300, 32768, 1 << 20])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_an_update_needs_no_more_bytes_than_are_set_aside_for_it(mtu, share):
    room = mtu - writer_module._overhead(mtu)
    trail = int(room * share)
    whole = Update(bytes(8), MAX_N, Update.TILES, bytes(room - trail), bytes(trail), 2**64 - 1)
    assert mtu - 6 <= len(encode(whole)) <= mtu


@pytest.mark.parametrize("form", ["scans", "tiles"])
def test_the_smallest_mtu_still_works(form):
    writer, copy = pair(form, mtu=MIN_MTU)
    scans = some_scans(1, 20)
    writer.sense(scans)
    publish(writer, copy)
    assert map_digest(copy.state.cells) == truth(scans, writer)


def test_more_scans_than_an_update_may_hold_go_into_several(monkeypatch):
    monkeypatch.setattr(writer_module, "MAX_SCANS", 8)
    writer, copy = pair()
    writer.sense(some_scans(1, 20))
    assert [len(decode_scans(update.payload, 5, 800)) for update in publish(writer, copy)] == [8, 8, 4]


def test_nothing_sensed_nothing_said():
    writer, copy = pair()
    writer.sense(Scans.empty(5))
    assert not writer.waiting
    assert publish(writer, copy) == []


def test_scans_are_cheaper_than_the_tiles_they_change():
    sizes = {}
    for form in ("scans", "tiles"):
        writer, copy = pair(form)
        writer.sense(some_scans(1, 10))
        sizes[form] = sum(len(encode(update)) for update in publish(writer, copy))
    assert sizes["scans"] * 3 < sizes["tiles"]


@pytest.mark.parametrize("mtu", [200, 32768])
@pytest.mark.parametrize("form", ["scans", "tiles"])
def test_a_correction_gives_the_map_of_a_run_that_had_it_right_from_the_start(form, mtu):
    writer, copy = pair(form, mtu=mtu)
    wrong = some_scans(1, 30)
    right = Scans(wrong.stamps_ms, wrong.poses + np.array([400, -900, 0], np.int32), wrong.ranges)
    writer.sense(wrong)
    publish(writer, copy)
    descriptor = writer.replica.descriptor
    after = integrated({}, right, descriptor.sensor, descriptor.rules.model, descriptor.rules.lattice)
    gone = {key: np.zeros_like(cells) for key, cells in writer.replica.state.cells.items() if key not in after}
    writer.correct(after | gone)
    updates = [update for update, _ in writer.updates()]
    assert max(len(encode(update)) for update in updates) <= mtu or form == "tiles"
    for update in updates:
        assert len([*copy.offer(update)]) == 1
    assert map_digest(copy.state.cells) == truth(right, writer)
    writer.correct(after)
    assert not writer.waiting


def test_correcting_before_all_is_published_is_our_mistake():
    writer, _ = pair()
    writer.sense(some_scans(1, 1))
    with pytest.raises(AssertionError):
        writer.correct({})


def test_several_tiles_and_their_trail_fit_the_mtu_together():
    writer, copy = pair("tiles", mtu=1500)
    for seed in range(40):
        writer.sense(some_scans(seed, 10))
        for update in publish(writer, copy):
            assert len(encode(update)) <= 1500 or len(decode_tiles(update.payload)) == 1


def test_scans_with_many_long_rays_are_published_few_at_a_time(monkeypatch):
    """What everybody would drop for its cost is not published in the first place."""
    monkeypatch.setattr("swarm.session.MAX_VISITS", 10_000)
    writer, copy = pair(sensor=LASER)
    most = copy.descriptor.most_scans
    assert most == 10_000 // (40 * (4000 // 50 + 2)) == 3
    scans = some_scans(1, 10, LASER)
    writer.sense(scans)
    updates = publish(writer, copy)
    counts = [len(decode_scans(update.payload, 40, 4000)) for update in updates]
    assert counts == [3, 3, 3, 1]
    assert map_digest(copy.state.cells) == truth(scans, writer)


@pytest.mark.parametrize("form", ["scans", "tiles"])
def test_a_map_that_is_full_is_told_and_nothing_more_is_published(monkeypatch, form):
    writer, copy = pair(form)
    writer.sense(some_scans(1, 5))
    publish(writer, copy)
    monkeypatch.setattr("swarm.state.MAX_TILES", len(copy.state.cells))
    far = some_scans(2, 5)
    writer.sense(Scans(far.stamps_ms, far.poses + np.array([90_000, 0, 0], np.int32), far.ranges))
    with pytest.raises(MapFullError, match="robot r1 is full"):
        publish(writer, copy)
    assert writer.replica.state.n == copy.state.n


def standing_still(count):
    """A robot that stands in a corner and cannot publish what it senses."""
    chance = np.random.default_rng(1)
    ranges = np.array([310, 402, 655, 320, 500]) + chance.integers(-9, 10, (count, 5))
    return Scans(np.arange(count, dtype=np.int64) * 100, np.zeros((count, 3), np.int32), ranges.astype(np.uint16))


@pytest.mark.parametrize("mtu", [84, 174])
def test_scans_that_had_to_wait_long_become_the_cells_they_changed_where_that_is_cheaper(mtu):
    sizes = {}
    for form in ("scans", "auto"):
        writer, copy = pair(form, mtu=mtu)
        writer.sense(standing_still(2000))
        updates = publish(writer, copy)
        assert max(len(encode(update)) for update in updates) <= mtu
        assert map_digest(copy.state.cells) == truth(standing_still(2000), writer)
        sizes[form] = sum(len(encode(update)) for update in updates)
    assert sizes["auto"] * 2 <= sizes["scans"]


def test_what_is_sensed_while_cells_wait_comes_on_top_of_them():
    writer, copy = pair(mtu=84)
    before, after = standing_still(2000), some_scans(1, 30)
    writer.sense(before)
    for _ in range(3):
        update, _ = writer.next_update(partial=True)
        assert len([*copy.offer(update)]) == 1
    writer.sense(after)
    publish(writer, copy)
    assert map_digest(copy.state.cells) == truth(Scans.join([before, after]), writer)


def test_cells_of_many_scans_come_with_a_glimpse_of_where_the_robot_is():
    writer, copy = pair(mtu=174)
    scans = standing_still(5000)
    writer.sense(scans)
    trails = [decode_scans(update.trail, 0, 0) for update in publish(writer, copy) if update.trail]
    stamps = np.concatenate([trail.stamps_ms for trail in trails])
    assert 8 <= len(stamps) <= 16
    assert stamps[-1] == scans.stamps_ms[-1]


def test_more_scans_than_may_wait_become_cells_whatever_they_cost(monkeypatch):
    monkeypatch.setattr(writer_module, "_MOST_WAITING", 200)
    writer, copy = pair("scans", mtu=84)
    writer.sense(some_scans(1, 300))
    assert {update.form for update in publish(writer, copy)} == {Update.CELLS}


def test_only_full_updates_are_made_before_their_time():
    writer, _ = pair(mtu=300)
    writer.sense(some_scans(1, 3))
    assert writer.next_update(partial=False) is None
    assert not writer.full
    writer.sense(some_scans(2, 100))
    assert writer.full
    update, _ = writer.next_update(partial=False)
    assert len(encode(update)) > 270
