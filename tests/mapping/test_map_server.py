import math
from fractions import Fraction

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from mapping.evidence import probability
from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_server import (
    FREE_PROBABILITY,
    MapDescription,
    decode_description,
    decode_map_server,
    encode_map_server,
    free,
)
from mapping.portable_graymap import decode_pgm, encode_pgm

OCCUPIED, FREE, UNKNOWN = 100, 0, -1


@st.composite
def grids(draw):
    rows, columns = draw(st.integers(1, 30)), draw(st.integers(1, 30))
    values = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    evidence = values.integers(-200, 200, (rows, columns), dtype=np.int32)
    evidence[values.random((rows, columns)) < 0.3] = 0
    corner = st.integers(-100_000, 100_000)
    return Grid(evidence, draw(corner), draw(corner), Lattice(draw(st.integers(1, 10_000))))


def occupancy(pixel, maximum, table):
    """nav2's documented rule for one pixel, in exact arithmetic: an int8 of an OccupancyGrid."""
    mode = table.get("mode", "trinary")
    shade = Fraction(pixel, maximum)
    if mode == "raw":
        value = int(shade * 255 + Fraction(1, 2))
        return value if value <= 100 else UNKNOWN
    p = shade if table["negate"] else 1 - shade
    high, low = (Fraction(str(table[key])) for key in ("occupied_thresh", "free_thresh"))
    if p > high:
        return OCCUPIED
    if p < low:
        return FREE
    return UNKNOWN if mode == "trinary" else round((p - low) / (high - low) * 100)


def read_as_nav2(picture, text):
    """The occupancy grid, row 0 south, and the YAML's table."""
    table = yaml.safe_load(text)
    pixels, maximum = decode_pgm(picture)
    values = np.array([occupancy(pixel, maximum, table) for pixel in range(maximum + 1)])
    return values[pixels[::-1]], table


def log_odds(percent):
    """In units of 0.01 nat; nothing is surer than 99 %."""
    share = min(max(percent, 1), 99) / 100
    return round(100 * math.log(share / (1 - share)))


@given(grids())
def test_nav2_reads_what_we_called_free_occupied_and_unknown(grid):
    values, table = read_as_nav2(*encode_map_server(grid, "map.pgm"))
    p = probability(grid.evidence)
    expected = np.where(p > 0.65, OCCUPIED, np.where(p < 0.196, FREE, UNKNOWN))
    assert np.array_equal(values, expected)
    assert (values[grid.evidence == 0] == UNKNOWN).all()
    assert table["image"] == "map.pgm"
    assert table["resolution"] == grid.lattice.cell
    assert table["origin"] == [*grid.origin, 0]
    assert (table["mode"], table["negate"]) == ("trinary", 0)
    assert (table["occupied_thresh"], table["free_thresh"]) == (0.65, 0.196)


@given(grids())
def test_our_own_reader_agrees_and_writing_again_changes_nothing(grid):
    picture, text = encode_map_server(grid, "map.pgm")
    back = decode_map_server(decode_description(text), picture)
    assert (back.i0, back.j0, back.lattice) == (grid.i0, grid.j0, grid.lattice)
    values, _ = read_as_nav2(picture, text)
    assert np.array_equal(back.evidence, np.select([values == OCCUPIED, values == FREE], [460, -460], 0))
    assert encode_map_server(back, "map.pgm") == (picture, text)


@given(
    mode=st.sampled_from(["trinary", "scale", "raw"]),
    negate=st.booleans(),
    thresholds=st.tuples(st.integers(0, 100), st.integers(0, 100)).filter(lambda pair: pair[0] < pair[1]),
    maximum=st.integers(1, 255),
)
def test_every_pixel_of_every_mode_is_read_as_nav2_does(mode, negate, thresholds, maximum):
    low, high = (percent / 100 for percent in thresholds)
    table = {"mode": mode, "negate": negate, "free_thresh": low, "occupied_thresh": high}
    pixels = np.arange(maximum + 1, dtype=np.uint8)[None]
    picture = encode_pgm(pixels).replace(b"\n255\n", b"\n%d\n" % maximum, 1)
    description = MapDescription("a.pgm", 0.05, (0.0, 0.0, 0.0), negate, high, low, mode)
    evidence = decode_map_server(description, picture).evidence[0].tolist()
    for pixel, found in enumerate(evidence):
        share = Fraction(pixel if negate else maximum - pixel, maximum)
        on_the_edge = min(abs(share - Fraction(t, 100)) for t in thresholds) < 1e-12
        if on_the_edge and mode != "raw":
            continue  # floating point decides there, in nav2 too
        percent = occupancy(pixel, maximum, table)
        # A half is rounded as the machine's arithmetic falls.
        candidates = [percent - 1, percent, percent + 1] if mode == "scale" else [percent]
        assert found in [0 if percent == UNKNOWN else log_odds(c) for c in candidates]


def test_unknown_is_not_free_at_the_written_threshold():
    """nav2's own saver writes 0.25, which turns its unknown pixel, 205, into free when it is loaded again."""
    unknown = (255 - 205) / 255
    assert FREE_PROBABILITY <= unknown < 0.25


def test_free_is_a_threshold_on_the_integer():
    assert free(np.array([-142, -141, 0, 85], np.int32)).tolist() == [True, False, False, False]


def test_north_is_the_top_row():
    grid = Grid(np.array([[85], [0], [-400]], np.int32), 0, 0, Lattice(50))
    assert decode_pgm(encode_map_server(grid, "a")[0])[0].ravel().tolist() == [254, 205, 0]


def test_an_empty_map_is_one_unknown_cell():
    grid = Grid(np.zeros((0, 0), np.int32), 0, 0, Lattice(50))
    picture, text = encode_map_server(grid, "a.pgm")
    back = decode_map_server(decode_description(text), picture)
    assert back.evidence.tolist() == [[0]]
    assert back.digest() == grid.digest()


@given(st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1))
def test_any_image_name_survives_the_yaml(name):
    text = encode_map_server(Grid(np.zeros((1, 1), np.int32), 0, 0, Lattice(50)), name)[1]
    assert decode_description(text).image == name
    assert yaml.safe_load(text)["image"] == name


GOOD = {
    "image": "a.pgm",
    "resolution": "0.05",
    "origin": "[-1.0, 2, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def description(**changes):
    return "\n".join(f"{key}: {value}" for key, value in {**GOOD, **changes}.items() if value is not None).encode()


def test_a_description_without_a_mode_is_trinary():
    expected = MapDescription("a.pgm", 0.05, (-1.0, 2.0, 0.0), False, 0.65, 0.196, "trinary")
    assert decode_description(description()) == expected
    assert decode_description(description(negate="true", mode="raw", more="[x]")).negate


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        *(({key: None}, key) for key in GOOD),
        ({"image": "[a, b]"}, "image: expected a file name"),
        ({"image": '""'}, "image: expected a file name"),
        ({"resolution": "fine"}, "resolution: expected a finite number, got 'fine'"),
        ({"resolution": "[1]"}, "resolution: expected a finite number"),
        ({"origin": "[0, 0]"}, r"origin: expected \[x, y, yaw\]"),
        ({"origin": "[0, .inf, 0]"}, "origin: expected a finite number"),
        ({"origin": "[0, 0, 0.5]"}, r"origin: its yaw is 0.5, expected 0"),
        ({"free_thresh": "0.7"}, "expected 0 <= free < occupied <= 1"),
        ({"occupied_thresh": "1.1"}, "expected 0 <= free < occupied <= 1"),
        ({"negate": "maybe"}, "negate: expected 0 or 1, got 'maybe'"),
        ({"mode": "colour"}, "mode: expected trinary, scale, raw, got 'colour'"),
        ({"mode": "[raw]"}, "mode: expected"),
        ({"image": "'"}, "not a YAML file"),
    ],
)
def test_a_bad_description_is_refused_by_key(changes, message):
    with pytest.raises(ValueError, match=message):
        decode_description(description(**changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": "0.0254"}, "whole number of millimetres"),
        ({"resolution": "1e300"}, "resolution: "),
        ({"resolution": "-1"}, "resolution: "),
        ({"origin": "[0.03, 0, 0]"}, r"not a corner of a cell of 0.05 m; the nearest is \(0.05, 0.0\)"),
        ({"origin": "[1e300, 0, 0]"}, "origin: "),
    ],
)
def test_a_map_off_the_lattice_is_refused_and_never_shifted(changes, message):
    with pytest.raises(ValueError, match=message):
        decode_map_server(decode_description(description(**changes)), encode_pgm(np.zeros((2, 2), np.uint8)))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[" * 5000,
        b'"\\UFFFFFFFF"',
        b"\xff\xfe\x00",
        b"a: &a [*a]",
        b"? [a]\n: b",
        b"!!int ''",
        b"- image",
        b"a: 1\n" * 100_000,
        b"%YAML 99999999999999999999.1\n---\na",
    ],
)
def test_hostile_yaml_is_a_value_error(data):
    with pytest.raises(ValueError, match=r"YAML|image"):
        decode_description(data)


@given(st.one_of(st.binary(max_size=80), st.text(max_size=80).map(lambda text: text.encode("utf-8", "replace"))))
def test_garbage_is_a_value_error(data):
    with pytest.raises(ValueError, match=r"YAML|image"):
        decode_description(data)


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["cave", "depot", "single", "tb3_sandbox", "test04"])
def test_public_maps_are_read_as_nav2_does(recordings_dir, name):
    folder = recordings_dir / "maps"
    text = (folder / f"{name}.yaml").read_bytes()
    found = decode_description(text)
    picture = (folder / found.image).read_bytes()
    grid = decode_map_server(found, picture)
    values, table = read_as_nav2(picture, text)
    assert grid.evidence.shape == values.shape
    assert np.array_equal(np.sign(grid.evidence), np.select([values == OCCUPIED, values == FREE], [1, -1], 0))
    assert grid.origin == pytest.approx(tuple(table["origin"][:2]))


def saved_by_nav2(values, mode):
    """A picture of an occupancy grid (row 0 south, -1 unknown) as nav2's map saver writes it, with its YAML's table."""
    if mode == "raw":
        pixels = np.where(values < 0, 255, values)
    else:
        pixels = np.select([values < 0, values <= 25, values >= 65], [205, 254, 0], 205)
    return pixels.astype(np.uint8)[::-1]


@given(
    values=st.lists(st.sampled_from([-1, -1, 0, 3, 19, 70, 90, 100]), min_size=1, max_size=40),
    mode=st.sampled_from(["raw", "trinary"]),
    negate=st.booleans(),
)
def test_what_nav2_saves_keeps_its_meaning_through_our_hands(values, mode, negate):
    """Unknown stays unknown, free free, occupied occupied: read, written, and read by nav2's rules again."""
    values = np.array([values])
    pixels = saved_by_nav2(values, mode)
    if negate and mode != "raw":
        # nav2's unknown pixel is 205 either way round; where bright is occupied its mirror image means unknown.
        pixels = 255 - pixels
    description = MapDescription("a.pgm", 0.05, (0.0, 0.0, 0.0), negate, 0.65, 0.196, mode)
    grid = decode_map_server(description, encode_pgm(pixels))
    again, _ = read_as_nav2(*encode_map_server(grid, "b.pgm"))
    expected = np.select([values < 0, values <= 25, values >= 65], [UNKNOWN, FREE, OCCUPIED])
    assert np.array_equal(again, expected)


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["cave", "depot", "single", "tb3_sandbox", "test04"])
def test_public_maps_survive_a_round_trip(recordings_dir, name):
    """nav2 reads the same from what we write as from the original, cell for cell; writing again changes no byte."""
    folder = recordings_dir / "maps"
    text = (folder / f"{name}.yaml").read_bytes()
    found = decode_description(text)
    picture = (folder / found.image).read_bytes()
    grid = decode_map_server(found, picture)
    written = encode_map_server(grid, "again.pgm")
    before, table = read_as_nav2(picture, text)
    after, again = read_as_nav2(*written)
    assert np.array_equal(after, before)
    assert again["origin"][:2] == pytest.approx(table["origin"][:2])
    assert again["resolution"] == table["resolution"]
    assert encode_map_server(decode_map_server(decode_description(written[1]), written[0]), "again.pgm") == written
