import hashlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping import raster as raster_module
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice, TileKey
from mapping.raster import raster
from mapping.scan import Scans
from mapping.sensor import laser, orion
from mapping.tiles import frozen
from swarm import state as state_module
from swarm.drops import Drop
from swarm.messages import Update
from swarm.scan_block import encode_scans
from swarm.session import Descriptor, Rules
from swarm.state import State, changed_tiles, tile_hash
from swarm.tile_block import encode_changes, encode_tile

keys = st.builds(TileKey, st.integers(-2, 2), st.integers(-2, 2))


def tile(value):
    cells = np.zeros((32, 32), np.int32)
    cells[3, 4] = value
    return frozen(cells)


changes = st.lists(st.dictionaries(keys, st.integers(-3, 3).map(tile), max_size=4), max_size=8)


def after(given_changes):
    state = State()
    for changed in given_changes:
        state.apply(state.step(changed))
    return state


def test_the_hash_is_the_documented_one():
    data = struct.pack("<ii", -1, 2) + bytes(4 * (3 * 32 + 4)) + struct.pack("<i", 85) + bytes(4 * (1023 - 100))
    expected = int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "little")
    assert tile_hash(TileKey(-1, 2), tile(85)) == expected == 9492693976603904298


@given(changes)
def test_the_check_that_is_kept_is_the_sum_of_n_and_all_hashes(given_changes):
    state = after(given_changes)
    assert state.n == len(given_changes)
    assert state.check == (state.n + sum(tile_hash(key, cells) for key, cells in state.cells.items())) % 2**64
    assert state.sound()
    assert state.cells.keys() == state.marks.keys()


@given(changes)
def test_a_tiles_version_is_the_last_update_that_changed_its_cells(given_changes):
    versions, values = {}, {}
    for n, changed in enumerate(given_changes, 1):
        for key, cells in changed.items():
            if int(cells[3, 4]) != values.get(key, 0):
                versions[key], values[key] = n, int(cells[3, 4])
    assert {key: mark.version for key, mark in after(given_changes).marks.items()} == versions


@given(changes, changes)
def test_a_copy_stays_when_the_state_moves_on(one, more):
    state = after(one)
    copy, root = state.copy(), state.root()
    for changed in more:
        state.apply(state.step(changed))
    assert (copy.root(), copy.n) == (root, len(one))
    assert copy.sound()


@given(changes)
def test_a_step_changes_nothing_until_it_is_applied(given_changes):
    state = after(given_changes)
    before = (state.n, state.check, state.root())
    step = state.step({TileKey(9, 9): tile(5)})
    assert (state.n, state.check, state.root()) == before
    change = state.apply(step)
    assert [*change] == [TileKey(9, 9)]
    assert change[TileKey(9, 9)][0] is None
    assert state.check == step.check


@given(changes)
def test_what_verifies_is_the_same_state_and_any_other_root_is_dropped(given_changes):
    state = after(given_changes)
    again = State.verified(state.n, dict(state.marks), dict(state.cells), state.root())
    assert (again.n, again.check, again.root()) == (state.n, state.check, state.root())
    with pytest.raises(Drop, match="root"):
        State.verified(state.n, dict(state.marks), dict(state.cells), bytes(16))


def test_a_damaged_tile_a_wrong_mark_or_a_wrong_check_is_not_sound():
    for spoil in (
        lambda state: state.cells.update({TileKey(0, 0): tile(9)}),
        lambda state: state.cells.update({TileKey(7, 7): tile(9)}),
        lambda state: state.cells.pop(TileKey(0, 0)),
        lambda state: setattr(state, "check", 0),
    ):
        state = after([{TileKey(0, 0): tile(1), TileKey(0, 1): tile(2)}])
        assert state.sound()
        spoil(state)
        assert not state.sound()
        assert (TileKey(0, 1), tile_hash(TileKey(0, 1), tile(2))) in state.sound_tiles()


def test_more_tiles_than_a_session_may_have_are_dropped(monkeypatch):
    monkeypatch.setattr(state_module, "MAX_TILES", 2)
    state = after([{TileKey(0, 0): tile(1), TileKey(0, 1): tile(2)}])
    state.step({TileKey(0, 1): tile(3)})
    with pytest.raises(Drop, match="limit"):
        state.step({TileKey(0, 2): tile(3)})
    assert state.n == 1


RULES = Rules(Lattice(50), EvidenceModel())
DESCRIPTOR = Descriptor("r1", bytes(8), RULES, orion(), None)
SCANS = Scans(np.array([0]), np.array([[0, 0, 0]], np.int32), np.array([[0, 0, 400, 0, 0]], np.uint16))
FAR_APART = Scans(np.arange(2), np.array([[0, 0, 0], [9000, 0, 0]], np.int32), np.full((2, 5), 300, np.uint16))


def update(form, payload, trail=b""):
    return Update(bytes(8), 1, form, payload, trail, 0)


def test_all_three_forms_leave_the_same_tiles_behind():
    first = changed_tiles(State(), update(Update.SCANS, encode_scans(SCANS)), DESCRIPTOR, raster)
    for form, payload in (
        (Update.TILES, b"".join(encode_tile(key, cells) for key, cells in first.items())),
        (Update.CELLS, b"".join(encode_changes(key, None, cells) for key, cells in first.items())),
    ):
        found = changed_tiles(State(), update(form, payload), DESCRIPTOR, raster)
        assert found.keys() == first.keys()
        assert all(np.array_equal(found[key], first[key]) for key in first)


@pytest.mark.parametrize("form", [Update.SCANS, Update.CELLS, Update.TILES])
def test_a_payload_of_another_kind_is_dropped(form):
    with pytest.raises(Drop, match="content"):
        changed_tiles(State(), update(form, b"garbage"), DESCRIPTOR, raster)


def test_scans_that_touch_more_tiles_than_there_may_be_are_dropped(monkeypatch):
    monkeypatch.setattr(raster_module, "MAX_TILES", 1)
    with pytest.raises(Drop, match="limit"):
        changed_tiles(State(), update(Update.SCANS, encode_scans(FAR_APART)), DESCRIPTOR, raster)


def test_a_trail_that_does_not_decode_drops_the_update():
    """It used to reach listeners, where it raised after the update had been applied."""
    trail = encode_scans(Scans(SCANS.stamps_ms, SCANS.poses, np.zeros((1, 0), np.uint16)))
    assert changed_tiles(State(), update(Update.TILES, b"", trail), DESCRIPTOR, raster) == {}
    with pytest.raises(Drop, match="content"):
        changed_tiles(State(), update(Update.TILES, b"", trail + b"x"), DESCRIPTOR, raster)


def test_an_update_whose_rays_would_visit_too_many_cells_is_dropped_before_it_costs_time():
    """Two kilobytes of scans that each cross kilometres of small cells: dropped by counting, not by trying."""
    rules = Rules(Lattice(1), EvidenceModel())
    descriptor = Descriptor("r1", b"session1", rules, laser(64, first=0.0, step=0.1, max_range=4.0), None)
    assert descriptor.most_scans == 2**22 // (64 * 4002) == 16

    def update(count):
        scans = Scans(np.arange(count), np.zeros((count, 3), np.int32), np.full((count, 64), 65535, np.uint16))
        return Update(b"session1", 1, Update.SCANS, encode_scans(scans), b"", 0)

    def never(rays, model):
        raise AssertionError("the kernel was called")

    with pytest.raises(Drop, match="limit") as caught:
        changed_tiles(State(), update(17), descriptor, never)
    assert caught.value.reason == "too_many"
    assert changed_tiles(State(), update(16), descriptor, raster)
