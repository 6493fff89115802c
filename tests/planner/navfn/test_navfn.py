"""Tests that one navfn planner on changing maps plans like a new one. test_golden.py compares plans
with C++.
"""

import copy
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.navfn import window
from applr_ros1.planner.navfn.navfn import LIST_SIZE, Navfn, _target
from tests.support import scenes
from tests.support.robots import JACKAL_FOOTPRINT
from tests.support.seeds import examples

RES = 0.05


def costmap_of(cells, origin=(0.0, 0.0)):
    """Return a costmap with exactly these cells (ny, nx)."""
    ny, nx = cells.shape
    costmap = Costmap(
        (nx + 0.5) * RES, (ny + 0.5) * RES, RES, origin, inflation=InflationParameters(0.0)
    )
    scenes.paint(costmap, cells)
    return costmap


def cellular(rng, ny, nx, fill, steps=3):
    """Return obstacles (ny, nx) bool of a cellular automaton as in BARN. A random share `fill` is
    occupied at first.
    """
    grid = rng.random((ny, nx)) < fill
    for _ in range(steps):
        around = sum(
            np.roll(np.roll(grid, dy, 0), dx, 1).astype(int)
            for dy in (-1, 0, 1)
            for dx in (-1, 0, 1)
            if dx or dy
        )
        grid = np.where(around >= 5, True, np.where(around <= 1, False, grid))
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
    costmap = Costmap(
        (nx + 0.5) * RES,
        (ny + 0.5) * RES,
        RES,
        footprint=JACKAL_FOOTPRINT,
        inflation=InflationParameters(float(rng.choice((0.1, 0.2))), 3.0),
    )
    costmap.inflation.set_inscribed_radius(0.05)
    scenes.paint(costmap, np.where(obstacles, 254, 0).astype(np.uint8))
    cells = costmap.cells.copy()
    cells[rng.random((ny, nx)) < 0.03] = 255
    return cells


def inside(rng, nx, ny, border=0.0):
    """Return a point on the map, with probability `border` in a border cell."""
    point = [rng.uniform(0, n * RES) for n in (nx, ny)]
    if rng.random() < border:
        axis = int(rng.integers(2))
        point[axis] = rng.choice((0.01, (nx, ny)[axis] * RES - 0.01))
    return tuple(point)


def compare(planner, costmap, start, goal, tolerance=0.0, allow_unknown=True, list_size=LIST_SIZE):
    """Return the plan after asserting that plan, potential and costs equal those of a new planner."""
    fresh = Navfn(list_size)
    expected = fresh.plan(copy.deepcopy(costmap), start, goal, tolerance, allow_unknown)
    plan = planner.plan(costmap, start, goal, tolerance, allow_unknown)
    np.testing.assert_array_equal(plan, expected)
    np.testing.assert_array_equal(planner.potential, fresh.potential)
    np.testing.assert_array_equal(planner.costs, fresh.costs)
    return plan


@given(st.integers(0, 2**32 - 1), st.sampled_from((10000, 10000, 25)))
@examples(25)
def test_one_planner_on_a_changing_map(seed, list_size):
    """Map, robot, goal and allow_unknown change between plans. Each plan equals the plan of a new
    planner.
    """
    rng = np.random.default_rng(seed)
    ny, nx = (int(v) for v in rng.integers(20, 45, 2))
    cells = world(rng, ny, nx, rng.choice(("cellular", "arbitrary")))
    costmap = costmap_of(cells)
    planner = Navfn(list_size)
    robot = inside(rng, nx, ny, 0.1)
    goal = inside(rng, nx, ny) + (0.0,)
    allow_unknown = True
    for _ in range(8):
        compare(planner, costmap, robot, goal, 0.0, allow_unknown, list_size)
        if rng.random() < 0.7:  # The map changes around one point, as around a robot.
            x, y = (int(v) for v in rng.integers(0, (nx, ny)))
            block = (slice(max(0, y - 4), y + 5), slice(max(0, x - 4), x + 5))
            cells[block] = world(rng, 9, 9, "arbitrary")[
                : cells[block].shape[0], : cells[block].shape[1]
            ]
            costmap.clear()
            scenes.paint(costmap, cells)
        if rng.random() < 0.5:
            robot = inside(rng, nx, ny, 0.1)
        if rng.random() < 0.2:
            goal = inside(rng, nx, ny) + (0.0,)
        if rng.random() < 0.2:
            allow_unknown = not allow_unknown


@pytest.mark.parametrize("ends", [(0.5, 1.5), (1.5, 0.5)])
@pytest.mark.parametrize("turned", [False, True])
def test_a_gap_that_opens_in_a_wall_is_found_from_each_side(ends, turned):
    wall = np.zeros((40, 40), np.uint8)
    wall[:, 20] = 254
    robot, goal = ((end, 1.0)[:: -1 if turned else 1] for end in ends)
    costmap = costmap_of(wall.T if turned else wall)
    planner = Navfn()
    assert not len(planner.plan(costmap, robot, (*goal, 0.0)))
    wall[20, 20] = 0
    costmap.clear()
    scenes.paint(costmap, wall.T if turned else wall)
    assert len(compare(planner, costmap, robot, (*goal, 0.0))) > 3


def test_a_deep_copy_plans_by_itself():
    costmap = costmap_of(np.zeros((40, 40), np.uint8))
    planner = Navfn()
    way = ((0.5, 1.0), (1.6, 1.0, 0.0))
    before = compare(planner, costmap, *way)
    copied, its_map = copy.deepcopy((planner, costmap))
    wall = np.zeros((40, 40), np.uint8)
    wall[8:, 20] = 254
    scenes.paint(its_map, wall)
    assert len(compare(copied, its_map, *way)) > len(before)
    np.testing.assert_array_equal(compare(planner, costmap, *way), before)


def test_no_plan_if_the_goal_cannot_be_reached():
    cells = np.zeros((40, 40), np.uint8)
    cells[:, 20] = 254
    costmap = costmap_of(cells)
    planner = Navfn()
    assert compare(planner, costmap, (0.5, 1.0), (1.5, 1.0, 0.0)).shape == (0, 3)
    # The goal is in the wall, but a free cell is within the tolerance.
    assert len(compare(planner, costmap, (0.5, 1.0), (1.02, 1.0, 0.0), 0.11)) > 3
    assert planner.plan(costmap, (5.0, 5.0), (1.0, 1.0, 0.0)).shape == (0, 3)
    assert planner.plan(costmap, (0.5, 1.0), (5.0, 5.0, 0.0)).shape == (0, 3)
    assert planner.plan(costmap, (0.5, 1.0), (5.0, 5.0, 0.0), 0.2).shape == (0, 3)


def test_the_robots_cell_becomes_free():
    cells = np.zeros((40, 40), np.uint8)
    cells[20, 10] = 254
    costmap = costmap_of(cells)
    version = costmap.version
    assert len(Navfn().plan(costmap, (0.52, 1.02), (1.5, 1.0, 0.0))) > 0
    assert (costmap.cells[20, 10], costmap.changed_since(version)) == (0, (10, 20, 11, 21))


def test_a_map_too_small_to_have_an_inside():
    for shape in ((1, 1), (2, 5), (5, 2)):
        costmap = costmap_of(np.zeros(shape, np.uint8))
        assert len(Navfn().plan(costmap, (0.02, 0.02), (0.03, 0.03, 0.0))) <= 2


# -- fence of the flood ----------------------------------------------------------------------------
def test_a_fenced_flood_gives_the_plan_of_a_full_flood(monkeypatch):
    """The fence (navfn/window.py) changes neither plans nor the potentials inside it, while cells
    of the map change.
    """
    whole = window.around
    stat = Counter()
    for seed in range(90):
        rng = np.random.default_rng(seed)
        nx, ny = (int(n) for n in rng.integers(150, 400, 2))
        cells = np.zeros((ny, nx), np.uint8)
        w, h = (int(n) for n in rng.integers(10, 80, 2))
        cx, cy = int(rng.integers(0, nx - w)), int(rng.integers(0, ny - h))
        cells[cy : cy + h, cx : cx + w] = world(rng, h, w, ("arbitrary", "cellular")[seed % 2])
        costmap = costmap_of(cells)
        fenced = Navfn()
        full = Navfn()
        at = np.array([cx + w // 2, cy + h // 2]) if seed % 3 else rng.integers(5, (nx - 5, ny - 5))
        goal = (*(rng.uniform(5, (nx - 5, ny - 5)) * RES), 0.3)
        for _ in range(4):
            start = tuple((at + 0.5) * RES)
            monkeypatch.setattr(window, "around", whole)
            plan = fenced.plan(costmap, start, goal)
            monkeypatch.setattr(window, "around", lambda *given: None)
            np.testing.assert_array_equal(plan, full.plan(costmap, start, goal))
            stat["fenced"] += fenced._fence is not None
            if fenced._fence is not None:
                x0, y0, x1, y1 = fenced._fence
                within = np.s_[y0 + 2 : y1 - 1, x0 + 2 : x1 - 1]
                mine = fenced._potential[: nx * ny].reshape(ny, nx)[within]
                np.testing.assert_array_equal(mine, full.potential[within])
            at = np.clip(at + rng.integers(-3, 4, 2), 2, (nx - 3, ny - 3))
            x, y = cx + int(rng.integers(w)), cy + int(rng.integers(h))
            cells[y, x] = rng.choice([0, 100, 254])
            scenes.paint(costmap, cells)
        np.testing.assert_array_equal(fenced.potential, full.potential)
    assert stat["fenced"] > 200


def test_the_first_of_equally_near_points_is_the_target():
    """navfn_ros.cpp:262 searches row by row from the lowest x and y."""
    potential = np.zeros((6, 6), np.float32)
    potential[3, 3] = 1e10
    assert _target(potential.ravel(), 0.0, 0.0, 0.5, 6, 6, 1.75, 1.75, 0.5) == (
        2 * 6 + 3,
        1.75,
        1.25,
    )


@pytest.mark.parametrize(
    ("x", "inside"), [(12.0, True), (11.9, False), (16.0, True), (16.1, False)]
)
def test_a_plan_near_the_fence_is_not_accepted(x, inside):
    path = np.array([[14.0, 14.0], [x, 14.0], [14.0, x]])
    assert window.keeps_inside(path, len(path), 30, 30, (8, 8, 20, 20)) is inside
    assert window.keeps_inside(path, 1, 30, 30, (8, 8, 20, 20))
