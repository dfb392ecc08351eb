import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from mapping.portable_graymap import decode_pgm, encode_pgm

pictures = arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=12))


@given(pictures)
def test_decode_after_encode_is_identity(pixels):
    back, maximum = decode_pgm(encode_pgm(pixels))
    assert maximum == 255
    assert np.array_equal(back, pixels)


@given(pictures)
def test_pillow_reads_what_we_write(pixels):
    with Image.open(io.BytesIO(encode_pgm(pixels))) as picture:
        assert np.array_equal(np.asarray(picture), pixels)


gaps = st.lists(st.sampled_from([b" ", b"\n", b"\t", b"\r\n", b"# 12 13 P5\n", b"#\n"]), min_size=1, max_size=4).map(
    lambda parts: b" " + b"".join(parts)
)


@given(pictures, st.integers(1, 255), gaps, gaps, gaps)
def test_comments_and_any_maximum_are_read(pixels, maximum, gap1, gap2, gap3):
    pixels = np.minimum(pixels, maximum)
    height, width = pixels.shape
    head = gap1 + b"%d" % width + gap2 + b"%d" % height + gap3 + b"%d\n" % maximum
    text = b" # a comment\n".join(b" ".join(b"%03d" % value for value in row) for row in pixels.tolist())
    for data in (b"P5" + head + pixels.tobytes(), b"P2" + head + text, b"P2" + head + text + b"\n# end"):
        back, found = decode_pgm(data)
        assert found == maximum
        assert np.array_equal(back, pixels)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a PGM picture"),
        (b"P6\n1 1\n255\n\0\0\0", "not a PGM picture"),
        (b"P5\n1\n", "not a PGM picture"),
        (b"P5 2 2 65535\n" + bytes(8), "maximum is 65535"),
        (b"P5 2 2 0\n" + bytes(4), "maximum is 0"),
        (b"P5 0 2 255\n", "0 x 2 pixels"),
        (b"P5 2 2 255\nabc", r"expected 4 pixels from byte 11, got 3: truncated"),
        (b"P5 999999999 999999999 255\nabc", "truncated"),
        (b"P5 2 1 100\n\x64\x65", "pixel 101 in row 0, column 1 exceeds the maximum 100"),
        (b"P2 2 2 255\n1 2 3", "got 3: truncated"),
        (b"P2 2 2 255\n1 2 x 4", "b'x' after pixel number 2"),
        (b"P2 2 2 255\n1 -2 3 4", "b'-' after"),
        (b"P2 2 2 255\n1 2 3 256", "pixel number 3 is 256"),
        (b"P2 1 1 255\n" + b"9" * 5000, "pixel number 0 is 999999999999"),
        (b"P2 2 1 15\n1 16", "pixel 16 in row 0, column 1 exceeds the maximum 15"),
    ],
)
def test_a_bad_picture_is_refused_with_what_and_where(data, message):
    with pytest.raises(ValueError, match=message):
        decode_pgm(data)


@given(st.sampled_from([b"", b"P5\n3 2\n255\n", b"P2\n3 2\n255\n", b"P2 "]), st.binary(max_size=60))
def test_garbage_is_a_value_error_or_a_picture(head, garbage):
    try:
        pixels, maximum = decode_pgm(head + garbage)
    except ValueError:
        return
    assert pixels.max() <= maximum
