"""The trajectory planner: its short cuts choose what the plain way chooses; parameters, memory, single samples."""

import math

import numpy as np
import pytest

from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.trajectory import forward, scoring
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from applr_ros1.planner.trajectory.sampling import STATE
from tests.support.jackal import JACKAL
from tests.support.map_scenes import JACKAL as JACKAL_FOOT
from tests.support.map_scenes import open_map
from tests.support.plain_trajectories import Plain
from tests.support.seeds import seeds

FEET = [
    JACKAL_FOOT,
    np.array([[-0.2, -0.2], [0.3, 0.0], [-0.2, 0.2]]),
    np.zeros((0, 2)),
    np.array([[0.1, 0.1]]),
    np.array([[0.0, 0.0], [0.2, 0.1]]),
    np.array([[-2.5, -0.4], [-2.5, 0.4], [2.5, 0.4], [2.5, -0.4]]),
]
PARAMS = complete(JACKAL)["TrajectoryPlannerROS"]


def planner(plan=((0.0, 0.0), (3.0, 0.0)), foot=JACKAL_FOOT, period=0.05, meter_scoring=True, **changes):
    made = TrajectoryPlanner(foot, dict(PARAMS, **changes), period, meter_scoring)
    made.set_plan(np.array(plan, dtype=np.float64).reshape(-1, 2))
    return made


# -- against the plain way ---------------------------------------------------------------------------------------


def random_map(random, foot):
    nx, ny = (int(v) for v in random.integers(12, 130, 2))
    resolution = float(random.choice([0.05, 0.1, 0.03]))
    made = Costmap(
        (nx + 0.5) * resolution,
        (ny + 0.5) * resolution,
        resolution,
        random.uniform(-3, 3, 2).round(3),
        footprint=foot,
        inflation=InflationParameters(float(random.uniform(0, 0.6))),
    )
    cells = np.zeros((ny, nx), np.uint8)
    cells[random.random((ny, nx)) < random.choice([0, 0.002, 0.01, 0.03])] = 254
    if random.random() < 0.3:
        cells[random.random((ny, nx)) < 0.003] = 255
    if random.random() < 0.3:
        cells[int(random.integers(ny))] = 254
    made.paint(cells)
    if random.random() < 0.2:
        made.cells[:] = np.where(random.random((ny, nx)) < 0.5, made.cells, random.integers(0, 256, (ny, nx)))
    return made


def random_pose(random, costmap):
    size = np.array(costmap.size) * costmap.resolution
    pose = np.append(costmap.origin + size * random.uniform(0.1, 0.9, 2), random.uniform(-4, 4))
    case = random.random()
    if case < 0.1:
        pose[:2] = costmap.origin + size * random.uniform(-0.02, 1.02, 2)
    elif case < 0.3:  # on the corner of a cell
        pose[:2] = costmap.origin + costmap.resolution * random.integers(0, costmap.size)
    if random.random() < 0.2:
        pose[2] = random.choice([0.0, math.pi / 2, math.pi])
    return pose


def give_room(random, costmap, pose, foot):
    """Take away what the robot would stand on, so that there is something to choose."""
    radius = max([float(np.hypot(*vertex)) for vertex in foot] + [0.1]) + random.uniform(0.05, 0.3)
    rows, columns = np.mgrid[: costmap.size[1], : costmap.size[0]] + 0.5
    away = np.hypot(
        costmap.origin[0] + columns * costmap.resolution - pose[0],
        costmap.origin[1] + rows * costmap.resolution - pose[1],
    )
    costmap.cells[(away < radius) & (costmap.cells > 100)] = int(random.choice([0, 0, 50, 253]))
    if random.random() < 0.5:
        walls = costmap.cells > 252
        costmap.cells[walls] = np.where(random.random(walls.sum()) < 0.7, 200, 254)


def random_parameters(random):
    def one(*values):
        return float(random.choice(values))

    fastest = float(random.uniform(0.3, 3.14))
    return dict(
        PARAMS,
        vx_samples=int(random.integers(1, 6)),
        vtheta_samples=int(random.integers(1, 12)),
        max_vel_x=one(0.5, 1, 2),
        min_vel_x=one(0, 0.1, 0.3),
        max_vel_theta=fastest,
        min_vel_theta=-fastest,
        occdist_scale=one(0, 0.05, 0.1, 1),
        path_distance_bias=one(0, 0.1, 0.75, 1.5),
        goal_distance_bias=one(0, 0.1, 1, 2),
        acc_lim_x=one(10, 1, 0.1, 0),
        acc_lim_y=one(2.5, 0.1),
        acc_lim_theta=one(20, 3, 0.5),
        sim_time=one(0.5, 1, 2, 4),
        sim_granularity=one(0.02, 0.1),
        angular_sim_granularity=one(0.02, 0.1, 0.7),
        heading_lookahead=one(0.325, 0, 1),
        dwa=bool(random.random() < 0.8),
        simple_attractor=bool(random.random() < 0.1),
        heading_scoring=bool(random.random() < 0.1),
    )


def random_state(random, pose):
    flags = random.integers(0, 2, 5) * (random.random() < 0.3)
    near = np.append(pose[:2] + random.normal(0, 0.05, 2), np.append(pose[:2], pose[2]) + random.normal(0, 0.05, 3))
    return [int(v) for v in flags] + near.tolist()


def random_plan(random, pose):
    steps = random.normal(0.15, 0.4, (int(random.integers(0, 7)), 2))
    start = pose[:2] + (random.random() < 0.8) * random.normal(0, 0.2, 2)
    return np.cumsum(np.vstack([start, steps]), axis=0)


@seeds(400)
def test_chooses_as_the_plain_way(seed):
    """Winner, cost, points and memory, on random maps, poses, velocities, footprints and parameters."""
    random = np.random.default_rng(seed)
    foot = FEET[random.integers(len(FEET))] if random.random() < 0.4 else JACKAL_FOOT
    costmap = random_map(random, foot)
    pose = random_pose(random, costmap)
    if random.random() < 0.8:
        give_room(random, costmap, pose, foot)
    made = TrajectoryPlanner(foot, random_parameters(random), 0.05, bool(random.random() < 0.7))
    plan = random_plan(random, pose)
    velocity = (random.choice([0, 0.3, 0.5, 1.8, -0.4]), random.choice([0, 0, 0.1]), random.uniform(-2, 2))
    made.set_plan(plan)
    before = made.state = random_state(random, pose)
    result = made.find_best_path(costmap, pose, velocity)
    after = made.state

    path, goal, _ = made.grids()
    window = made.window
    if made.effective["vtheta_samples"] == 1:  # C++ divides by zero here
        width = window["max_vel_theta"] - window["min_vel_theta"]
        window["dvtheta"] = -math.inf if width < 0 else math.inf
    plain = Plain(costmap, foot, made.effective, plan.tolist(), path, goal)
    (cost, v, w, points), state = plain.choose(made.start.tolist(), window, dict(zip(STATE.names, before)))
    assert (result.cost, result.vx, result.w, result.count) == (cost, v, w, len(points))
    assert np.array_equal(result.points, np.array(points).reshape(-1, 3))
    assert after == list(state.values())


def test_closed_forms_end_where_the_steps_end():
    random = np.random.default_rng(0)
    params = planner(acc_lim_x=2.0, acc_lim_theta=5.0)._params
    for _ in range(300):
        start = np.append(random.uniform(-3, 3, 3), random.uniform(-1, 1, 3))
        vx, w = random.uniform(-0.5, 2), random.choice([0.0, 1e-9, random.uniform(-3.14, 3.14)])
        steps = scoring.step_count(params[0], vx, 0.0, w)
        dt = 2.0 / steps
        exact = forward.exact_end(params[0], start, vx, w, steps)
        moves, x, y, c, s = forward.ramp(params[0], start, math.cos(start[2]), math.sin(start[2]), vx, w, dt, steps - 1)
        ours = forward.along_arc(x, y, c, s, vx * dt, w * dt, steps - 1 - moves)
        assert np.allclose(ours, exact, rtol=0, atol=1e-11)


# -- behaviour ---------------------------------------------------------------------------------------------------


def test_one_sample_is_one_value():
    """C++ divides by zero; ours does not and chooses the same."""
    made = planner(vx_samples=0, vtheta_samples=-3)
    result = made.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0.1))
    window = made.window
    assert result.cost >= 0
    assert all(math.isfinite(v) for v in window.values())
    assert window["dvx"] == window["dvtheta"] == 0


def test_meter_scoring_multiplies_two_weights_in_every_reconfigure():
    costmap = open_map(resolution=0.1)
    made = planner()
    made.find_best_path(costmap, (0, 0, 0), (0, 0, 0))
    for _ in range(2):
        assert (made.effective["path_distance_bias"], made.effective["goal_distance_bias"]) == (0.75 * 0.1, 0.1)
        assert made.effective["occdist_scale"] == 0.1
        made.reconfigure(PARAMS)
    unscaled = planner(meter_scoring=False)
    unscaled.find_best_path(costmap, (0, 0, 0), (0, 0, 0))
    assert unscaled.effective["path_distance_bias"] == 0.75


@pytest.mark.parametrize("heading_scoring", [False, True])
def test_the_cell_under_the_centre_counts_beside_the_outline(heading_scoring):
    costmap = open_map()
    free = planner(heading_scoring=heading_scoring).find_best_path(costmap, (0.02, 0.02, 0.0), (0.3, 0.0, 0.0))
    costmap.cells[100, 100] = 100
    held = planner(heading_scoring=heading_scoring).find_best_path(costmap, (0.02, 0.02, 0.0), (0.3, 0.0, 0.0))
    assert held.cost == pytest.approx(free.cost + 100 * PARAMS["occdist_scale"])


def test_a_map_of_another_size_is_taken_up():
    made = planner()
    first = made.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0))
    made.find_best_path(open_map(80, 120, 0.1), (0, 0, 0), (0.3, 0, 0))
    made.state = [0] * 10
    again = made.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0))
    assert (again.cost, again.vx, again.w) == (first.cost, first.vx, first.w)


def test_earlier_results_keep_their_points():
    made = planner()
    first = made.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0))
    wanted = planner().find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0)).points
    made.reconfigure(dict(PARAMS, sim_time=1.0))
    made.find_best_path(open_map(), (1, 1, 1), (0.1, 0, 0))
    assert np.array_equal(first.points, wanted)


def test_cost_cloud_leaves_out_robot_walls_and_unreached_cells():
    costmap = open_map(40, 30, 0.1, (-1.0, -1.0))
    costmap.cells[:, 30] = 254
    costmap.cells[5, 5] = 77
    made = planner([(0, 0), (1, 0)])
    assert made.cost_cloud(costmap).shape == (0, 7)
    made.find_best_path(costmap, (0, 0, 0), (0, 0, 0))
    cloud = made.cost_cloud(costmap)
    path, goal, within = made.grids()
    assert cloud.dtype == np.float32
    assert len(cloud) == 30 * 30 - int(within.sum())
    row = cloud[(np.abs(cloud[:, 0] + 0.45) < 1e-4) & (np.abs(cloud[:, 1] + 0.45) < 1e-4)][0]
    assert np.allclose(row[3:], [path[5, 5], goal[5, 5], 77, 0.075 * path[5, 5] + 0.1 * goal[5, 5] + 7.7])


@pytest.mark.parametrize(
    ("target", "expected"), [((1.025, 0.025), 0.7), ((0.025, 1.025), math.pi / 2 - 0.7), ((0.025, 0.025), 0.7)]
)
def test_the_heading_is_compared_with_the_direction_of_the_farthest_point_in_sight(target, expected):
    """On the point itself the direction is 0, as C++'s atan2(0, 0) says."""
    cells, plan = np.zeros((40, 40), np.uint8), np.array([[0.025, 0.025, 0.0], [*target, 0.0]])
    found = scoring._heading_difference(cells, 0.0, 0.0, 0.05, plan, 0, 0, 0.025, 0.025, 0.7)
    assert found == pytest.approx(expected)
