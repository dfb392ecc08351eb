import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.bits import pack, unpack

near = st.lists(st.one_of(st.integers(-20, 20), st.integers(-(2**15), 2**15 - 1)), max_size=80)
far = st.lists(st.one_of(st.integers(-20, 20), st.integers(-(2**63), 2**63 - 1)), max_size=80)


@pytest.mark.parametrize(("width", "largest"), [(2, 2**15), (8, 2**63)])
@given(data=st.data(), after=st.binary(max_size=9))
def test_decode_after_encode_is_identity_and_what_follows_is_given_back(width, largest, data, after):
    values = data.draw(near if largest == 2**15 else far)
    found, rest = unpack(pack(np.array(values, np.int64), width) + after, len(values), width)
    assert found.tolist() == values
    assert rest == after


@given(far)
def test_the_plain_client_reads_the_same(plain_client, values):
    block = pack(np.array(values, np.int64), 8)
    assert plain_client.decode_rice(block + b"after", len(values), 8) == (values, b"after")


@given(near, st.data())
def test_a_block_that_ends_too_soon_is_an_error(values, data):
    block = pack(np.array(values, np.int64), 2)
    short = block[: data.draw(st.integers(0, len(block) - 1))]
    with pytest.raises(ValueError, match="bits"):
        unpack(short, len(values), 2)


@given(st.binary(max_size=60), st.integers(0, 50), st.sampled_from([2, 8]))
def test_garbage_gives_values_or_a_value_error(garbage, count, width):
    try:
        values, rest = unpack(garbage, count, width)
    except ValueError:
        return
    assert len(values) == count
    assert garbage.endswith(rest)


def test_sixteen_ones_in_a_row_are_an_error():
    with pytest.raises(ValueError, match="too large"):
        unpack(bytes([0, 0xFF, 0xFF, 0x00]), 2, 2)


def test_no_values_take_one_byte():
    assert pack(np.zeros(0, np.int64), 2) == b"\0"


def test_zeros_take_a_bit_each():
    assert len(pack(np.zeros(800, np.int64), 8)) == 1 + 100


def test_one_far_value_among_near_ones_costs_little_more_than_its_width():
    values = np.zeros(800, np.int64)
    values[400] = 2**60
    assert len(pack(values, 8)) <= 1 + 100 + 2 + 8


@pytest.mark.parametrize("value", [2**33, -(2**62), 2**63 - 1])
def test_values_that_are_all_far_are_escaped(value):
    """A writer used to stop for good when a robot without a battery-backed clock learnt what year it is."""
    found, rest = unpack(pack(np.array([value], np.int64), 8), 1, 8)
    assert (found.tolist(), rest) == ([value], b"")
