import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mapping.grid import Grid
from mapping.lattice import Lattice
from mapping.map_picture import OKABE_ITO, Trail, brightness, grey_png, robot_colour, trails_png


def grid_of(evidence, cell_mm=50):
    return Grid(np.array(evidence, np.int32).reshape(len(evidence), -1), -2, 3, Lattice(cell_mm))


def pixels_of(png):
    with Image.open(io.BytesIO(png)) as picture:
        return np.asarray(picture)


def test_white_is_free_black_is_occupied_grey_is_unknown_and_north_is_up():
    shades = brightness(grid_of([[10_000, 0], [-10_000, 85]]))
    assert shades.tolist() == [[255, 76], [0, 128]]


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 700), st.integers(1, 700), st.integers(0, 2**32 - 1))
def test_every_cell_is_a_square_of_pixels(rows, columns, seed):
    grid = grid_of(np.random.default_rng(seed).integers(-500, 500, (rows, columns)))
    pixels = pixels_of(grey_png(grid))
    side = pixels.shape[0] // rows
    assert pixels.shape == (rows * side, columns * side)
    assert np.array_equal(pixels, brightness(grid).repeat(side, axis=0).repeat(side, axis=1))
    assert min(pixels.shape) >= 600 or max(pixels.shape) > 1200
    assert max(pixels.shape) <= 2400


def test_an_empty_map_is_a_grey_picture():
    empty = Grid(np.zeros((0, 0), np.int32), 0, 0, Lattice(50))
    assert (pixels_of(grey_png(empty)) == 128).all()
    assert pixels_of(trails_png(empty, [])).shape[2] == 3


def test_a_trail_is_drawn_where_the_robot_was():
    """A cell of 5 cm is 6 pixels here, the margin 24; the map's lower-left corner is (-0.1, 0.15)."""
    grid = grid_of(np.full((100, 120), -500))
    path = np.array([[1.0, 1.0], [1.0, 4.0], [5.0, 4.0]])
    pixels = pixels_of(trails_png(grid, [Trail("r1", robot_colour(0), path)]))

    def at(x, y):
        return tuple(pixels[24 + round(600 - (y - 0.15) * 120), 24 + round((x + 0.1) * 120)].tolist())

    assert at(1.0, 2.5) == at(3.0, 4.0) == OKABE_ITO[0]
    assert at(5.0, 4.0) == OKABE_ITO[0]  # the square
    assert at(1.0, 1.0) == (255, 255, 255)  # the ring
    assert at(3.0, 2.0) == tuple([int(brightness(grid)[0, 0])] * 3)


@pytest.mark.parametrize("name", ["r1", "", "two\nlines", "\ud800", "机器人", "x" * 500])
@pytest.mark.parametrize("points", [0, 1, 2])
def test_any_name_and_any_length_of_trail_can_be_drawn(name, points):
    trail = Trail(name, robot_colour(1), np.full((points, 2), 0.2))
    assert trails_png(grid_of([[85, -40]]), [trail]).startswith(b"\x89PNG")


def test_the_legend_of_a_large_swarm_ends():
    grid = grid_of(np.full((60, 60), -500))

    def height(robots):
        return pixels_of(trails_png(grid, [Trail(f"r{k}", robot_colour(k), np.zeros((0, 2))) for k in range(robots)]))

    assert height(300).shape[0] <= height(30).shape[0] < height(1).shape[0] + 300


def test_the_same_map_gives_the_same_bytes():
    grid = grid_of(np.arange(-50, 50).reshape(10, 10) * 10)
    trails = [Trail("r1", robot_colour(0), np.array([[0.0, 0.2], [0.3, 0.5]]))]
    assert grey_png(grid) == grey_png(grid)
    assert trails_png(grid, trails) == trails_png(grid, trails)


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.zeros(4), np.array([[0.0, np.nan]])])
def test_a_trail_that_is_no_path_is_refused(points):
    with pytest.raises(ValueError, match="trail of r1: expected finite points"):
        Trail("r1", (0, 0, 0), points)


def test_seven_robots_have_seven_colours():
    assert len({robot_colour(k) for k in range(7)}) == 7
    assert robot_colour(7) == robot_colour(0)
