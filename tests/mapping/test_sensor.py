import math
import re

import numpy as np
import pytest

from mapping.sensor import ORION_OFFSET, TABLE_I, Beam, Sensor, laser, orion, sensor


def test_table_1_becomes_bearings_from_forward():
    """Right, right diagonal, front, left diagonal, left: a quarter turn less than the paper's, eq. 2's offset ahead."""
    assert list(TABLE_I) == [k * math.pi / 4 for k in range(5)]
    offset = round(ORION_OFFSET * 1000)
    assert orion().beams == tuple(Beam(offset, 0, turn16) for turn16 in (49152, 57344, 0, 8192, 16384))
    assert orion().max_range_mm == 800


def test_an_orion_s_field_of_view_is_an_option():
    thin, wide = orion(), orion(view=math.radians(25))
    assert {beam.half_width_turn16 for beam in thin.beams} == {0}
    assert [beam._replace(half_width_turn16=0) for beam in wide.beams] == list(thin.beams)
    assert {beam.half_width_turn16 for beam in wide.beams} == {2276}


def test_a_laser_looks_from_the_centre_step_by_step():
    scanner = laser(3, first=-math.pi / 2, step=math.pi / 2, max_range=20)
    assert scanner == Sensor((Beam(0, 0, 49152), Beam(0, 0, 0), Beam(0, 0, 16384)), 20_000)


def test_a_sensor_in_si_units_is_rounded_to_whole_numbers():
    assert sensor([(0.0214, -0.0216, -0.1)], 1.2345).beams == (Beam(21, -22, 65536 - 1043),)
    assert sensor([(0, 0, 0)], 1.2346).max_range_mm == 1235


def test_the_table_has_a_row_for_each_beam():
    table = Sensor((Beam(1, 2, 3), Beam(-4, 5, 6)), 10).table
    assert table.dtype == np.int64
    assert table.tolist() == [[1, 2, 3, 0], [-4, 5, 6, 0]]


@pytest.mark.parametrize(
    ("beams", "max_range_mm", "message"),
    [
        ((), 800, "sensor: 0 beams, expected 1 to 4096"),
        ((Beam(0, 0, 0),) * 4097, 800, "sensor: 4097 beams, expected 1 to 4096"),
        ((Beam(0, 0, 0),), 0, "sensor: max_range 0.0 m, expected 0.001 to 65.0 m"),
        ((Beam(0, 0, 0),), 65_001, "sensor: max_range 65.001 m, expected 0.001 to 65.0 m"),
        ((Beam(0, 0, 0), Beam(32_768, 0, 0)), 800, "a beam starts at (32768, 0) mm, expected within 32.767 m"),
        ((Beam(0, -32_768, 0),), 800, "a beam starts at (0, -32768) mm, expected within 32.767 m"),
        ((Beam(0, 0, 65_536),), 800, "sensor: a beam's bearing is 65536, expected 0 to 65535"),
        ((Beam(0, 0, -1),), 800, "sensor: a beam's bearing is -1, expected 0 to 65535"),
        ((Beam(0, 0, 0, -1),), 800, "sensor: half_width -1/65536 turn, expected 0 to 16384"),
        ((Beam(0, 0, 0, 16_385),), 800, "sensor: half_width 16385/65536 turn, expected 0 to 16384"),
        (
            (*(Beam(0, 0, 0, 16_384),) * 4, Beam(0, 0, 0, 1)),
            800,
            "sensor: half_widths of 65537/65536 turn in all, expected at most 65536 (two turns of view)",
        ),
    ],
)
def test_a_sensor_that_cannot_be_published_is_refused(beams, max_range_mm, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Sensor(beams, max_range_mm)


def test_the_extremes_are_sensors():
    Sensor((Beam(32_767, -32_767, 65_535),) * 4096, 65_000)
    Sensor((Beam(0, 0, 0),), 1)
    Sensor((Beam(0, 0, 0, 16_384),) * 4, 800)
