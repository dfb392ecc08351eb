"""A map's history: what is known when, in a bounded number of rows."""

from __future__ import annotations

import numpy as np

from agent.page_history import HISTORY_PERIOD, MOST_HISTORY, History
from mapping.lattice import TILE, Lattice, TileKey

LATTICE = Lattice(50)


def tile(known: int) -> np.ndarray:
    """So many cells are known."""
    cells = np.zeros((TILE, TILE), np.int32)
    cells.flat[:known] = 7
    return cells


def test_what_is_known_follows_the_map_and_what_changed_is_told() -> None:
    history, here, there, gone = History(), TileKey(0, 0), TileKey(0, 1), TileKey(5, 5)
    stays = tile(4)
    assert history.take({here: tile(10), there: stays, gone: tile(6)}, LATTICE) == {here, there, gone}
    assert history.known_m2 == 20 * 0.0025
    assert history.take({here: tile(12), there: stays}, LATTICE) == {here, gone}
    assert history.known_m2 == 16 * 0.0025
    assert history.take({}, LATTICE) == {here, there}
    assert history.known_m2 == 0


def test_however_long_it_goes_on_the_rows_are_bounded_and_reach_from_beginning_to_end() -> None:
    history = History()
    for k in range(10 * MOST_HISTORY):
        if history.due(k * HISTORY_PERIOD):
            history.note(k * HISTORY_PERIOD, 1.0)
    times = [row.seconds for row in history.rows]
    assert MOST_HISTORY / 2 <= len(times) <= MOST_HISTORY
    assert times == sorted(set(times))
    assert times[0] == 0
    assert times[-1] > 0.99 * 10 * MOST_HISTORY * HISTORY_PERIOD
    steps = np.diff(times)
    assert (steps == steps[0]).all()
