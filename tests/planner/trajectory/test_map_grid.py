"""Path and goal grids: their values do not depend on how far the floods have gone when they are read."""

import numpy as np

from applr_ros1.planner import distance_grid
from applr_ros1.planner.trajectory.sampling import allocate_grids, prepare
from tests.support.seeds import seeds

NX, NY, RESOLUTION = 23, 17, 0.1
FOOT = np.array([[-0.2, -0.1], [-0.2, 0.1], [0.2, 0.1], [0.2, -0.1]])
N = NX * NY


def prepared(cells, plan, pose=(1.2, 0.8, 0.3)):
    grids = allocate_grids(NX, NY)
    plan = np.array(plan, dtype=np.float64).reshape(-1, 2)
    goal = prepare(grids, cells, 0.0, 0.0, RESOLUTION, FOOT, *pose, plan)
    return grids, goal


def completed(grids):
    path, goal = np.zeros((NY, NX), np.int32), np.zeros((NY, NX), np.int32)
    distance_grid.complete(grids.path, grids.path_queue, grids.path_ends, NX, NY, path)
    distance_grid.complete(grids.goal, grids.goal_queue, grids.goal_ends, NX, NY, goal)
    return path, goal


def random_world(seed):
    random = np.random.default_rng(seed)
    cells = random.choice(
        np.array([0, 100, 252, 253, 254, 255], np.uint8), (NY, NX), p=[0.5, 0.1, 0.05, 0.15, 0.15, 0.05]
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
        x, y, limit = int(random.integers(NX)), int(random.integers(NY)), int(random.integers(12))
        k = (y + 1) * (NX + 2) + x + 1
        value = distance_grid.settle(grids.path, grids.path_queue, grids.path_ends, NX + 2, N + 1, k, limit)
        if value < N:
            assert value == whole[y, x]
        elif value == N:
            assert whole[y, x] >= N
        elif grids.path_ends[0] < grids.path_ends[1]:
            assert whole[y, x] > limit
        else:
            assert whole[y, x] == N + 1


def test_grids_can_be_used_again():
    first, second = random_world(1), random_world(2)
    grids, _ = prepared(*first)
    completed(grids)
    plan = np.array(second[1])
    prepare(grids, second[0], 0.0, 0.0, RESOLUTION, FOOT, 1.2, 0.8, 0.3, plan)
    assert all(np.array_equal(a, b) for a, b in zip(completed(grids), completed(prepared(*second)[0])))
