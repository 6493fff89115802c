"""Tests of path and goal grids.

The grids are flooded only as far as needed. A cell's value must not depend on the cells that were
read before.
"""

import numpy as np

from applr_ros1.planner import distance_grid
from applr_ros1.planner.trajectory.records import Scene, allocate_grids
from applr_ros1.planner.trajectory.sampling import prepare
from tests.support.seeds import seeds

NX, NY, RESOLUTION = 23, 17, 0.1
FOOT = np.array([[-0.2, -0.1], [-0.2, 0.1], [0.2, 0.1], [0.2, -0.1]])
N = NX * NY


def prepared(cells, plan, pose=(1.2, 0.8, 0.3)):
    grids = allocate_grids(NX, NY)
    return grids, prepare(grids, scene(cells, plan), *pose)


def scene(cells, plan):
    plan = np.array(plan, dtype=np.float64).reshape(-1, 2)
    return Scene(cells, 0.0, 0.0, RESOLUTION, FOOT, np.zeros((1, 1, 1), np.int32), plan)


def completed(grids):
    return distance_grid.complete(grids.path), distance_grid.complete(grids.goal)


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
    whole = completed(prepared(cells, plan)[0])[0]
    grids, _ = prepared(cells, plan)
    random = np.random.default_rng(seed)
    for _ in range(60):
        x = int(random.integers(NX))
        y = int(random.integers(NY))
        limit = int(random.integers(12))
        k = (y + 1) * (NX + 2) + x + 1
        value = distance_grid.settle(grids.path, k, limit)
        if value < N:
            assert value == whole[y, x]
        elif value == N:
            assert whole[y, x] >= N
        elif grids.path.ends[0] < grids.path.ends[1]:
            assert whole[y, x] > limit
        else:
            assert whole[y, x] == N + 1


def test_grids_can_be_used_again():
    first = random_world(1)
    second = random_world(2)
    grids, _ = prepared(*first)
    completed(grids)
    prepare(grids, scene(*second), 1.2, 0.8, 0.3)
    assert all(
        np.array_equal(a, b) for a, b in zip(completed(grids), completed(prepared(*second)[0]))
    )
