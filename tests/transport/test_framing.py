"""Frames through a line that cuts, adds and changes bytes."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from transport.framing import MAX_CONTENT, Deframer, longest_frame, wrap

contents = st.binary(max_size=MAX_CONTENT)


def chunks_of(stream: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(stream) + 1) for cut in cuts), len(stream)]
    return [stream[start:end] for start, end in pairwise(edges)]


@given(contents)
def test_what_was_wrapped_is_found(content):
    assert Deframer().feed(wrap(content)) == [content]


@given(contents)
def test_a_frame_has_one_zero_and_that_ends_it(content):
    frame = wrap(content)
    assert frame.index(0) == len(frame) - 1
    assert len(frame) <= longest_frame(len(content))


def test_the_longest_frame_is_no_longer_than_it_must_be():
    for length in (0, 1, 251, 252, 253, 254, 505, 506, 507):
        longest = max(len(wrap(bytes([fill]) * length)) for fill in range(1, 256))
        assert longest_frame(length) - 1 <= longest <= longest_frame(length)


def test_the_bytes_are_those_of_the_standards():
    """123456789 has the CRC catalogue's check value 0x29B1; the COBS of eleven bytes without a zero starts with 12."""
    assert wrap(b"123456789") == b"\x0c123456789\xb1\x29\x00"


@given(st.lists(contents, max_size=6), st.lists(st.integers(0, 10_000)))
def test_any_chunking_gives_the_same_frames(sent, cuts):
    deframer = Deframer()
    stream = b"".join(map(wrap, sent))
    got = [content for chunk in chunks_of(stream, cuts) for content in deframer.feed(chunk)]
    assert got == sent
    assert deframer.counters == ({"good": len(sent)} if sent else {})


@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000)))
def test_any_chunking_counts_the_same_damage(noise, cuts):
    whole, cut = Deframer(max_content=50), Deframer(max_content=50)
    expected = whole.feed(noise + b"\0")
    got = [content for chunk in chunks_of(noise + b"\0", cuts) for content in cut.feed(chunk)]
    assert (got, cut.counters) == (expected, whole.counters)


@given(st.binary(max_size=300), st.lists(contents, min_size=1, max_size=4))
def test_a_frame_after_noise_is_read(noise, sent):
    deframer = Deframer()
    got = deframer.feed(noise + b"\0" + b"".join(map(wrap, sent)))
    assert got[-len(sent) :] == sent


@given(contents, st.data())
def test_a_changed_byte_costs_its_frame_and_the_next_at_most(content, data):
    first, second, third = wrap(content), wrap(b"second"), wrap(b"third")
    at = data.draw(st.integers(0, len(first) - 1))
    damaged = bytearray(first)
    damaged[at] ^= data.draw(st.integers(1, 255))
    deframer = Deframer()
    got = deframer.feed(bytes(damaged) + second + third)
    assert content not in got or content in {b"second", b"third"}
    assert got[-1] == b"third"
    assert b"second" in got or at == len(first) - 1  # a delimiter that became something else glues two frames
    assert deframer.counters["damaged"] >= 1


def test_every_single_changed_bit_is_noticed():
    """A CRC with a linear term in its polynomial finds every error of one or two bits; COBS must not undo that."""
    frame = wrap(bytes(range(36)))
    for bit in range(8 * len(frame) - 8):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        assert Deframer().feed(bytes(damaged)) == []


def test_delimiters_in_a_row_are_no_damage():
    deframer = Deframer()
    assert deframer.feed(b"\0\0\0" + wrap(b"x") + b"\0\0") == [b"x"]
    assert deframer.counters == {"good": 1}


@pytest.mark.parametrize("piece", [b"\xff\0", b"\x05ab\0", b"\x01\0", b"\x02a\0", wrap(b"abc")[:-2] + b"\0"])
def test_what_is_no_frame_is_damage(piece):
    deframer = Deframer()
    assert deframer.feed(piece) == []
    assert deframer.counters == {"damaged": 1}


def test_the_longest_content_is_taken_and_a_longer_one_is_damage():
    deframer = Deframer(max_content=300)
    assert deframer.feed(wrap(b"x" * 300) + wrap(b"x" * 301) + wrap(b"\0" * 300) + wrap(b"\0" * 301)) == [
        b"x" * 300,
        b"\0" * 300,
    ]
    assert deframer.counters == {"good": 2, "damaged": 2}


def test_an_endless_frame_takes_no_memory_and_counts_once():
    deframer = Deframer()
    for _ in range(1000):
        assert deframer.feed(b"\x55" * 1000) == []
    assert len(deframer._unfinished) <= longest_frame(MAX_CONTENT)
    assert deframer.feed(b"\0" + wrap(b"and on")) == [b"and on"]
    assert deframer.counters == {"good": 1, "damaged": 1}


def test_a_forgotten_beginning_does_not_harm_the_next_frame():
    deframer = Deframer()
    deframer.feed(wrap(b"a frame whose cable was pulled")[:9])
    deframer.forget()
    assert deframer.feed(wrap(b"next")) == [b"next"]
    assert deframer.counters == {"good": 1}


@pytest.mark.parametrize("seed", range(3))
def test_a_million_random_bytes_are_next_to_nothing(seed):
    """Some 4,000 pieces, of which one in 65,536 may pass the checksum."""
    noise = random.Random(seed).randbytes(1_000_000)
    deframer = Deframer()
    got = [content for start in range(0, len(noise), 777) for content in deframer.feed(noise[start : start + 777])]
    assert len(got) <= 2
    assert deframer.counters["damaged"] > 3000
