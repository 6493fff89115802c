"""Tests that one navfn planner on changing maps plans like a new one. test_golden.py compares plans
with C++.
"""

import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.navfn import window
from applr_ros1.planner.navfn.navfn import LIST_SIZE, Navfn, target_of
from tests.support import scenes
from tests.support.seeds import examples

RES = 0.05  # edge of a cell [m]
EIGHT_NEIGHBOURS = [[1, 1, 1], [1, 0, 1], [1, 1, 1]]


def costmap_of(cells, origin=(0.0, 0.0)):
    """Return a costmap with exactly these cells (ny, nx)."""
    rows, columns = cells.shape
    # Half a cell more, because the size is divided by the resolution and rounded down.
    costmap = scenes.laser_costmap(
        (columns + 0.5) * RES,
        (rows + 0.5) * RES,
        RES,
        origin,
        inflation=InflationParameters(0.0),
    )
    scenes.paint(costmap, cells)
    return costmap


def cellular(rng, ny, nx, fill, steps=3):
    """Return obstacles (ny, nx) bool of a cellular automaton as in BARN. A random share `fill` is
    occupied at first.
    """
    grid = rng.random((ny, nx)) < fill
    for _ in range(steps):
        neighbours = ndimage.convolve(grid.astype(int), EIGHT_NEIGHBOURS, mode="wrap")
        grid[neighbours >= 5] = True
        grid[neighbours <= 1] = False
    return grid


def world(rng, ny, nx, kind):
    """Return cells (ny, nx) uint8 of a kind: "cellular" obstacles with decaying costs, or
    "arbitrary" bytes.
    """
    if kind == "arbitrary":
        cells = rng.integers(0, 256, (ny, nx)).astype(np.uint8)
        cells[rng.random((ny, nx)) < 0.6] = 0
        return cells
    obstacles = cellular(rng, ny, nx, rng.uniform(0.1, 0.5))
    costmap = scenes.laser_costmap(
        (nx + 0.5) * RES,
        (ny + 0.5) * RES,
        RES,
        inflation=InflationParameters(float(rng.choice((0.1, 0.2))), 3.0),
    )
    costmap.inflation_layers[0].set_inscribed_radius(0.05)
    scenes.paint(costmap, np.where(obstacles, 254, 0).astype(np.uint8))
    cells = costmap.cells.copy()
    cells[rng.random((ny, nx)) < 0.03] = 255
    return cells


def inside(rng, nx, ny, border=0.0):
    """Return a point on the map, with probability `border` in a border cell."""
    sides = (nx * RES, ny * RES)
    point = rng.uniform(0, sides).tolist()
    if rng.random() < border:
        axis = int(rng.integers(2))
        point[axis] = rng.choice((0.01, sides[axis] - 0.01))
    return tuple(point)


def compare(
    planner,
    costmap,
    start,
    goal,
    tolerance=0.0,
    allow_unknown=True,
    list_size=LIST_SIZE,
):
    """Return the plan after asserting that plan, potential and costs equal those of a new
    planner.
    """
    new_planner = Navfn(list_size)
    # A plan frees the robot's cell.
    copied_map = copy.deepcopy(costmap)
    expected_plan = new_planner.plan(copied_map, start, goal, tolerance, allow_unknown)
    plan = planner.plan(costmap, start, goal, tolerance, allow_unknown)
    np.testing.assert_array_equal(plan, expected_plan)
    np.testing.assert_array_equal(planner.potential, new_planner.potential)
    np.testing.assert_array_equal(planner.costs, new_planner.costs)
    return plan


@given(st.integers(0, 2**32 - 1), st.sampled_from((10000, 10000, 25)))
@examples(25)
def test_one_planner_on_a_changing_map(seed, list_size):
    """Map, robot, goal and allow_unknown change between plans. Each plan equals the plan of a new
    planner.
    """
    rng = np.random.default_rng(seed)
    ny, nx = rng.integers(20, 45, 2).tolist()
    kind = rng.choice(("cellular", "arbitrary"))
    cells = world(rng, ny, nx, kind)
    costmap = costmap_of(cells)
    planner = Navfn(list_size)
    robot = inside(rng, nx, ny, 0.1)
    goal = (*inside(rng, nx, ny), 0.0)
    allow_unknown = True
    for _ in range(8):
        compare(
            planner,
            costmap,
            robot,
            goal,
            allow_unknown=allow_unknown,
            list_size=list_size,
        )
        # The map changes around one point, as around a robot.
        if rng.random() < 0.7:
            middle_column, middle_row = rng.integers(0, (nx, ny)).tolist()
            first_row = max(0, middle_row - 4)
            first_column = max(0, middle_column - 4)
            block = cells[first_row : middle_row + 5, first_column : middle_column + 5]
            row_count, column_count = block.shape
            new_cells = world(rng, 9, 9, "arbitrary")
            block[:] = new_cells[:row_count, :column_count]
            costmap.reset_layers()
            scenes.paint(costmap, cells)
        # Each of the other inputs changes sometimes.
        if rng.random() < 0.5:
            robot = inside(rng, nx, ny, 0.1)
        if rng.random() < 0.2:
            goal = (*inside(rng, nx, ny), 0.0)
        if rng.random() < 0.2:
            allow_unknown = not allow_unknown


@pytest.mark.parametrize(
    ("robot", "goal"),
    [
        pytest.param((0.5, 1.0), (1.5, 1.0, 0.0), id="from the left"),
        pytest.param((1.5, 1.0), (0.5, 1.0, 0.0), id="from the right"),
        pytest.param((1.0, 0.5), (1.0, 1.5, 0.0), id="from below"),
        pytest.param((1.0, 1.5), (1.0, 0.5, 0.0), id="from above"),
    ],
)
def test_a_gap_that_opens_in_a_wall_is_found_from_each_side(robot, goal):
    # Given: a wall across the way, beyond which nothing can be reached
    is_along_y = robot[0] == goal[0]
    cells = np.zeros((40, 40), np.uint8)
    wall = cells[20, :] if is_along_y else cells[:, 20]
    wall[:] = 254
    costmap = costmap_of(cells)
    planner = Navfn()
    assert not len(planner.plan(costmap, robot, goal))

    # When: a gap opens
    wall[20] = 0
    costmap.reset_layers()
    scenes.paint(costmap, cells)

    # Then: the plan leads through it
    assert len(compare(planner, costmap, robot, goal)) > 3


def test_a_deep_copy_plans_by_itself():
    # Given: a planner, and a copy of it with a map of its own, on which a wall is painted
    costmap = costmap_of(np.zeros((40, 40), np.uint8))
    planner = Navfn()
    start = (0.5, 1.0)
    goal = (1.6, 1.0, 0.0)
    straight_plan = compare(planner, costmap, start, goal)
    copied_planner, copied_map = copy.deepcopy((planner, costmap))
    wall = np.zeros((40, 40), np.uint8)
    wall[8:, 20] = 254
    scenes.paint(copied_map, wall)

    # Then: only the copy goes round the wall
    plan_round_wall = compare(copied_planner, copied_map, start, goal)
    assert len(plan_round_wall) > len(straight_plan)
    repeated_plan = compare(planner, costmap, start, goal)
    np.testing.assert_array_equal(repeated_plan, straight_plan)


def test_no_plan_if_the_goal_cannot_be_reached():
    cells = np.zeros((40, 40), np.uint8)
    cells[:, 20] = 254
    costmap = costmap_of(cells)
    planner = Navfn()
    start = (0.5, 1.0)
    off_the_map = (5.0, 5.0)
    behind_the_wall = (1.5, 1.0, 0.0)
    assert compare(planner, costmap, start, behind_the_wall).shape == (0, 3)
    # The goal is in the wall, but a free cell is within the tolerance.
    in_the_wall = (1.02, 1.0, 0.0)
    assert len(compare(planner, costmap, start, in_the_wall, tolerance=0.11)) > 3
    assert planner.plan(costmap, off_the_map, (1.0, 1.0, 0.0)).shape == (0, 3)
    assert planner.plan(costmap, start, (*off_the_map, 0.0)).shape == (0, 3)
    assert planner.plan(costmap, start, (*off_the_map, 0.0), 0.2).shape == (0, 3)


def test_the_robots_cell_becomes_free():
    cells = np.zeros((40, 40), np.uint8)
    cells[20, 10] = 254
    costmap = costmap_of(cells)
    version = costmap.version
    assert len(Navfn().plan(costmap, (0.52, 1.02), (1.5, 1.0, 0.0))) > 0
    assert costmap.cells[20, 10] == 0
    assert costmap.changed_since(version) == (10, 20, 11, 21)


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (5, 2)])
def test_a_map_too_small_to_have_an_inside(shape):
    costmap = costmap_of(np.zeros(shape, np.uint8))
    plan = Navfn().plan(costmap, (0.02, 0.02), (0.03, 0.03, 0.0))
    assert len(plan) <= 2


# -- fence of the flood ----------------------------------------------------------------------------
@pytest.mark.heavy
def test_a_fenced_flood_gives_the_plan_of_a_full_flood(monkeypatch):
    """The fence (navfn/window.py) changes neither plans nor the potentials inside it, while cells
    of the map change.
    """
    around = window.around
    fenced_count = 0
    for seed in range(90):
        # Given: a large map with one block of obstacles, and a robot in it or anywhere
        rng = np.random.default_rng(seed)
        nx, ny = rng.integers(150, 400, 2).tolist()
        width, height = rng.integers(10, 80, 2).tolist()
        left = int(rng.integers(0, nx - width))
        bottom = int(rng.integers(0, ny - height))
        cells = np.zeros((ny, nx), np.uint8)
        block = cells[bottom : bottom + height, left : left + width]
        kind = ("arbitrary", "cellular")[seed % 2]
        block[:] = world(rng, height, width, kind)
        costmap = costmap_of(cells)
        robot_cell = np.array([left + width // 2, bottom + height // 2])
        if seed % 3 == 0:
            robot_cell = rng.integers(5, (nx - 5, ny - 5))
        goal_x, goal_y = rng.uniform(5, (nx - 5, ny - 5)) * RES
        goal = (goal_x, goal_y, 0.3)
        fenced = Navfn()
        full = Navfn()
        for _ in range(4):
            # When: one planner plans with a fence and one without
            start = tuple((robot_cell + 0.5) * RES)
            monkeypatch.setattr(window, "around", around)
            plan = fenced.plan(costmap, start, goal)
            monkeypatch.setattr(window, "around", lambda *_: None)
            expected_plan = full.plan(costmap, start, goal)

            # Then: plans are equal, and so are the potentials inside the fence
            np.testing.assert_array_equal(plan, expected_plan)
            if fenced.fence is not None:
                fenced_count += 1
                x0, y0, x1, y1 = fenced.fence
                within = np.s_[y0 + 2 : y1 - 1, x0 + 2 : x1 - 1]
                fenced_potential = fenced.flooded_potential[: nx * ny].reshape(ny, nx)
                np.testing.assert_array_equal(
                    fenced_potential[within],
                    full.potential[within],
                )

            # The robot moves, and a cell of the block changes.
            moved_cell = robot_cell + rng.integers(-3, 4, 2)
            robot_cell = np.clip(moved_cell, 2, (nx - 3, ny - 3))
            column = rng.integers(width)
            row = rng.integers(height)
            block[row, column] = rng.choice([0, 100, 254])
            scenes.paint(costmap, cells)
        np.testing.assert_array_equal(fenced.potential, full.potential)
    assert fenced_count > 200


def test_the_first_of_equally_near_points_is_the_target():
    """navfn_ros.cpp:262 searches row by row from the lowest x and y."""
    potential = np.zeros((6, 6), np.float32)
    potential[3, 3] = 1e10
    target = target_of(potential.ravel(), 0.0, 0.0, 0.5, 6, 6, 1.75, 1.75, 0.5)
    assert target == (2 * 6 + 3, 1.75, 1.25)


@pytest.mark.parametrize(
    ("x", "is_inside"),
    [
        (12.0, True),
        (11.9, False),
        (16.0, True),
        (16.1, False),
    ],
)
def test_a_plan_near_the_fence_is_not_accepted(x, is_inside):
    fence = (8, 8, 20, 20)
    path = np.array(
        [
            [14.0, 14.0],
            [x, 14.0],
            [14.0, x],
        ]
    )
    assert window.keeps_inside(path, len(path), 30, 30, fence) is is_inside
    assert window.keeps_inside(path, 1, 30, 30, fence)
