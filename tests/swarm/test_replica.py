import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice, TileKey
from mapping.raster import raster
from mapping.sensor import orion
from mapping.tiles import frozen, map_digest
from swarm import replica as replica_module
from swarm.drops import Drop
from swarm.messages import Manifest, Need, Session, TilesMessage, Update, Want
from swarm.replica import CHECKPOINT, WINDOW, Replica
from swarm.session import Descriptor, Rules
from swarm.state import State
from swarm.tile_block import decode_tiles, encode_tile

SESSION = b"session1"
DESCRIPTOR = Descriptor("r1", SESSION, Rules(Lattice(50), EvidenceModel()), orion(), None)


def tile(value):
    cells = np.zeros((32, 32), np.int32)
    cells[0, 0] = value
    return frozen(cells)


def new():
    return Replica(DESCRIPTOR, raster)


def written(count):
    """A replica after so many updates, and these; each changes one of seven tiles."""
    replica, updates = new(), []
    for n in range(1, count + 1):
        key, cells = TileKey(0, n % 7), tile(n)
        update, _ = replica.write(Update.TILES, encode_tile(key, cells), {key: cells})
        updates.append(update)
    return replica, updates


def offer(replica, update):
    """The updates that are applied, or the reason why not."""
    try:
        return [applied.n for applied, _ in replica.offer(update)]
    except Drop as drop:
        return drop.reason


WRITER, UPDATES = written(45)


@settings(max_examples=40)
@given(st.randoms(use_true_random=False), st.integers(1, 45))
def test_updates_in_any_order_and_repeated_give_the_same_state(chance, count):
    some = UPDATES[:count] + chance.choices(UPDATES[:count], k=count)
    chance.shuffle(some)
    replica = new()
    applied = []
    for update in some:
        found = offer(replica, update)
        applied += found if isinstance(found, list) else []
        assert replica.state.sound()
    assert applied == [*range(1, count + 1)]
    reference = written(count)[0]
    assert replica.state.root() == reference.state.root()
    assert replica.checkpoint.root() == reference.checkpoint.root()
    assert replica.first_pending is None


def test_nothing_is_applied_of_a_bad_update():
    replica = new()
    offer(replica, UPDATES[0])
    before = (replica.state.n, replica.state.root(), replica.state.check)
    good = UPDATES[1]
    for bad, reason in (
        (Update(SESSION, 2, good.form, good.payload, b"", good.check ^ 1), "bad_check"),
        (Update(SESSION, 2, good.form, good.payload + b"x", b"", good.check), "bad_payload"),
        (Update(SESSION, 2, Update.SCANS, good.payload, b"", good.check), "bad_payload"),
        (UPDATES[0], "stale"),
    ):
        assert offer(replica, bad) == reason
        assert (replica.state.n, replica.state.root(), replica.state.check) == before
    assert offer(replica, good) == [2]


def test_a_bad_update_among_those_kept_stops_there_and_the_good_one_may_come_later():
    replica = new()
    bad = Update(SESSION, 3, Update.TILES, b"", b"", 0)
    assert offer(replica, bad) == []
    assert offer(replica, UPDATES[3]) == []
    assert offer(replica, UPDATES[1]) == []
    assert offer(replica, UPDATES[0]) == "bad_check"
    assert replica.state.n == 2
    assert offer(replica, UPDATES[2]) == [3, 4]


def test_of_the_updates_that_come_too_early_the_nearest_are_kept(monkeypatch):
    monkeypatch.setattr(replica_module, "MAX_PENDING", 3)
    replica = new()
    for n in (9, 8, 7):
        assert offer(replica, UPDATES[n]) == []
    assert offer(replica, UPDATES[2]) == "too_far_ahead"  # update 10 made room for it
    assert offer(replica, UPDATES[20]) == "too_far_ahead"
    assert replica.first_pending == 3
    for n in (0, 1, 3, 4, 5):
        offer(replica, UPDATES[n])
    offer(replica, UPDATES[6])
    assert replica.state.n == 9


def test_the_bytes_that_wait_are_bounded(monkeypatch):
    monkeypatch.setattr(replica_module, "MAX_PENDING_BYTES", 100)
    replica = new()
    for n in range(44, 0, -1):
        offer(replica, UPDATES[n])
        assert replica._pending_bytes == sum(len(each.payload) for each in replica._pending.values()) <= 100
    offer(replica, UPDATES[0])
    assert replica.state.n > 2
    assert replica._pending_bytes == sum(len(each.payload) for each in replica._pending.values())


def kept(replica):
    return [*replica._ring]


def test_the_ring_holds_what_came_after_the_checkpoint_and_the_stretch_before_it():
    for count, first in ((1, 1), (19, 1), (20, 1), (39, 1), (40, 21), (45, 21), (60, 41)):
        replica = written(count)[0]
        assert kept(replica) == [*range(first, count + 1)]
        assert replica.checkpoint.n == count // CHECKPOINT * CHECKPOINT


def answers(want, replica=WRITER):
    return [*replica.answer(want)]


def test_a_small_gap_is_answered_with_updates():
    assert answers(Want(SESSION, 30, 0)) == UPDATES[30:45]
    assert answers(Want(SESSION, 30, 33)) == UPDATES[30:33]
    assert answers(Want(SESSION, 20, 0)) == UPDATES[20 : min(45, 20 + WINDOW)]
    assert answers(Want(SESSION, 45, 0)) == []
    assert answers(Want(SESSION, 2**31 - 1, 1)) == []


def test_whoever_lacks_the_descriptor_gets_it_first():
    replica, updates = written(3)
    assert answers(Want(SESSION, -1, 0), replica) == [Session(DESCRIPTOR.encode()), *updates]


def test_a_large_gap_is_answered_with_a_manifest_of_what_is_newer():
    [manifest] = answers(Want(SESSION, 5, 0))
    assert (manifest.n, manifest.since, manifest.root) == (40, 5, WRITER.checkpoint.root())
    assert manifest.marks() == {key: mark for key, mark in WRITER.checkpoint.marks.items() if mark.version > 5}


def test_all_copies_give_the_same_manifest_however_they_came_by_their_state():
    follower = new()
    for update in UPDATES[:42]:
        offer(follower, update)
    jumper = new()
    jumper.install(WRITER.checkpoint)
    want = Want(SESSION, 5, 0)
    assert answers(want, follower) == answers(want, jumper) == answers(want)


def test_a_copy_that_jumped_serves_its_checkpoint_and_what_came_later():
    jumper = new()
    offer(jumper, UPDATES[42])
    offer(jumper, UPDATES[40])
    change = jumper.install(WRITER.checkpoint)
    assert {key: before for key, (before, _) in change.items()} == dict.fromkeys(WRITER.checkpoint.cells)
    assert [update.n for update, _ in jumper.drain()] == [41]
    offer(jumper, UPDATES[41])
    assert jumper.state.n == 43
    assert answers(Want(SESSION, 40, 0), jumper) == UPDATES[40:43]


def test_a_state_that_was_installed_stays_what_it_was():
    """It may be another's checkpoint, or be installed again somewhere else."""
    writer, updates = written(2 * CHECKPOINT)
    state = written(CHECKPOINT)[0].state.copy()
    root, replica = state.root(), new()
    replica.install(state)
    for update in updates[CHECKPOINT:]:
        assert offer(replica, update) == [update.n]
    assert replica.checkpoint.root() == writer.checkpoint.root()
    assert (state.n, state.root()) == (CHECKPOINT, root)


def test_installing_tells_only_of_the_tiles_that_are_others_now():
    replica, _ = written(20)
    later, _ = written(20)
    later.state.cells.update(replica.state.cells)
    key = TileKey(0, 1)
    later.write(Update.TILES, b"", {key: tile(1000)})
    change = replica.install(later.state)
    assert [*change] == [key]
    assert change[key][0][0, 0] == 15


def test_a_restarted_copy_is_empty_and_can_follow_again():
    replica, _ = written(25)
    offer(replica, UPDATES[40])
    replica.restart()
    assert (replica.state.n, replica.checkpoint.n, kept(replica), replica.first_pending) == (0, 0, [], None)
    assert answers(Want(SESSION, 0, 0), replica) == []
    for update in UPDATES:
        offer(replica, update)
    assert map_digest(replica.state.cells) == map_digest(WRITER.state.cells)


def test_tiles_are_supplied_by_their_content_and_fit_the_mtu():
    wanted = [(key, mark.hash) for key, mark in WRITER.checkpoint.marks.items()]
    messages = [*WRITER.supply(Need(SESSION, 40, 0, Need.pack(wanted)), 100)]
    assert len(messages) > 1
    assert all(isinstance(each, TilesMessage) for each in messages)
    found = {}
    for each in messages:
        found |= decode_tiles(each.payload)
    assert all(np.array_equal(found[key], WRITER.checkpoint.cells[key]) for key, _ in wanted)
    assert len([*WRITER.supply(Need(SESSION, 40, 0, Need.pack(wanted)), 32768)]) == 1


def test_a_tile_named_many_times_is_supplied_once_and_deflated_once_for_all_who_ask(monkeypatch):
    replica, _ = written(40)
    calls = []

    def counting(key, *rest):
        calls.append(key)
        return encode_tile(key, *rest)

    monkeypatch.setattr(replica_module, "encode_tile", counting)
    key, mark = next(iter(replica.checkpoint.marks.items()))
    need = Need(SESSION, 40, 0, Need.pack([(key, mark.hash)] * 500))
    for _ in range(3):
        [message] = replica.supply(need, 32768)
        assert decode_tiles(message.payload).keys() == {key}
    assert calls == [key]


def test_a_provider_that_has_moved_on_answers_with_its_own_manifest():
    old, _ = written(20)
    wanted = [(key, mark.hash) for key, mark in old.checkpoint.marks.items()]
    manifest = [*WRITER.supply(Need(SESSION, 20, 3, Need.pack(wanted)), 32768)][-1]
    assert isinstance(manifest, Manifest)
    assert (manifest.n, manifest.since) == (40, 3)
    assert [*WRITER.supply(Need(SESSION, 40, 3, Need.pack([(TileKey(5, 5), 1)])), 32768)] == []


def test_a_writers_update_that_others_apply_leads_to_its_own_state():
    replica = new()
    for update in UPDATES:
        offer(replica, update)
    assert replica.state.root() == WRITER.state.root()
    assert State().root() == new().state.root()


def test_a_tile_that_is_asked_for_again_is_not_deflated_again(monkeypatch):
    """Of many tiles: a provider that deflates them at every retry is still at it when nobody asks any more."""
    deflated = []
    encode_tile = replica_module.encode_tile
    monkeypatch.setattr(replica_module, "encode_tile", lambda *tile: deflated.append(tile) or encode_tile(*tile))
    replica, _ = written(45)
    wanted = [(key, mark.hash) for key, mark in replica.checkpoint.marks.items()]
    need = Need(SESSION, replica.checkpoint.n, 0, Need.pack(wanted))
    first, second = list(replica.supply(need, 32768)), list(replica.supply(need, 32768))
    assert first == second
    assert len(deflated) == len(wanted)
