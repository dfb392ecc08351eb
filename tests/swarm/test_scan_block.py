import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapping.scan import INVALID, NO_RETURN, Scans
from swarm.bits import pack
from swarm.drops import Drop
from swarm.limits import MAX_COORDINATE_MM, MAX_SCANS
from swarm.scan_block import _HEADER, decode_scans, encode_scans

FAR = 800


@st.composite
def batches(draw, most=12):
    count, beams = draw(st.integers(1, most)), draw(st.integers(0, 6))
    near = draw(st.booleans())
    place = st.integers(-3000, 3000) if near else st.integers(-MAX_COORDINATE_MM, MAX_COORDINATE_MM)
    stamp = st.integers(0, 10**6) if near else st.integers(-(2**63), 2**63 - 1)
    reading = st.one_of(st.integers(1, FAR), st.sampled_from([INVALID, NO_RETURN]))
    poses = np.column_stack(
        [
            draw(arrays(np.int64, (count, 2), elements=place)),
            draw(arrays(np.int64, count, elements=st.integers(0, 65535))),
        ]
    )
    return Scans(
        draw(arrays(np.int64, count, elements=stamp)),
        poses.astype(np.int32),
        draw(arrays(np.uint16, (count, beams), elements=reading)),
    )


def rows(scans):
    return [
        (stamp, *pose, ranges)
        for stamp, pose, ranges in zip(
            scans.stamps_ms.tolist(), scans.poses.tolist(), scans.ranges.tolist(), strict=True
        )
    ]


def scans_or_reason(block, beams):
    """What a block decodes to, or why it is dropped."""
    try:
        return decode_scans(block, beams, FAR)
    except Drop as drop:
        return drop.reason


@given(batches())
def test_decode_after_encode_is_identity(scans):
    assert rows(decode_scans(encode_scans(scans), scans.beams, FAR)) == rows(scans)


@given(batches())
def test_the_plain_client_reads_the_same(plain_client, scans):
    assert plain_client.decode_block(encode_scans(scans), scans.beams) == rows(scans)


@given(batches(), st.data())
def test_a_block_that_was_changed_gives_valid_scans_or_a_drop(scans, data):
    block = bytearray(encode_scans(scans))
    for _ in range(data.draw(st.integers(1, 3))):
        block[data.draw(st.integers(0, len(block) - 1))] = data.draw(st.integers(0, 255))
    found = scans_or_reason(bytes(block), scans.beams)
    if found == "bad_payload":
        return
    assert np.abs(found.poses[:, :2].astype(np.int64)).max() <= MAX_COORDINATE_MM
    assert ((found.ranges <= FAR) | (found.ranges == NO_RETURN)).all()


@given(st.binary(max_size=80), st.integers(0, 5))
def test_garbage_is_dropped(garbage, beams):
    found = scans_or_reason(garbage, beams)
    assert isinstance(found, Scans) or found == "bad_payload"


@settings(max_examples=30)
@given(batches(), st.binary(min_size=1, max_size=3))
def test_nothing_may_follow(scans, more):
    with pytest.raises(Drop, match="content"):
        decode_scans(encode_scans(scans) + more, scans.beams, FAR)


def empty(count):
    return _HEADER.pack(0, count, 0, 0, 0, 0) + pack(np.zeros(max(count - 1, 0), np.int64), 8) * 3 + b"\0" * 600


@pytest.mark.parametrize("count", [0, MAX_SCANS + 1, 65535])
def test_no_scans_and_too_many_scans_are_dropped(count):
    with pytest.raises(Drop):
        decode_scans(empty(count) + b"\0" * 9000, 0, FAR)


def test_an_unknown_predictor_is_dropped():
    block = encode_scans(Scans.join([one_scan(1, 2)]))
    with pytest.raises(Drop):
        decode_scans(b"\x02" + block[1:], 2, FAR)


def one_scan(*ranges, x=0):
    return Scans(np.array([7]), np.array([[x, 0, 0]], np.int32), np.array([ranges], np.uint16))


def test_a_reading_beyond_the_sensors_range_is_dropped_and_no_return_is_none():
    assert decode_scans(encode_scans(one_scan(FAR, NO_RETURN)), 2, FAR).ranges.tolist() == [[FAR, NO_RETURN]]
    with pytest.raises(Drop):
        decode_scans(encode_scans(one_scan(FAR + 1, NO_RETURN)), 2, FAR)


def test_a_pose_beyond_1000_km_is_dropped():
    decode_scans(encode_scans(one_scan(x=-MAX_COORDINATE_MM)), 0, FAR)
    with pytest.raises(Drop):
        decode_scans(encode_scans(one_scan(x=MAX_COORDINATE_MM + 1)), 0, FAR)


def test_what_stands_still_costs_a_bit_a_number():
    still = Scans(
        np.arange(800, dtype=np.int64) * 100, np.full((800, 3), 5, np.int32), np.full((800, 5), 700, np.uint16)
    )
    assert len(encode_scans(still)) <= 21 + 5 + 800 * 9 // 8 + 20


def test_ranges_that_resemble_the_last_scan_are_predicted_in_time():
    chance = np.random.default_rng(1)
    row = chance.integers(1, FAR, 40)
    ranges = row + chance.integers(-2, 3, (30, 40))
    scans = Scans(np.arange(30, dtype=np.int64), np.zeros((30, 3), np.int32), np.clip(ranges, 1, FAR).astype(np.uint16))
    block = encode_scans(scans)
    assert block[0] == 1
    assert rows(decode_scans(block, 40, FAR)) == rows(scans)
