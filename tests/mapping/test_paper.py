"""The paper's own examples: figure 3, algorithm 2, Table I with equations 1 to 4, and equation 8."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.evidence import EvidenceModel, probability
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import Pose, QuantisedPose
from mapping.rays import Rays, rays_of
from mapping.scan import quantise
from mapping.sensor import ORION_OFFSET, TABLE_I, orion
from mapping.tiles import added

MODEL = EvidenceModel()
few = settings(max_examples=30, deadline=None)  # the law is slow, and numba may have to compile


def moved(x, y, theta):
    """Eq. 4 (and 8): the paper's matrix."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


# Figure 3: a world of 6 x 6 cells m_1 ... m_36, row by row from the north-west


def m(index):
    """Cell m_index of the figure as (i, j)."""
    row, column = divmod(index - 1, 6)
    return column, 5 - row


STEPS = [
    (36, [10, 19]),  # t = 1: RIGHT sees the moving obstacle at m_10
    (35, [4, 19]),  # t = 2: it is gone, RIGHT sees the wall at m_4
    (34, [4, 13, 31]),  # t = 3
]


def readings(robot, cells):
    """Readings as cells: the drawn directions are not those of one rigid robot."""
    return Rays(
        np.array([m(robot)] * len(cells), np.int64),
        np.array([m(cell) for cell in cells], np.int64),
        np.ones(len(cells), np.bool_),
    )


@pytest.fixture
def figure_3(drawn):
    """p(m_i) for i = 1 ... 36 at t = 0, 1, 2, 3, each as a dictionary."""
    tiles, frames = {}, []
    for step in (None, *STEPS):
        if step:
            tiles.update(added(tiles, drawn(readings(*step), MODEL)))
        tile = tiles.get((0, 0), np.zeros((32, 32), np.int32))
        frames.append({cell: float(probability(tile[m(cell)[1], m(cell)[0]])) for cell in range(1, 37)})
    return frames


def test_figure_3_begins_with_nothing_known(figure_3):
    assert set(figure_3[0].values()) == {0.5}


def test_the_moving_obstacle_of_figure_3_fades(figure_3):
    before, seen, gone, longer_gone = (frame[10] for frame in figure_3)
    assert before == 0.5
    assert seen > gone > longer_gone
    assert seen == pytest.approx(1 - 1 / (1 + math.exp(0.85)))


def test_the_moving_obstacle_of_figure_3_goes_to_zero_if_it_stays_away(drawn):
    tiles = {}
    for step in (*STEPS, *[STEPS[2]] * 10):
        tiles.update(added(tiles, drawn(readings(*step), MODEL)))
    i, j = m(10)
    assert probability(tiles[0, 0][j, i]) < 0.02


def test_the_wall_of_figure_3_rises_each_time_it_is_seen(figure_3):
    unseen, still_unseen, seen, again = (frame[4] for frame in figure_3)
    assert unseen == still_unseen == 0.5 < seen < again


def test_all_walls_that_figure_3_names_are_occupied(figure_3):
    assert figure_3[1][19] > 0.5
    assert figure_3[2][19] > figure_3[1][19]
    assert min(figure_3[3][cell] for cell in (4, 13, 19, 31)) > 0.5


def test_cells_that_no_ray_of_figure_3_meets_stay_at_one_half(figure_3, law):
    met = set()
    for frame, (robot, cells) in zip(figure_3[1:], STEPS, strict=True):
        met |= {cell for reading in cells for cell in law.ray(m(robot), m(reading))}
        unseen = [cell for cell in range(1, 37) if m(cell) not in met]
        assert unseen
        assert {frame[cell] for cell in unseen} == {0.5}
        assert all(frame[cell] != 0.5 for cell in range(1, 37) if m(cell) in met)


def test_the_first_ray_of_figure_3_has_the_papers_cells_but_one(drawn, law):
    """The paper lists m_29, m_23, m_17 and m_16 between m_36 and m_10: m_17 and m_16 are of one row."""
    known = law.known(drawn(readings(36, [10]), MODEL))
    assert {cell for cell, units in known.items() if units < 0} == {m(cell) for cell in (36, 29, 23, 16)}
    assert {cell for cell, units in known.items() if units > 0} == {m(10)}


# Algorithm 2


def inverse_sensor(cell, robot, reading):
    """Algorithm 2 as it is printed: Manhattan distances in cells, None where it returns nothing."""
    z = abs(robot[0] - reading[0]) + abs(robot[1] - reading[1])
    r = abs(robot[0] - cell[0]) + abs(robot[1] - cell[1])
    if abs(r - z) < 1:
        return MODEL.occupied
    if r < z:
        return MODEL.free
    return None


def test_algorithm_2_along_any_short_ray_is_free_before_the_last_cell_and_occupied_there(law):
    """All rays to 40 cells: each step adds 1 or 2 to the Manhattan distance, so only the last cell has all of it."""
    for i in range(-40, 41):
        for j in range(-40, 41):
            *before, last = law.ray((0, 0), (i, j))
            assert inverse_sensor(last, (0, 0), (i, j)) == MODEL.occupied
            assert all(inverse_sensor(cell, (0, 0), (i, j)) == MODEL.free for cell in before)


cells = st.tuples(st.integers(-2000, 2000), st.integers(-2000, 2000))


@given(cells, cells)
@few
def test_algorithm_2_on_the_cells_of_a_ray_is_our_evidence(drawn, law, robot, reading):
    ours = law.known(drawn(Rays(np.array([robot]), np.array([reading]), np.array([True])), MODEL))
    assert ours == {cell: inverse_sensor(cell, robot, reading) for cell in law.ray(robot, reading)}


def test_algorithm_2_off_the_ray_would_call_cells_occupied_that_nobody_saw():
    """Why the field of view is the ray: the cells at one Manhattan distance are a whole diamond."""
    assert inverse_sensor((3, 1), (0, 0), (4, 0)) == MODEL.occupied
    assert inverse_sensor((0, -4), (0, 0), (4, 0)) == MODEL.occupied
    assert inverse_sensor((5, 0), (0, 0), (4, 0)) is None


# Table I and equations 1 to 4, in the paper's frame: y forward


def points_by_the_paper(x, y, theta, rho):
    """Equations 1 to 4, literally."""
    T_W_R = moved(x, y, theta)
    T_R_S = np.array([[1, 0, 0], [0, 1, ORION_OFFSET], [0, 0, 1]])
    points_S = np.array([[r * math.cos(phi), r * math.sin(phi), 1] for r, phi in zip(rho, TABLE_I, strict=True)])
    return (T_W_R @ T_R_S @ points_S.T).T[:, :2]


metres = st.floats(-5, 5)
ranges = st.lists(st.floats(0.002, 0.799), min_size=5, max_size=5)


@given(metres, metres, st.floats(-7, 7), ranges)
def test_the_papers_points_are_ours(x, y, theta, rho):
    """Its robot axis is y, ours is x: a heading theta of the paper is our yaw less a quarter turn."""
    sensor, lattice = orion(), Lattice(1)
    scans = quantise([0.0], [[x, y, theta + math.pi / 2]], [rho], sensor)
    centres = (rays_of(scans, sensor, lattice).end + 0.5) / 1000
    # Pose and range are rounded by 0.5 mm, two angles and the cosines by 0.15 mm, the cell by 0.5 mm.
    assert np.abs(centres - points_by_the_paper(x, y, theta, rho)).max() < 0.002


def test_a_robot_at_theta_0_faces_up_and_its_right_sensor_looks_along_x():
    right, right_diagonal, front, left_diagonal, left = points_by_the_paper(0, 0, 0, [0.5] * 5)
    assert right == pytest.approx([0.5, ORION_OFFSET])
    assert front == pytest.approx([0, 0.5 + ORION_OFFSET])
    assert left == pytest.approx([-0.5, ORION_OFFSET])
    assert right_diagonal == pytest.approx([0.5 / math.sqrt(2), 0.5 / math.sqrt(2) + ORION_OFFSET])
    assert left_diagonal == pytest.approx([-0.5 / math.sqrt(2), 0.5 / math.sqrt(2) + ORION_OFFSET])


def test_a_scan_of_a_robot_at_theta_0_fills_the_cells_of_its_five_readings(kernel, law):
    sensor = orion()
    scans = quantise([0.0], [[0, 0, math.pi / 2]], [[0.5] * 5], sensor)
    known = law.known(integrated({}, scans, sensor, MODEL, Lattice(50), kernel))
    occupied = {cell for cell, units in known.items() if units > 0}
    points = points_by_the_paper(0, 0, 0, [0.5] * 5)
    assert occupied == {(math.floor(x / 0.05 + 1e-9), math.floor(y / 0.05 + 1e-9)) for x, y in points}


# Equation 8: two robots in one frame

THETA = 14 * math.pi / 9
T_C_R2 = moved(2150, 1450, THETA)  # millimetres
START_1 = Pose(0, 0, math.radians(90))
START_2 = Pose(2.150, 1.450, math.radians(10))


@given(metres, metres)
def test_equation_8_takes_points_of_robot_2_where_our_start_pose_does(forward, left):
    """R2's frame in the paper has y forward and x to the right."""
    by_the_paper = T_C_R2 @ [-left * 1000, forward * 1000, 1]
    ours = START_2.apply(np.array([forward, left]))
    assert ours * 1000 == pytest.approx(by_the_paper[:2], abs=1e-6)


@given(metres, metres)
def test_the_common_frame_is_robot_1s(forward, left):
    by_the_paper = moved(0, 0, 0) @ [-left, forward, 1]
    assert START_1.apply(np.array([forward, left])) == pytest.approx(by_the_paper[:2], abs=1e-12)


@given(metres, metres, st.floats(-7, 7))
def test_a_pose_of_robot_2_is_one_chain_of_ours(x, y, theta):
    """Trajectories too: odometry in the paper's R2 frame, taken to C by eq. 8."""
    by_the_paper = T_C_R2 @ moved(x * 1000, y * 1000, theta)
    # The paper's R2 frame as ours: turned by a quarter, since its robot axis is y.
    T_R2_robot = Pose(y, -x, theta)
    chain = START_2 @ T_R2_robot
    assert (chain.x * 1000, chain.y * 1000) == pytest.approx(tuple(by_the_paper[:2, 2]), abs=1e-6)
    front_by_the_paper = by_the_paper[:2, :2] @ [0, 1]
    assert (math.cos(chain.yaw), math.sin(chain.yaw)) == pytest.approx(tuple(front_by_the_paper), abs=1e-9)


def test_the_start_poses_are_published_without_loss_of_a_millimetre():
    assert QuantisedPose.of(START_1) == (0, 0, 16384)
    assert QuantisedPose.of(START_2) == (2150, 1450, 1820)
    assert math.degrees(QuantisedPose.of(START_2).pose().yaw) == pytest.approx(math.degrees(THETA) - 270, abs=0.003)
