"""The table, and the bytes that follow from it."""

from __future__ import annotations

import dataclasses
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from transport.framing import wrap
from transport.mcu_frames import (
    FROM_MCU,
    LAYOUTS,
    MAX_BEAMS,
    MAX_CONTENT,
    REASONS,
    TO_MCU,
    VERSION,
    Drive,
    Field,
    Frame,
    FrameError,
    Range,
    Sample,
    decode,
    encode,
    limits,
)


def rows(fields: tuple[Field, ...]) -> st.SearchStrategy[tuple[int, ...]]:
    return st.tuples(*(st.integers(*limits(field)) for field in fields))


def frames_of(frame_type: type[Frame]) -> st.SearchStrategy[Frame]:
    layout = LAYOUTS[frame_type]
    values = rows(layout.fields)
    if layout.group is None:
        return values.map(lambda row: frame_type(*row))
    items = st.lists(rows(layout.group.fields).map(lambda row: layout.group.item(*row)), max_size=MAX_BEAMS)
    return st.tuples(values, items).map(lambda both: frame_type(*both[0], tuple(both[1])))


frames = st.one_of(*map(frames_of, LAYOUTS))


def frame_or_reason(content: bytes) -> Frame | str:
    try:
        return decode(content)
    except FrameError as error:
        return error.reason


SAMPLE = Sample(7, 1000, -5, 6, 16384, 1, (Range(120, 0), Range(0, 1)))
DRIVE = Drive(7, 100, -100, 300)


def test_the_table_names_the_fields_of_its_frames_in_their_order():
    for frame_type, layout in LAYOUTS.items():
        names = [field.name for field in layout.fields] + ([layout.group.name] if layout.group else [])
        assert names == [field.name for field in dataclasses.fields(frame_type)]
        if layout.group:
            assert tuple(field.name for field in layout.group.fields) == layout.group.item._fields


def test_every_kind_has_its_own_number_and_somebody_who_says_it():
    kinds = [layout.kind for layout in LAYOUTS.values()]
    assert len(set(kinds)) == len(kinds)
    assert {*FROM_MCU, *TO_MCU} == set(LAYOUTS)


@given(frames)
def test_decode_after_encode_is_identity(frame):
    content = encode(frame)
    assert decode(content) == frame
    assert len(content) <= MAX_CONTENT


def test_the_bytes_of_a_drive():
    assert encode(DRIVE).hex(" ") == "03 01 07 00 64 00 9c ff 2c 01"


def test_the_bytes_of_a_sample():
    assert encode(SAMPLE).hex(" ") == ("02 01 07 00 e8 03 00 00 fb ff ff ff 06 00 00 00 00 40 01 02 78 00 00 00 00 01")


def test_an_orions_sample_takes_39_bytes_on_the_line():
    sample = dataclasses.replace(SAMPLE, ranges=(Range(500, 0),) * 5)
    assert len(wrap(encode(sample))) == 39


def test_the_longest_sample_fits_into_one_cobs_block():
    sample = dataclasses.replace(SAMPLE, ranges=(Range(500, 0),) * MAX_BEAMS)
    assert len(encode(sample)) + 2 <= 254


@given(frames, st.data())
def test_a_content_of_another_length_is_refused(frame, data):
    content = encode(frame)
    cut = data.draw(st.integers(0, len(content) - 1))
    for wrong in (content[:cut], content + b"\0"):
        assert frame_or_reason(wrong) == "length"


@given(st.binary(max_size=MAX_CONTENT + 10))
def test_any_content_is_a_frame_or_refused_for_a_named_reason(content):
    frame = frame_or_reason(content)
    assert frame in REASONS if isinstance(frame, str) else encode(frame) == content


@given(frames, st.data())
def test_a_changed_content_is_another_frame_or_refused(frame, data):
    content = bytearray(encode(frame))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    changed = frame_or_reason(bytes(content))
    assert changed != frame
    assert changed in REASONS if isinstance(changed, str) else encode(changed) == content


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "length"),
        (b"\x03", "length"),
        (bytes([3, VERSION + 1]) + bytes(8), "version"),
        (bytes([9, VERSION]) + bytes(8), "kind"),
        (encode(SAMPLE)[:19] + bytes([MAX_BEAMS + 1]) + bytes(3 * (MAX_BEAMS + 1)), "count"),
        (encode(SAMPLE)[:-1] + b"\x03", "value"),  # a status that there is not
        (encode(SAMPLE)[:18] + b"\x02" + encode(SAMPLE)[19:], "value"),  # a heading more valid than valid
    ],
)
def test_each_reason_has_its_name(content, reason):
    assert frame_or_reason(content) == reason


@pytest.mark.parametrize("frame_type", LAYOUTS)
def test_a_value_outside_its_limits_is_our_mistake(frame_type):
    layout = LAYOUTS[frame_type]
    good = [limits(field)[0] for field in layout.fields]
    group = [()] if layout.group else []
    for at, field in enumerate(layout.fields):
        least, largest = limits(field)
        for wrong in (least - 1, largest + 1):
            values = [*good[:at], wrong, *good[at + 1 :], *group]
            with pytest.raises(ValueError, match=rf"{layout.name}\.{field.name}: expected {least} to {largest}"):
                encode(frame_type(*values))


def test_a_status_outside_its_limits_is_our_mistake():
    with pytest.raises(ValueError, match=r"ranges\.status: expected 0 to 2, got 3"):
        encode(dataclasses.replace(SAMPLE, ranges=(Range(1, 3),)))


def test_more_beams_than_there_may_be_are_our_mistake():
    with pytest.raises(ValueError, match="ranges: expected at most 32, got 33"):
        encode(dataclasses.replace(SAMPLE, ranges=(Range(1, 0),) * 33))


def test_a_number_that_is_not_whole_is_our_mistake():
    with pytest.raises(TypeError):
        encode(Drive(0, 1.5, 0, 0))


def test_random_bytes_are_next_to_never_a_frame():
    noise = random.Random(1).randbytes(1_000_000)
    results = [frame_or_reason(noise[start : start + 10]) for start in range(0, len(noise), 10)]
    assert (
        sum(not isinstance(result, str) for result in results) <= 5
    )  # without a checksum: a drive of any bytes, if its kind and version happen to be right
