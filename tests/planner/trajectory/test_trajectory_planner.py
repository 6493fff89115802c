"""Tests of the trajectory planner besides its golden vectors: closed forms, parameters, single
samples.
"""

import math

import numpy as np
import pytest

from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.sampling_planner import Velocity, heading_of, start_record
from applr_ros1.planner.trajectory import forward, scoring
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from tests.planner.replay_golden import sampled_window
from tests.support.robots import JACKAL_FOOTPRINT, JACKAL_PARAMETERS
from tests.support.scenes import open_map

PARAMS = complete(JACKAL_PARAMETERS)["TrajectoryPlannerROS"]


def make_planner(
    plan=((0.0, 0.0), (3.0, 0.0)), foot=JACKAL_FOOTPRINT, period=0.05, meter_scoring=True, **changes
):
    planner = TrajectoryPlanner(foot, dict(PARAMS, **changes), period, meter_scoring)
    planner.set_plan(np.array(plan, dtype=np.float64).reshape(-1, 2))
    return planner


def test_closed_forms_end_at_the_pose_of_the_steps():
    random = np.random.default_rng(0)
    params = make_planner(acc_lim_x=2.0, acc_lim_theta=5.0).in_force
    for _ in range(300):
        start = start_record([*random.uniform(-3, 3, 3), *random.uniform(-1, 1, 3)])
        vx = random.uniform(-0.5, 2)
        sample = Velocity(vx, 0.0, random.choice([0.0, 1e-9, random.uniform(-3.14, 3.14)]))
        steps = scoring.step_count(params, sample)
        dt = 2.0 / steps
        exact = forward.exact_end(params, start, sample, steps)
        ramp = forward.ramp(params, start, heading_of(start["theta"]), sample, dt, steps - 1)
        ours = forward.along_arc(ramp, vx * dt, sample.w * dt, steps - 1 - ramp.moves)
        assert np.allclose(ours, exact, rtol=0, atol=1e-11)


def test_one_sample_is_one_value():
    """C++ divides by zero. This package's planner does not, but chooses the same velocity."""
    planner = make_planner(vx_samples=0, vtheta_samples=-3)
    result = planner.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0.1))
    window = sampled_window(planner)
    assert result.cost >= 0
    assert all(math.isfinite(v) for v in window.values())
    assert window["dvx"] == window["dvtheta"] == 0


def test_meter_scoring_multiplies_two_weights_in_every_reconfigure():
    costmap = open_map(resolution=0.1)
    planner = make_planner()
    planner.find_best_path(costmap, (0, 0, 0), (0, 0, 0))
    for _ in range(2):
        assert (
            planner.in_force["path_distance_bias"],
            planner.in_force["goal_distance_bias"],
        ) == (
            0.75 * 0.1,
            0.1,
        )
        assert planner.in_force["occdist_scale"] == 0.1
        planner.reconfigure(PARAMS)
    unscaled = make_planner(meter_scoring=False)
    unscaled.find_best_path(costmap, (0, 0, 0), (0, 0, 0))
    assert unscaled.in_force["path_distance_bias"] == 0.75


@pytest.mark.parametrize("heading_scoring", [False, True])
def test_the_cell_under_the_centre_counts_beside_the_outline(heading_scoring):
    costmap = open_map()
    free = make_planner(heading_scoring=heading_scoring).find_best_path(
        costmap, (0.02, 0.02, 0.0), (0.3, 0.0, 0.0)
    )
    costmap.cells[100, 100] = 100
    costly = make_planner(heading_scoring=heading_scoring).find_best_path(
        costmap, (0.02, 0.02, 0.0), (0.3, 0.0, 0.0)
    )
    assert costly.cost == pytest.approx(free.cost + 100 * PARAMS["occdist_scale"])


def test_a_map_of_another_size_is_adopted():
    planner = make_planner()
    first = planner.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0))
    planner.find_best_path(open_map(80, 120, 0.1), (0, 0, 0), (0.3, 0, 0))
    planner.state = [0] * 10
    again = planner.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0))
    assert (again.cost, again.vx, again.w) == (first.cost, first.vx, first.w)


def test_earlier_results_keep_their_points():
    planner = make_planner()
    first = planner.find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0))
    wanted = make_planner().find_best_path(open_map(), (0, 0, 0), (0.3, 0, 0)).points
    planner.reconfigure(dict(PARAMS, sim_time=1.0))
    planner.find_best_path(open_map(), (1, 1, 1), (0.1, 0, 0))
    assert np.array_equal(first.points, wanted)


def test_cost_cloud_leaves_out_robot_walls_and_unreached_cells():
    costmap = open_map(40, 30, 0.1, (-1.0, -1.0))
    costmap.cells[:, 30] = 254
    costmap.cells[5, 5] = 77
    planner = make_planner([(0, 0), (1, 0)])
    assert planner.cost_cloud(costmap).shape == (0, 7)
    planner.find_best_path(costmap, (0, 0, 0), (0, 0, 0))
    cloud = planner.cost_cloud(costmap)
    path, goal, within = planner.grids()
    assert cloud.dtype == np.float32
    assert len(cloud) == 30 * 30 - int(within.sum())
    row = cloud[(np.abs(cloud[:, 0] + 0.45) < 1e-4) & (np.abs(cloud[:, 1] + 0.45) < 1e-4)][0]
    assert np.allclose(
        row[3:], [path[5, 5], goal[5, 5], 77, 0.075 * path[5, 5] + 0.1 * goal[5, 5] + 7.7]
    )


@pytest.mark.parametrize(
    ("target", "expected"),
    [((1.025, 0.025), 0.7), ((0.025, 1.025), math.pi / 2 - 0.7), ((0.025, 0.025), 0.7)],
)
def test_the_heading_is_compared_with_the_direction_of_the_farthest_point_in_sight(
    target, expected
):
    """If the robot is on the target, the direction is 0, as for atan2(0, 0) in C++."""
    cells = np.zeros((40, 40), np.uint8)
    plan = np.array([[0.025, 0.025, 0.0], [*target, 0.0]])
    scene = scoring.Scene(
        cells, 0.0, 0.0, 0.05, np.zeros((0, 2)), np.zeros((1, 1, 1), np.int32), plan
    )
    difference = scoring._heading_difference(scene, 0, 0, 0.025, 0.025, 0.7)
    assert difference == pytest.approx(expected)


def test_an_escape_can_be_ended():
    planner = make_planner()
    planner.state = [0] * 4 + [1] + [0] * 5
    planner.end_escape()
    assert planner.state == [0] * 10
