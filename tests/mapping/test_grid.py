import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.grid import Grid
from mapping.lattice import TILE, Lattice, TileKey
from mapping.tiles import map_digest

lattices = st.integers(1, 500).map(Lattice)
cells = st.dictionaries(
    st.tuples(st.integers(-100, 100), st.integers(-100, 100)),
    st.integers(-(2**31), 2**31 - 1).filter(bool),
    max_size=30,
)


def tiles_of(known):
    """Tiles from a dictionary (i, j) -> evidence, by the definition of the lattice."""
    tiles = {}
    for (i, j), value in known.items():
        tile = tiles.setdefault(TileKey(j // TILE, i // TILE), np.zeros((TILE, TILE), np.int32))
        tile[j % TILE, i % TILE] = value
    return tiles


@given(cells, lattices)
def test_tiles_come_back_from_a_grid(known, lattice):
    tiles = tiles_of(known)
    back = Grid.of(tiles, lattice).tiles()
    assert back.keys() == tiles.keys()
    for key, tile in tiles.items():
        assert np.array_equal(back[key], tile)
        assert not back[key].flags.writeable


@given(cells, lattices)
def test_a_grid_is_the_smallest_rectangle_and_every_cell_is_in_its_place(known, lattice):
    grid = Grid.of(tiles_of(known), lattice)
    rows, columns = grid.evidence.shape
    found = {
        (grid.i0 + column, grid.j0 + row): int(grid.evidence[row, column])
        for row, column in np.argwhere(grid.evidence).tolist()
    }
    assert found == known
    if known:
        across, up = [i for i, _ in known], [j for _, j in known]
        assert (grid.i0, grid.j0) == (min(across), min(up))
        assert (columns, rows) == (max(across) - min(across) + 1, max(up) - min(up) + 1)
    else:
        assert (rows, columns, grid.i0, grid.j0) == (0, 0, 0, 0)


@given(cells, lattices)
def test_a_grid_has_the_digest_of_its_tiles(known, lattice):
    tiles = tiles_of(known)
    assert Grid.of(tiles, lattice).digest() == map_digest(tiles)


@given(cells, lattices, st.integers(0, 40), st.integers(0, 40))
def test_an_unknown_border_changes_no_digest(known, lattice, below, above):
    grid = Grid.of(tiles_of(known), lattice)
    wide = np.pad(grid.evidence, ((below, above), (above, below)))
    assert Grid(wide, grid.i0 - above, grid.j0 - below, lattice).digest() == grid.digest()


def test_positions_are_in_metres():
    grid = Grid.of(tiles_of({(-3, 5): 85, (-1, 6): -40}), Lattice(50))
    assert grid.origin == (-0.15, 0.25)
    assert grid.known_m2 == pytest.approx(2 * 0.05**2)
    assert grid.centres(grid.evidence > 0).tolist() == [pytest.approx([-0.125, 0.275])]
