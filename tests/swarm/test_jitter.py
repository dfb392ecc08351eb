from hypothesis import given
from hypothesis import strategies as st

from swarm.jitter import Jitter


@given(st.binary(max_size=80))
def test_the_same_seed_gives_the_same_numbers(seed):
    one, other = Jitter(seed), Jitter(seed)
    assert [one.fraction() for _ in range(5)] == [other.fraction() for _ in range(5)]


def test_different_seeds_give_different_numbers():
    assert len({Jitter(bytes([seed])).fraction() for seed in range(256)}) == 256


@given(st.binary(max_size=8), st.floats(0, 10), st.floats(0, 10))
def test_numbers_lie_between_their_bounds(seed, low, more):
    jitter = Jitter(seed)
    assert all(0 <= jitter.fraction() < 1 for _ in range(10))
    assert all(low <= jitter.between(low, low + more) <= low + more for _ in range(10))


def test_numbers_are_spread_evenly():
    jitter = Jitter(b"seed")
    tenths = [0] * 10
    for _ in range(5000):
        tenths[int(jitter.fraction() * 10)] += 1
    assert min(tenths) > 400
    assert max(tenths) < 600
