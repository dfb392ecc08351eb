import hashlib
import math
import struct

import numpy as np
import pytest

from mapping import cosine as module
from mapping.cosine import COSINE, TABLE_SHA256, Q, cosine, sine

ALL = np.arange(65536)


def test_the_table_has_the_documented_hash():
    plain = struct.pack("<65536h", *COSINE.tolist())
    assert hashlib.sha256(plain).hexdigest() == TABLE_SHA256


def test_plain_python_builds_the_same_table(law):
    assert tuple(COSINE.tolist()) == law.COSINE


def test_no_entry_lies_near_a_rounding_boundary():
    exact = np.cos(2 * np.pi * ALL / 65536) * 16384
    from_boundary = np.abs(np.abs(exact - np.floor(exact)) - 0.5)
    assert 8.7e-7 < from_boundary.min() < 8.9e-7  # a double's error is below 1e-11


def test_the_axes_are_exact():
    one = 1 << Q
    assert cosine(np.array([0, 16384, 32768, 49152])).tolist() == [one, 0, -one, 0]
    assert sine(np.array([0, 16384, 32768, 49152])).tolist() == [0, one, 0, -one]


def test_the_circle_is_symmetric():
    assert np.array_equal(cosine(-ALL), cosine(ALL))
    assert np.array_equal(sine(-ALL), -sine(ALL))
    assert np.array_equal(cosine(ALL + 32768), -cosine(ALL))
    assert np.array_equal(sine(ALL + 16384), cosine(ALL))
    assert np.array_equal(cosine(16384 - ALL), sine(ALL))


def test_sine_and_cosine_are_of_a_unit_vector():
    """Each is off by half a unit at most, so their squares' sum by sqrt(2) * 16384 and a little."""
    off = cosine(ALL) ** 2 + sine(ALL) ** 2 - (1 << 2 * Q)
    assert np.abs(off).max() <= math.sqrt(2) * 16384 + 1


def test_angles_wrap_whatever_their_size():
    for turns in (-(2**40), -65536, 65536, 2**40):
        assert np.array_equal(cosine(ALL + turns), COSINE)
        assert np.array_equal(sine(ALL + turns), sine(ALL))


def test_nobody_can_write_the_table():
    with pytest.raises(ValueError, match="read-only"):
        COSINE[0] = 0


def test_a_machine_with_another_cosine_is_told_so(monkeypatch):
    monkeypatch.setattr(module.np, "cos", np.sin)
    with pytest.raises(RuntimeError, match=f"expected {TABLE_SHA256}"):
        module._build()
