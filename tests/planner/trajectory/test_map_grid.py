"""Tests of path and goal grids.

The grids are flooded only as far as needed. A cell's value must not depend on the cells that were
read before.
"""

import numpy as np

from applr_ros1.planner import distance_grid
from applr_ros1.planner.trajectory.records import Scene, allocate_grids
from applr_ros1.planner.trajectory.sampling import prepare
from tests.support.seeds import seeds

NX = 23
NY = 17
RESOLUTION = 0.1
FOOTPRINT = np.array([[-0.2, -0.1], [-0.2, 0.1], [0.2, 0.1], [0.2, -0.1]])
WALL = NX * NY  # value of an obstacle; larger ones are unreached
POSE = (1.2, 0.8, 0.3)


def prepared(cells, plan):
    """Return grids whose floods have begun."""
    grids = allocate_grids(NX, NY)
    prepare(grids, scene(cells, plan), *POSE)
    return grids


def scene(cells, plan):
    return Scene(
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
    random = np.random.default_rng(seed)
    cells = random.choice(
        np.array([0, 100, 252, 253, 254, 255], np.uint8),
        (NY, NX),
        p=[0.5, 0.1, 0.05, 0.15, 0.15, 0.05],
    )
    plan = random.uniform((-0.3, -0.3), (2.6, 2.0), (random.integers(1, 6), 2))
    return cells, plan


@seeds(20)
def test_settled_cells_are_final_and_all_others_exceed_the_limit(seed):
    cells, plan = random_world(seed)
    final_values, _ = completed(prepared(cells, plan))
    grid = prepared(cells, plan).path
    random = np.random.default_rng(seed)
    for _ in range(60):
        x = int(random.integers(NX))
        y = int(random.integers(NY))
        limit = int(random.integers(12))
        value = distance_grid.settle(grid, distance_grid.place(grid, x, y), limit)
        final_value = final_values[y, x]
        has_cells_left = grid.ends[0] < grid.ends[1]
        if value < WALL:
            assert value == final_value
        elif value == WALL:
            assert final_value >= WALL
        elif has_cells_left:
            assert final_value > limit
        else:
            assert final_value == WALL + 1


def test_grids_can_be_used_again():
    first_world = random_world(1)
    second_world = random_world(2)
    grids = prepared(*first_world)
    completed(grids)
    prepare(grids, scene(*second_world), *POSE)
    assert np.array_equal(completed(grids), completed(prepared(*second_world)))
