import io
import math
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping import map_archive
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_archive import decode_npz, encode_npz


@st.composite
def grids(draw):
    rows, columns = draw(st.integers(0, 40)), draw(st.integers(0, 40))
    values = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    evidence = values.integers(-(2**31), 2**31, (rows, columns), dtype=np.int32)
    evidence[values.random((rows, columns)) < 0.3] = 0
    corner = st.integers(-1_000_000, 1_000_000)
    return Grid(evidence, draw(corner), draw(corner), Lattice(draw(st.integers(1, 10_000))))


SAMPLE = Grid(np.array([[85, -40, 0], [0, -80, 170]], np.int32), -3, 7, Lattice(50))


def archive(**changes):
    """A sound archive of SAMPLE with some entries changed, or left out where they are None."""
    entries = {
        "evidence": SAMPLE.evidence,
        "origin": np.array(SAMPLE.origin),
        "cell": np.array(0.05),
        "digest": np.array(SAMPLE.digest().hex()),
        **changes,
    }
    buffer = io.BytesIO()
    np.savez(buffer, **{name: value for name, value in entries.items() if value is not None})
    return buffer.getvalue()


@given(grids())
def test_decode_after_encode_is_identity(grid):
    back = decode_npz(encode_npz(grid))
    assert np.array_equal(back.evidence, grid.evidence)
    assert back.evidence.dtype == np.int32
    assert not back.evidence.flags.writeable
    assert (back.i0, back.j0, back.lattice) == (grid.i0, grid.j0, grid.lattice)
    assert back.digest() == grid.digest()


def test_the_entries_are_the_documented_ones():
    with np.load(io.BytesIO(encode_npz(SAMPLE)), allow_pickle=False) as entries:
        assert set(entries.files) == {"evidence", "origin", "cell", "digest"}
        assert entries["evidence"].dtype == np.int32
        assert entries["evidence"].tolist() == [[85, -40, 0], [0, -80, 170]]
        assert entries["origin"].tolist() == [-0.15, 0.35]
        assert float(entries["cell"]) == 0.05
        assert str(entries["digest"]) == SAMPLE.digest().hex()


def test_the_same_map_gives_the_same_bytes_at_any_time(monkeypatch):
    first = encode_npz(SAMPLE)
    monkeypatch.setattr("time.localtime", lambda *_: (2033, 1, 2, 3, 4, 5, 0, 2, 0))
    monkeypatch.setattr("time.time", lambda: 1_990_000_000.0)
    assert encode_npz(SAMPLE) == first
    with zipfile.ZipFile(io.BytesIO(first)) as entries:
        assert {entry.date_time for entry in entries.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_any_byte_order_and_memory_order_is_read():
    big_endian = np.asfortranarray(SAMPLE.evidence.astype(">i4"))
    assert decode_npz(archive(evidence=big_endian)).digest() == SAMPLE.digest()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"evidence": None}, r"evidence: missing"),
        ({"evidence": SAMPLE.evidence.astype(np.int64)}, r"evidence: expected int32 \(rows, columns\), got int64"),
        ({"evidence": SAMPLE.evidence.ravel()}, r"evidence: expected int32 \(rows, columns\), got int32 \(6,\)"),
        ({"evidence": SAMPLE.evidence + np.int32(1)}, r"digest: .* damaged"),
        ({"origin": np.array([0.0, 0.0, 0.0])}, r"origin: expected float64 \(2,\)"),
        ({"origin": np.array([0.02, 0.0])}, r"origin: .* not a corner of a cell .* nearest is \(0\.0, 0\.0\)"),
        ({"origin": np.array([math.nan, 0.0])}, r"origin: "),
        ({"origin": np.array([0.0, -math.inf])}, r"origin: "),
        ({"origin": np.array([0.0, 2.0**28])}, r"origin: .* too far away"),
        ({"origin": np.array([0.0, 0.0])}, r"digest: .* damaged"),
        ({"cell": np.array(0.0505)}, r"cell: .* whole number of millimetres"),
        ({"cell": np.array(math.nan)}, r"cell: nan m, expected"),
        ({"cell": np.array(1e308)}, r"cell: .* expected"),
        ({"cell": np.array(-0.05)}, r"cell: .* expected"),
        ({"cell": np.array("0.05")}, r"cell: expected float64 \(\), got <U4"),
        ({"digest": np.array("0" * 32)}, r"digest: .* damaged"),
        ({"digest": None}, r"digest: missing"),
        ({"digest": np.array([object()])}, r"not a readable npz archive"),
    ],
)
def test_a_wrong_entry_is_refused_by_name(changes, message):
    with pytest.raises(ValueError, match=message):
        decode_npz(archive(**changes))


def test_an_archive_that_unpacks_to_too_much_is_refused(monkeypatch):
    monkeypatch.setattr(map_archive, "MAX_INFLATED", 1000)
    with pytest.raises(ValueError, match="it unpacks to"):
        decode_npz(encode_npz(Grid(np.zeros((100, 100), np.int32), 0, 0, Lattice(50))))


@given(st.binary(max_size=300))
def test_garbage_is_a_value_error(data):
    with pytest.raises(ValueError, match="npz"):
        decode_npz(data)


@given(st.data())
def test_a_damaged_archive_is_a_value_error_or_the_same_map(data):
    """A flipped byte may hit what says nothing (a time stamp), but never changes the map unnoticed."""
    whole = bytearray(data.draw(st.sampled_from([archive(), encode_npz(SAMPLE)])))
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.one_of(st.just(len(whole)), st.integers(0, len(whole))))
    try:
        back = decode_npz(bytes(whole[:end]))
    except ValueError:
        return
    assert back.digest() == SAMPLE.digest()
