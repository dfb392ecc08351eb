import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapping.lattice import TileKey
from mapping.tiles import map_digest, summed
from swarm.fusion import Fusion

tiles = st.integers(0, 2**32).map(
    lambda seed: np.random.default_rng(seed).integers(-(2**31), 2**31, (32, 32)).astype(np.int32)
)
keys = st.builds(TileKey, st.integers(-1, 1), st.integers(-1, 1))
steps = st.lists(st.tuples(st.integers(0, 2), keys, tiles), max_size=12)


@given(steps)
def test_the_running_sum_is_the_sum_of_the_sessions(given_steps):
    sessions, fusion = [{}, {}, {}], Fusion()
    for session, key, after in given_steps:
        before = sessions[session].get(key)
        fusion.add({key: (before, after)})
        sessions[session][key] = after
    assert fusion.digest() == map_digest(summed(sessions))
    again = Fusion()
    again.rebuild(sessions)
    assert again.digest() == fusion.digest()


@given(tiles, tiles)
def test_arrays_that_were_given_out_never_change(one, other):
    fusion, key = Fusion(), TileKey(0, 0)
    fusion.add({key: (None, one)})
    seen = fusion.tiles[key]
    kept = seen.copy()
    fusion.add({key: (None, other)})
    assert np.array_equal(seen, kept)
    assert fusion.tiles[key] is not seen
    assert not fusion.tiles[key].flags.writeable


def test_what_is_taken_away_again_leaves_no_trace_in_the_digest():
    fusion, cells = Fusion(), np.ones((32, 32), np.int32)
    fusion.add({TileKey(1, 2): (None, cells)})
    fusion.add({TileKey(1, 2): (cells, cells - cells)})
    assert fusion.digest() == Fusion().digest()
