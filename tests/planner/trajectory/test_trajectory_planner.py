"""Tests of the trajectory planner: closed forms, parameters, single samples, refusals.

Golden vectors are in test_golden.py.
"""

import numpy as np
import pytest

from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.sampling_planner import Velocity, heading_of, start_record
from applr_ros1.planner.search.arcs import arc_from, pose_after
from applr_ros1.planner.trajectory import forward, scoring
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from applr_ros1.planner.trajectory.records import STATE
from tests.support.robots import JACKAL_FOOTPRINT, JACKAL_PARAMETERS
from tests.support.scenes import open_map

PARAMS = complete(JACKAL_PARAMETERS)["TrajectoryPlannerROS"]
PLAN = ((0.0, 0.0), (3.0, 0.0))  # 3 m straight ahead
ORIGIN = (0.0, 0.0, 0.0)
STANDING = (0.0, 0.0, 0.0)  # vx, vy, w
DRIVING = (0.3, 0.0, 0.0)
NO_MEMORY = [0] * len(STATE.names)


def make_planner(plan=PLAN, meter_scoring=True, **changes):
    """Return the Jackal's planner with a plan and some changed parameters."""
    parameters = dict(PARAMS, **changes)
    planner = TrajectoryPlanner(JACKAL_FOOTPRINT, parameters, meter_scoring=meter_scoring)
    planner.set_plan(np.array(plan, dtype=np.float64))
    return planner


def test_closed_forms_end_at_the_pose_of_the_steps():
    rng = np.random.default_rng(0)
    parameters = make_planner(acc_lim_x=2.0, acc_lim_theta=5.0).in_force
    for _ in range(300):
        pose = rng.uniform(-3, 3, 3)
        velocity = rng.uniform(-1, 1, 3)
        start = start_record([*pose, *velocity])
        vx = rng.uniform(-0.5, 2)
        # The closed form divides by w: straight on, hardly a curve, and a curve
        w = rng.choice([0.0, 1e-9, rng.uniform(-3.14, 3.14)])
        sample = Velocity(vx, 0.0, w)
        steps = scoring.step_count(parameters, sample)
        dt = parameters["sim_time"] / steps
        heading = heading_of(start["theta"])

        # The robot accelerates for some steps, and then moves on an arc, which has a closed form.
        end_of_steps = scoring.last_point(parameters, start, sample)
        ramp_end = forward.ramp(parameters, start, heading, sample, dt, steps - 1)
        arc = arc_from(ramp_end.x, ramp_end.y, ramp_end.heading, sample, dt)
        end_on_arc = pose_after(arc, steps - 1 - ramp_end.moves)

        assert np.allclose(end_on_arc[:2], end_of_steps[:2], rtol=0, atol=1e-11)


def test_meter_scoring_multiplies_two_weights_in_every_reconfigure():
    resolution = 0.1
    costmap = open_map(resolution=resolution)
    planner = make_planner()
    planner.find_best_path(costmap, ORIGIN, STANDING)
    # A reconfigure sets the server's values again, which are per metre.
    for _ in range(2):
        assert planner.in_force["path_scale"] == 0.75 * resolution
        assert planner.in_force["goal_scale"] == 1.0 * resolution
        assert planner.in_force["occdist_scale"] == 0.1
        planner.reconfigure(PARAMS)

    unscaled = make_planner(meter_scoring=False)
    unscaled.find_best_path(costmap, ORIGIN, STANDING)
    assert unscaled.in_force["path_scale"] == 0.75


@pytest.mark.parametrize("heading_scoring", [False, True])
def test_the_cell_under_the_centre_counts_beside_the_outline(heading_scoring):
    pose = (0.02, 0.02, 0.0)
    costmap = open_map()
    planner = make_planner(heading_scoring=heading_scoring)
    free_result = planner.find_best_path(costmap, pose, DRIVING)

    costmap.cells[100, 100] = 100  # the cell at 0 to 0.05 m along both axes
    planner = make_planner(heading_scoring=heading_scoring)
    costly_result = planner.find_best_path(costmap, pose, DRIVING)

    assert costly_result.cost == pytest.approx(free_result.cost + 100 * PARAMS["occdist_scale"])


def test_heading_scoring_samples_by_time_whatever_the_speed():
    for vx in (0.0, 0.1, 2.0):
        planner = make_planner(heading_scoring=True, sim_time=1.5, sim_granularity=0.04)
        assert scoring.step_count(planner.in_force, Velocity(vx, 0.0, 1.0)) == 38
    # By distance, a turn on the spot needs as many steps as its granularity asks.
    planner = make_planner(sim_time=1.5, sim_granularity=0.04)
    assert scoring.step_count(planner.in_force, Velocity(2.0, 0.0, 0.0)) == 75


def test_a_map_of_another_size_is_adopted():
    planner = make_planner()
    first_result = planner.find_best_path(open_map(), ORIGIN, DRIVING)
    planner.find_best_path(open_map(80, 120, 0.1), ORIGIN, DRIVING)
    # Only the grids are at stake, not what the planner remembers of its own commands.
    planner.state = NO_MEMORY
    result_again = planner.find_best_path(open_map(), ORIGIN, DRIVING)
    assert result_again.cost == first_result.cost
    assert result_again.vx == first_result.vx
    assert result_again.w == first_result.w


def test_earlier_results_keep_their_points():
    planner = make_planner()
    first_result = planner.find_best_path(open_map(), ORIGIN, DRIVING)
    points_before = first_result.points.copy()
    planner.reconfigure(dict(PARAMS, sim_time=1.0))
    planner.find_best_path(open_map(), (1, 1, 1), (0.1, 0, 0))
    assert np.array_equal(first_result.points, points_before)


def test_cost_cloud_leaves_out_robot_walls_and_unreached_cells():
    costmap = open_map(nx=40, ny=30, resolution=0.1, origin=(-1.0, -1.0))
    costmap.cells[:, 30] = LETHAL  # a wall, behind which no cell is reached
    costmap.cells[5, 5] = 77
    planner = make_planner([(0, 0), (1, 0)])
    assert planner.cost_cloud(costmap).shape == (0, 7)

    planner.find_best_path(costmap, ORIGIN, STANDING)
    cloud = planner.cost_cloud(costmap)
    path, goal, within = planner.grids()

    assert cloud.dtype == np.float32
    # The 30 columns before the wall, less the cells within the robot
    assert len(cloud) == 30 * 30 - int(within.sum())
    # Columns: x, y, z [m], costs of path, goal and cell, total cost. The centre of cell (5, 5) is
    # at -1 + 5.5 * 0.1 m along both axes.
    is_costly_cell = np.abs(cloud[:, :2] + 0.45).max(axis=1) < 1e-4
    (row,) = cloud[is_costly_cell]
    # The weights 0.75 and 1 of path and goal are per metre, and a cell has 0.1 m.
    total = 0.075 * path[5, 5] + 0.1 * goal[5, 5] + 0.1 * 77
    assert row[3:] == pytest.approx([path[5, 5], goal[5, 5], 77, total])


def test_refusals_count_the_rejected_samples_by_reason():
    # Given: samples of 0.1 and 0.5 m/s, each four times straight ahead for 2 s
    planner = make_planner(vx_samples=2, vtheta_samples=3, max_vel_theta=0.0, min_vel_theta=0.0)
    costmap = open_map()

    def refusals():
        planner.find_best_path(costmap, ORIGIN, STANDING)
        return planner.refusals(costmap)

    assert refusals() == {"samples": 8, "obstacle": 0, "path or goal": 0}

    # When: a wall of 1 m is 0.3 m ahead of the robot
    costmap.cells[90:110, 112] = LETHAL
    # Then: the faster samples hit it
    assert refusals() == {"samples": 8, "obstacle": 4, "path or goal": 0}

    # When: the wall crosses the map
    costmap.cells[:, 112] = LETHAL
    # Then: no sample has a way to the goal
    assert refusals() == {"samples": 8, "obstacle": 0, "path or goal": 8}


def test_an_escape_can_be_ended():
    planner = make_planner()
    planner.state = [int(name == "escaping") for name in STATE.names]
    planner.end_escape()
    assert planner.state == NO_MEMORY
