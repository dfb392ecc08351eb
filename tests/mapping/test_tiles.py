import hashlib
import random
import struct
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapping.lattice import TILE, TileKey
from mapping.tiles import Evidence, added, frozen, map_digest, merged, summed

keys = st.builds(TileKey, st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1))
near_keys = st.builds(TileKey, st.integers(-2, 2), st.integers(-2, 2))
cells = st.integers(0, 2**32 - 1).map(
    lambda seed: np.random.default_rng(seed).integers(-500, 500, (TILE, TILE), dtype=np.int32)
)
maps = st.dictionaries(near_keys, cells, max_size=5)


def digest_as_documented(tiles):
    """Law 8, byte by byte, without NumPy."""
    whole = b""
    for ty, tx in sorted(tiles):
        numbers = [int(value) for row in tiles[ty, tx] for value in row]
        if any(numbers):
            whole += struct.pack("<ii", ty, tx) + b"".join(struct.pack("<i", number) for number in numbers)
    return hashlib.blake2b(whole, digest_size=16).digest()


@given(st.dictionaries(keys, cells, max_size=3))
def test_the_digest_is_the_documented_one(tiles):
    assert map_digest(tiles) == digest_as_documented(tiles)


def test_the_digest_of_a_map_that_everybody_can_compute():
    """One cell of +85 in tile (-1, 2), row 3, column 4: a constant for implementations in other languages."""
    tile = np.zeros((TILE, TILE), np.int32)
    tile[3, 4] = 85
    body = bytearray(struct.pack("<ii", -1, 2) + bytes(4096))
    body[8 + 4 * (3 * 32 + 4)] = 85
    assert map_digest({TileKey(-1, 2): tile}) == hashlib.blake2b(body, digest_size=16).digest()
    assert map_digest({}).hex() == "cae66941d9efbd404e4d88758ea67670"


@given(maps, near_keys)
def test_a_tile_of_zeros_says_nothing(tiles, key):
    more = {TileKey(key.ty + 100, key.tx): np.zeros((TILE, TILE), np.int32), **tiles}
    assert map_digest(more) == map_digest(tiles)


@given(maps, st.randoms(use_true_random=False))
def test_the_digest_does_not_depend_on_the_order_of_the_dictionary(tiles, random_: random.Random):
    items = list(tiles.items())
    random_.shuffle(items)
    assert map_digest(dict(items)) == map_digest(tiles)


@given(st.lists(maps, max_size=4))
def test_a_sum_is_the_same_in_any_order(several):
    assert len({map_digest(summed(list(order))) for order in permutations(several)}) == 1


@given(st.lists(maps, min_size=1, max_size=4))
def test_a_sum_leaves_its_terms_alone(several):
    before = [map_digest(tiles) for tiles in several]
    summed(several)
    assert [map_digest(tiles) for tiles in several] == before


def evidence_of(tiles):
    ordered = sorted(tiles)
    cells = np.array([tiles[key] for key in ordered], np.int32).reshape(-1, TILE, TILE)
    return Evidence(np.array(ordered, np.int32).reshape(-1, 2), cells)


@given(maps, maps)
def test_adding_is_summing(tiles, news):
    after = {**tiles, **added(tiles, evidence_of(news))}
    assert map_digest(after) == map_digest(summed([tiles, news]))


@given(maps, maps)
def test_adding_writes_nothing_that_was_handed_out(tiles, news):
    before = {key: frozen(tile.copy()) for key, tile in tiles.items()}
    kept = dict(before)
    changed = added(before, evidence_of(news))
    assert before == kept  # the very same arrays: they have no other equality
    assert map_digest(before) == map_digest(tiles)
    for tile in changed.values():
        assert not tile.flags.writeable
        assert not any(np.shares_memory(tile, old) for old in (*before.values(), *news.values()))


@given(maps, maps)
def test_only_the_tiles_that_evidence_touches_are_returned(tiles, news):
    assert added(tiles, evidence_of(news)).keys() == news.keys()


@given(st.lists(maps, max_size=4))
def test_merged_evidence_is_the_sum_with_no_tile_twice(several):
    whole = merged([evidence_of(tiles) for tiles in several])
    keys = [key for key, _ in whole]
    assert keys == sorted(set(keys))
    assert map_digest(dict(iter(whole))) == map_digest(summed(several))


@given(arrays(np.int32, (TILE, TILE), elements=st.integers(-500, 500)), st.integers(1, 200))
def test_a_limit_holds_every_cell(tile, limit):
    changed = added({}, evidence_of({TileKey(0, 0): tile}), limit)
    result = changed.get(TileKey(0, 0), np.zeros((TILE, TILE), np.int32))
    assert (result == np.clip(tile, -limit, limit)).all()


def test_a_frozen_tile_cannot_be_written():
    tile = frozen(np.zeros((TILE, TILE), np.int32))
    with pytest.raises(ValueError, match="read-only"):
        tile[0, 0] = 1
