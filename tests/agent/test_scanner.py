"""Readings into scans: by status, within the range that is trusted, of whatever sensors the robot says it has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.readings import Readings
from agent.scanner import in_metres, points_seen, sensor_of
from mapping.pose import QuantisedPose
from mapping.scan import INVALID, NO_RETURN
from mapping.sensor import Beam, Sensor, orion
from transport import mcu_frames
from transport.mcu_frames import RANGE_INVALID, RANGE_NOTHING, RANGE_VALID, Hello, Range

readings = st.builds(Range, st.integers(0, 65535), st.sampled_from([RANGE_VALID, RANGE_NOTHING, RANGE_INVALID]))


def hello(beams, max_range_mm=1200):
    return Hello(1, 10_000, 100_000, 100, max_range_mm, 3, 0, tuple(mcu_frames.Beam(*beam) for beam in beams))


def test_the_sensor_is_what_the_robot_says_up_to_the_range_that_is_trusted():
    assert sensor_of(hello(orion().beams)) == orion(0.8)
    assert sensor_of(hello(orion().beams, 600)) == orion(0.6)
    assert sensor_of(hello(orion().beams), 2.0) == orion(1.2)


def test_a_deck_of_32_wide_beams_is_only_another_hello():
    beams = tuple(Beam(20, 0, (k * 256 - 4096) % 65536, 128) for k in range(32))
    assert sensor_of(hello(beams, 4000), 4.0) == Sensor(beams, 4000)


def test_a_robot_without_beams_is_none():
    with pytest.raises(ValueError, match="0 beams"):
        sensor_of(hello(()))


@given(st.lists(readings, min_size=5, max_size=5))
def test_each_reading_is_published_by_its_status(ranges):
    readings = Readings(np.zeros(1, np.int64), np.zeros((1, 3)), in_metres(ranges)[None, :])
    published = readings.scans(QuantisedPose(0, 0, 0), orion()).ranges[0].tolist()
    for (range_mm, status), reading in zip(ranges, published, strict=True):
        if status == RANGE_INVALID or (status == RANGE_VALID and range_mm == 0):
            assert reading == INVALID
        elif status == RANGE_NOTHING or range_mm > 800:
            assert reading == NO_RETURN
        else:
            assert reading == range_mm


def test_points_are_where_the_readings_fall_and_nothing_else():
    points = points_seen(np.array([0.2, np.nan, 0.5, np.inf, 0.9]), orion())
    np.testing.assert_allclose(points, [[0.03, -0.2], [0.53, 0.0]], atol=1e-9)
    assert points_seen(np.full(5, np.inf), orion()).shape == (0, 2)
