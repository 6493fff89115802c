"""Tests of the contract in planner/local_planner.py for every local planner."""

import copy
import itertools
import math

import numpy as np
import pytest

from applr_ros1.planner import factory
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from tests.support.robots import JACKAL_PARAMETERS
from tests.support.scenes import laser_costmap, paint, straight

ORIGIN = (0.0, 0.0, 0.0)
STANDING = (0.0, 0.0)
DWA = dict(
    min_vel_y=0.0,
    max_vel_y=0.0,
    max_vel_x=0.5,
    max_vel_trans=0.5,
    acc_lim_x=10.0,
    acc_lim_theta=10.0,
)


def make(plugin, **changes):
    """Return a local planner with the Jackal's other parameters."""
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    tree["base_local_planner"] = plugin
    tree["DWAPlannerROS"] = dict(DWA)
    tree[namespace(plugin)].update(
        xy_goal_tolerance=0.2,
        yaw_goal_tolerance=0.15,
        **changes,
    )
    full_tree = complete(tree)
    return factory.make_local_planner(full_tree, Configuration(full_tree))


def costmap(*lethal):
    """Return a map of 6 x 6 m around the origin with lethal cells at points [m]."""
    costmap = laser_costmap(6.0, 6.0, 0.05, (-3.0, -3.0), inflation=InflationParameters(0.3))
    cells = np.zeros((120, 120), np.uint8)
    for x, y in lethal:
        row = int((y + 3) / 0.05)
        column = int((x + 3) / 0.05)
        cells[row, column] = 254
    paint(costmap, cells)
    return costmap


@pytest.fixture(params=LOCAL_PLANNERS)
def plugin(request):
    """Return each local planner in turn."""
    return request.param


@pytest.fixture
def planner(plugin):
    """Return a planner with a plan 2 m straight ahead."""
    local_planner = make(plugin)
    local_planner.set_plan(straight(2.0))
    return local_planner


def test_drives_along_the_plan_and_shows_the_chosen_trajectory(planner):
    free_map = costmap()
    cells = free_map.cells.copy()
    ok, (v, w) = planner.compute_velocity(ORIGIN, STANDING, free_map)
    assert ok
    assert v > 0.1
    assert abs(w) < 1.5
    assert not planner.goal_reached

    # What viewers show
    assert planner.local_plan[0].tolist() == [0.0, 0.0, 0.0]
    assert planner.local_plan.shape[1] == planner.cropped_plan.shape[1] == 3
    assert len(planner.cropped_plan) > 10
    costs = planner.cost_cloud(free_map)
    assert costs.shape[1] == 7
    assert len(costs) > 1000
    assert costs.dtype == planner.trajectory_cloud(free_map).dtype == np.float32
    # The cloud has only legal trajectories, and the chosen one has the least cost.
    x, y, _, _, trajectory_cost = planner.trajectory_cloud(free_map).T
    assert trajectory_cost.min() >= 0.0
    is_best = trajectory_cost == trajectory_cost.min()
    end_x, end_y, _ = planner.local_plan[-1]
    end_distances = np.hypot(x - end_x, y - end_y)
    assert end_distances[is_best].min() < 1e-5

    # The search leaves the map as it was.
    assert np.array_equal(free_map.cells, cells)


def drive(planner, local_costmap, pose=ORIGIN, seconds=20.0):
    """Follow the commands exactly at 20 Hz, and return the final pose and whether the goal was
    reached.
    """
    twist = STANDING
    for _ in range(int(20 * seconds)):
        ok, command = planner.compute_velocity(pose, twist, local_costmap)
        assert ok
        if planner.goal_reached:
            assert command == STANDING
            return pose, True
        pose = moved(pose, *command)
        twist = command
    return pose, False


def moved(pose, v, w):
    """Return the pose of an ideal robot after a command of .05 s."""
    x, y, yaw = pose
    distance = v / 20
    return x + distance * math.cos(yaw), y + distance * math.sin(yaw), yaw + w / 20


@pytest.mark.parametrize("yaw", [0.0, 1.5])
def test_arrives_and_turns_to_the_heading(planner, yaw):
    planner.set_plan(straight(1.5, yaw))
    (x, y, last_yaw), has_reached = drive(planner, costmap())
    assert has_reached
    assert math.hypot(x - 1.5, y) <= 0.25
    assert abs(last_yaw - yaw) <= 0.15
    # The next plan is a new goal.
    planner.set_plan(straight(1.5, yaw))
    assert not planner.goal_reached


def test_no_command_for_inputs_that_are_not_finite(planner):
    for index, bad_value in itertools.product(range(5), (math.nan, math.inf)):
        values = [0.0] * 5
        values[index] = bad_value
        pose = tuple(values[:3])
        twist = tuple(values[3:])
        answer = planner.compute_velocity(pose, twist, costmap())
        assert answer == (False, STANDING), (index, bad_value)
        # The next cycle is as usual.
        ok, _ = planner.compute_velocity(ORIGIN, STANDING, costmap())
        assert ok


def test_no_command_far_from_the_plan_or_without_one(planner):
    assert planner.compute_velocity((0, 40, 0), STANDING, costmap()) == (False, STANDING)
    planner.set_plan(np.zeros((0, 3)))
    assert planner.compute_velocity(ORIGIN, STANDING, costmap()) == (False, STANDING)
    assert len(planner.local_plan) == len(planner.trajectory_cloud(costmap())) == 0
    assert not planner.goal_reached


def test_no_forward_command_into_an_obstacle(planner):
    wall_ahead = [(0.36, y / 20) for y in range(-20, 21)]
    map_with_wall = costmap(*wall_ahead)
    ok, (v, _) = planner.compute_velocity(ORIGIN, STANDING, map_with_wall)
    assert not (ok and v > 0)


def test_refusals_are_those_of_a_cycle_without_a_legal_sample(planner):
    free_map = costmap()
    planner.compute_velocity(ORIGIN, STANDING, free_map)
    assert planner.refusals(free_map) == {}

    # A wall across the map separates the robot from its goal.
    wall = [(1.0, y / 20) for y in range(-60, 60)]
    divided_map = costmap(*wall)
    assert planner.compute_velocity(ORIGIN, STANDING, divided_map) == (False, STANDING)
    counts = planner.refusals(divided_map)
    assert counts.pop("samples") == sum(counts.values()) > 0

    # Nothing is sampled.
    planner.compute_velocity((math.nan, 0.0, 0.0), STANDING, divided_map)
    assert planner.refusals(divided_map) == {}


def test_a_reconfigure_of_some_values_keeps_the_others(planner):
    planner.reconfigure({"max_vel_x": 0.2})
    ok, (v, _) = planner.compute_velocity(ORIGIN, STANDING, costmap())
    assert ok
    assert 0.1 < v <= 0.2 + 1e-6
