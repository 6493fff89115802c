"""Tests of path and goal grids.

The grids are flooded only as far as needed. A cell's value must not depend on the cells that were
read before.
"""

import numpy as np

from applr_ros1.planner import distance_grid
from applr_ros1.planner.trajectory.records import TrajectoryScene, allocate_grids
from applr_ros1.planner.trajectory.sampling import prepare
from tests.support.seeds import seeds

NX = 23
NY = 17
RESOLUTION = 0.1
FOOTPRINT = np.array(
    [
        [-0.2, -0.1],
        [-0.2, 0.1],
        [0.2, 0.1],
        [0.2, -0.1],
    ]
)
WALL = NX * NY  # value of an obstacle; larger ones are unreached
POSE = (1.2, 0.8, 0.3)


def prepared(cells, plan):
    """Return grids whose floods have begun."""
    grids = allocate_grids(NX, NY)
    prepare(grids, scene(cells, plan), *POSE)
    return grids


def scene(cells, plan):
    """Return the scene of a search with a plan (n, 2)."""
    return TrajectoryScene(
        cells=cells,
        ox=0.0,
        oy=0.0,
        resolution=RESOLUTION,
        footprint=FOOTPRINT,
        lines=np.zeros((1, 1, 1), np.int32),
        plan=np.array(plan, dtype=np.float64).reshape(-1, 2),
    )


def completed(grids):
    """Return the values (2, ny, nx) of both grids after a complete flood."""
    return np.array([distance_grid.complete(grids.path), distance_grid.complete(grids.goal)])


def random_world(seed):
    """Return random cells of all kinds, and a plan that begins or ends on or off the map."""
    rng = np.random.default_rng(seed)
    # From 253 on, a cell is a wall for the flood: a third of them, which cut off some others.
    cells = rng.choice(
        np.array([0, 100, 252, 253, 254, 255], np.uint8),
        (NY, NX),
        p=[0.5, 0.1, 0.05, 0.15, 0.15, 0.05],
    )
    point_count = rng.integers(1, 6)
    # The map is 2.3 m by 1.7 m.
    plan = rng.uniform((-0.3, -0.3), (2.6, 2.0), (point_count, 2))
    return cells, plan


@seeds(20)
def test_settled_cells_are_final_and_all_others_exceed_the_limit(seed):
    cells, plan = random_world(seed)
    final_values, _ = completed(prepared(cells, plan))
    # One grid is flooded step by step, for cells and limits in any order.
    grid = prepared(cells, plan).path
    rng = np.random.default_rng(seed)
    for _ in range(60):
        x = int(rng.integers(NX))
        y = int(rng.integers(NY))
        limit = int(rng.integers(12))
        cell = distance_grid.place(grid, x, y)
        value = distance_grid.settle(grid, cell, limit)
        final_value = final_values[y, x]
        has_cells_left = grid.ends[0] < grid.ends[1]
        if value < WALL:
            assert value == final_value
        elif value == WALL:
            assert final_value >= WALL
        elif has_cells_left:
            # The flood stopped at the limit before it came here.
            assert final_value > limit
        else:
            # The flood is over: nothing leads here.
            assert final_value == WALL + 1


def test_grids_can_be_used_again():
    first_world = random_world(1)
    second_world = random_world(2)
    grids = prepared(*first_world)
    completed(grids)
    # The memory still has all values of the first world.
    prepare(grids, scene(*second_world), *POSE)
    values = completed(grids)
    expected = completed(prepared(*second_world))
    assert np.array_equal(values, expected)
