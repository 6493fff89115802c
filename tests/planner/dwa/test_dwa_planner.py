"""Tests of the DWA planner besides its golden vectors: parameters, state between cycles, refusals
by critic.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.planner.dwa.critics import registry
from applr_ros1.planner.dwa.critics.registry import CRITICS
from applr_ros1.planner.dwa.planner import DWAPlanner
from applr_ros1.planner.dwa.total_cost import NOTHING_LEGAL
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER
from applr_ros1.planner.sampling_planner import Velocity
from tests.support.scenes import open_map

BURGER_FOOT = np.array(
    [
        [-0.115, -0.115],
        [-0.115, 0.115],
        [0.051, 0.115],
        [0.051, -0.115],
    ]
)
BURGER_TREE = complete(robots.load("turtlebot3_burger").parameters())
BURGER = dict(BURGER_TREE["DWAPlannerROS"], vy_samples=1)
ORIGIN = (0, 0, 0)
AT_REST = (0, 0, 0)
AHEAD = [(0, 0), (1, 0)]  # plan

NO_FLOOD = 1e300  # costs above it are of grids that count as not flooded


def small_map():
    """Return a map of 3 x 3 m around the origin."""
    return open_map(60, 60, origin=(-1.5, -1.5), foot=BURGER_FOOT)


def test_a_changed_footprint_counts_at_once():
    # Given: an obstacle outside the robot, but inside an outline twice as large
    planner = DWAPlanner(BURGER, 0.1)
    costmap = small_map()
    costmap.cells[34, 30] = 254
    assert planner.find_best_path(costmap, AHEAD, ORIGIN, AT_REST).cost >= 0

    costmap.footprint = BURGER_FOOT * 2
    assert planner.find_best_path(costmap, AHEAD, ORIGIN, AT_REST).cost == NOTHING_LEGAL


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi])
def test_the_best_sample_may_end_in_the_outermost_cells_of_the_map(yaw):
    """The robot looks at a border, .2 m away, and its plan ends in the cells at the border."""
    parameters = dict(BURGER, occdist_scale=0.0, forward_point_distance=0.0)
    planner = DWAPlanner(parameters, 0.1)
    direction = np.array([math.cos(yaw), math.sin(yaw)])
    start = 1.3 * direction
    plan = [start, 1.48 * direction]
    choice = planner.find_best_path(
        small_map(),
        plan,
        (*start, yaw),
        (0.15, 0.0, 0.0),
    )
    costs = planner.score_all_samples().costs
    assert choice.cost == costs[costs >= 0.0].min()
    x, y, _ = choice.points[-1]
    assert 1.45 < max(abs(x), abs(y)) < 1.5


def counted(planner):
    """Return the refusals that are not 0."""
    return {critic: count for critic, count in planner.refusals().items() if count}


def test_refusals_count_the_rejected_samples_by_critic():
    only_forward = dict(BURGER, min_vel_x=0.15, vx_samples=2, vth_samples=3)
    planner = DWAPlanner(only_forward, 0.1)
    costmap = small_map()
    twist = (0.15, 0, 0)

    # Only turns to the left are allowed.
    # The flag of the oscillation critic that forbids turns to the right.
    planner.state = [0] * 4 + [1] + [0] * 10
    planner.find_best_path(costmap, AHEAD, ORIGIN, twist)
    assert counted(planner) == {"samples": 6, "oscillation": 2}

    # A wall is ahead.
    costmap.cells[:, 33:35] = 254
    planner.find_best_path(costmap, AHEAD, ORIGIN, twist)
    assert counted(planner) == {"samples": 6, "oscillation": 2, "obstacle": 4}

    # A limit is below all speeds.
    planner.reconfigure({"max_vel_trans": 0.01})
    planner.find_best_path(costmap, AHEAD, ORIGIN, twist)
    assert counted(planner) == {"samples": 6, "velocity limits": 6}


def test_critics_are_the_files_of_their_folder_and_have_parameters():
    files = {path.stem for path in Path(registry.__file__).parent.glob("*.py")}
    names = [critic.term.name for critic in CRITICS]
    assert sorted(files - {"__init__", "critic", "distance", "registry"}) == sorted(names)
    parameters = {parameter.name for parameter in DWA_PLANNER}
    for critic in CRITICS:
        assert critic.term.parameter in parameters
        # `why` needs words for a refusal.
        assert bool(critic.term.refusal) == (critic.refuses != "nothing")


@pytest.mark.parametrize("critic", CRITICS, ids=lambda critic: critic.term.name)
def test_a_cost_and_its_lower_bound_have_the_weight_and_the_value_of_each_critic(critic):
    """A greater weight makes samples dearer, and the search still finds the cheapest."""
    costmap = small_map()
    costmap.cells[:] = 20
    weight = BURGER[critic.term.parameter]
    costs = []
    weights = []
    for parameters in ({}, {critic.term.parameter: weight + 0.5}):
        planner = DWAPlanner(dict(BURGER, **parameters), 0.1)
        choice = planner.find_best_path(costmap, [(0, 0), (1, 0.3)], ORIGIN, (0.1, 0, 0.2))
        samples = planner.score_all_samples()
        is_legal = samples.costs >= 0
        costs.append(samples.costs[is_legal])
        weights.append(planner.scales[CRITICS.index(critic)])
        # The search follows the bounds.
        assert choice.cost == costs[-1].min()
    values = samples.critics[is_legal]
    np.testing.assert_allclose(costs[-1], values @ planner.scales)

    # With the values as bounds, the bound is the cost.
    number = int(np.argmax(samples.costs))
    known = samples.critics[number : number + 1]
    velocity = Velocity(*samples.stored[number].tolist())
    bound = registry.lower_bound(planner.in_force, known, 0, velocity)
    assert bound == samples.costs[number]

    if critic.scale:
        assert weights[1] > weights[0]
        assert (values[:, CRITICS.index(critic)] > 0).any()
        assert (costs[1] > costs[0]).any()
    else:  # A critic that only refuses
        assert (costs[1] == costs[0]).all()
