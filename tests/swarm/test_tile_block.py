import struct
import tracemalloc
import zlib
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.lattice import TileKey
from swarm import tile_block
from swarm.drops import Drop
from swarm.limits import MAX_TILE_COORDINATE
from swarm.tile_block import decode_changes, decode_tiles, encode_changes, encode_tile

reach = st.integers(-MAX_TILE_COORDINATE, MAX_TILE_COORDINATE)
keys = st.builds(TileKey, reach, reach)


def random_tile(seed, density):
    chance = np.random.default_rng(seed)
    cells = chance.integers(-(2**31), 2**31, (32, 32))
    return np.where(chance.random((32, 32)) < density, cells, 0).astype(np.int32)


tiles = st.builds(random_tile, st.integers(0, 2**32), st.sampled_from([0.0, 0.01, 0.5, 1.0]))
maps = st.dictionaries(keys, tiles, max_size=4)
KEY = TileKey(-3, 7)


def entry(content, key=KEY, deflate=True):
    squeezer = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = squeezer.compress(content) + squeezer.flush() if deflate else content
    return struct.pack("<iiH", *key, len(data)) + data


def same(one, other):
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)


@given(maps)
def test_whole_tiles_come_back_and_cannot_be_written(before):
    found = decode_tiles(b"".join(encode_tile(key, cells) for key, cells in before.items()))
    assert same(found, before)
    assert not any(cells.flags.writeable for cells in found.values())


@given(maps, maps)
def test_changes_lead_from_one_map_to_the_other(before, after):
    block = b"".join(
        encode_changes(key, before.get(key), cells)
        for key, cells in after.items()
        if not np.array_equal(cells, before.get(key, np.zeros((32, 32))))
    )
    untouched = {key: cells.copy() for key, cells in before.items()}
    found = decode_changes(block, before)
    assert same(before, untouched)
    assert same({key: found.get(key, after[key]) for key in after}, after)
    assert not any(cells.flags.writeable for cells in found.values())


@given(maps, st.data())
def test_a_block_that_was_changed_gives_tiles_or_a_drop(before, data):
    block = bytearray(b"".join(encode_tile(key, cells) for key, cells in before.items()) or b"\0")
    block[data.draw(st.integers(0, len(block) - 1))] ^= data.draw(st.integers(1, 255))
    for decode in (decode_tiles, lambda block: decode_changes(block, before)):
        with suppress(Drop):
            found = decode(bytes(block))
            assert all(cells.shape == (32, 32) and cells.dtype == np.int32 for cells in found.values())


def indices(*index, values=None):
    return struct.pack(f"<{len(index)}H", *index) + struct.pack(f"<{len(index)}i", *(values or [1] * len(index)))


@pytest.mark.parametrize(
    "block",
    {
        "too short for its header": b"\0" * 9,
        "shorter than it says": entry(bytes(4096))[:-1],
        "no deflate": entry(b"\xff\xff\xff", deflate=False),
        "a deflate stream that does not end": entry(zlib.compressobj(9, zlib.DEFLATED, -15).flush(2), deflate=False),
        "something after the stream": entry(zlib.compress(bytes(4096), wbits=-15) + b"x", deflate=False),
        "too few cells": entry(bytes(4092)),
        "too many cells": entry(bytes(4100)),
        "a tile twice": entry(bytes(4096)) * 2,
        "too far north": entry(bytes(4096), TileKey(MAX_TILE_COORDINATE + 1, 0)),
        "too far west": entry(bytes(4096), TileKey(0, -MAX_TILE_COORDINATE - 1)),
    }.items(),
    ids=lambda item: item[0],
)
def test_bad_tiles_are_dropped(block):
    with pytest.raises(Drop, match="content"):
        decode_tiles(block[1])


@pytest.mark.parametrize(
    "content",
    {
        "no cells": b"",
        "an odd length": indices(1, 2) + b"x",
        "descending": indices(2, 1),
        "one cell twice": indices(1, 1),
        "beyond the tile": indices(5, 1024),
    }.items(),
    ids=lambda item: item[0],
)
def test_bad_changes_are_dropped(content):
    with pytest.raises(Drop, match="content"):
        decode_changes(entry(content[1]), {})


def test_every_cell_of_a_tile_may_change():
    found = decode_changes(entry(indices(*range(1024), values=range(1024))), {})
    assert found[KEY].ravel().tolist() == [*range(1024)]


def test_a_bomb_is_dropped_before_it_goes_off():
    """60 kB of deflate that would inflate to 60 MB."""
    bomb = entry(bytes(60_000_000))
    tracemalloc.start()
    with pytest.raises(Drop):
        decode_tiles(bomb)
    with pytest.raises(Drop):
        decode_changes(bomb, {})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200_000


def test_more_tiles_than_a_session_may_have_are_dropped_before_they_are_made(monkeypatch):
    """An entry of 26 bytes becomes a tile of 4 kB: 8 MiB of them were 1.3 GB, refused only afterwards."""
    monkeypatch.setattr(tile_block, "MAX_TILES", 3)
    blocks = [entry(bytes(4096), TileKey(0, k)) for k in range(4)]
    assert len(decode_tiles(b"".join(blocks[:3]))) == 3
    with pytest.raises(Drop, match="limit"):
        decode_tiles(b"".join(blocks))
