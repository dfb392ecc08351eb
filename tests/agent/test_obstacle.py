"""Where a moving obstacle is, for how far it has gone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.obstacle import Obstacle

CORNER = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])


@pytest.mark.parametrize(
    ("gone", "x", "y"), [(0, 0, 0), (1, 1, 0), (5, 3, 2), (7, 3, 4), (8, 3, 3), (13, 1, 0), (14, 0, 0), (15, 1, 0)]
)
def test_it_goes_back_and_forth(gone: float, x: float, y: float) -> None:
    np.testing.assert_allclose(Obstacle("disc", 0.1, 1.0, CORNER).at(gone), [x, y], atol=1e-12)


@pytest.mark.parametrize(("gone", "x", "y"), [(7, 3, 4), (9.5, 1.5, 2), (12, 0, 0), (13, 1, 0), (25, 1, 0)])
def test_or_round_and_round(gone: float, x: float, y: float) -> None:
    np.testing.assert_allclose(Obstacle("box", 0.1, 1.0, CORNER, loop=True).at(gone), [x, y], atol=1e-12)


@pytest.mark.parametrize("loop", [False, True])
def test_with_one_waypoint_it_stands_there(loop: bool) -> None:
    np.testing.assert_array_equal(Obstacle("disc", 0.1, 1.0, CORNER[1:2], loop).at(3.3), [3, 0])


@given(gone=st.floats(0, 100), step=st.floats(0, 0.1), loop=st.booleans())
def test_it_never_jumps(gone: float, step: float, loop: bool) -> None:
    it = Obstacle("disc", 0.1, 1.0, CORNER, loop)
    assert np.hypot(*(it.at(gone + step) - it.at(gone))) <= step + 1e-9
