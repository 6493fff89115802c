"""Tests of TrajectoryLocalPlanner: cut of the plan, behaviour at the goal, parameters, state."""

import math

import numpy as np
import pytest

from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.plan_cut import cut_plan, half_size
from applr_ros1.planner.trajectory.local_planner import TrajectoryLocalPlanner
from tests.support.robots import JACKAL_FOOTPRINT, JACKAL_PARAMETERS
from tests.support.scenes import open_map, straight

JACKALS = complete(JACKAL_PARAMETERS)["TrajectoryPlannerROS"]
PARAMS = dict(JACKALS, prune_plan=True, max_rotational_vel=1.0)
ORIGIN = (0.0, 0.0, 0.0)
AT_GOAL = (0.9, 0.0, 0.0)  # within the tolerance of a goal at x = 1 m
HALF_SIZE = 5.0  # half the side of the map at which plans are cut [m]
NO_COMMAND = (False, (0.0, 0.0))


def local_planner(plan=None, **changes):
    """Return the Jackal's local planner with a plan, by default 3 m straight ahead."""
    if plan is None:
        plan = straight()
    planner = TrajectoryLocalPlanner(dict(PARAMS, **changes), JACKAL_FOOTPRINT)
    planner.set_plan(plan)
    return planner


def command(planner, pose, twist=(0.0, 0.0)):
    """Return (ok, (v, w)) on an empty map."""
    return planner.compute_velocity(pose, twist, open_map())


# -- cut of the plan -------------------------------------------------------------------------------


def test_a_point_on_the_limit_of_the_cut_is_inside():
    plan = np.array([[0.0, 0, 0], [3.0, 4.0, 0], [9.0, 0, 0], [1.0, 0, 0]])
    cropped, _ = cut_plan(plan, 0.0, 0.0, HALF_SIZE, True)
    assert cropped[:, 0].tolist() == [0.0, 3.0, 9.0]


def test_leading_points_1_m_away_or_more_are_dropped_for_good():
    plan = straight(3.0, step=0.5)
    cropped, dropped_count = cut_plan(plan, 2.0, 0.0, HALF_SIZE, True)
    assert dropped_count == 3
    assert cropped[0, 0] == 1.5
    unpruned, _ = cut_plan(plan, 2.0, 0.0, HALF_SIZE, False)
    assert unpruned[0, 0] == 0.0

    # The local planner stores what is left.
    planner = local_planner(plan)
    command(planner, (2.0, 0.0, 0.0))
    # From x = 1.2 m the points at 0.5 and 1.0 m are near enough, but the first cycle has dropped
    # them.
    command(planner, (1.2, 0.0, 0.0))
    assert planner.cropped_plan[0, 0] == 1.5
    # From x = 0.2 m the rest of the plan is too far away.
    command(planner, (0.2, 0.0, 0.0))
    assert len(planner.cropped_plan) == 0


def test_without_prune_plan_the_points_behind_the_robot_stay():
    planner = local_planner(straight(3.0), prune_plan=False)
    command(planner, (2.0, 0.0, 0.0))
    # From here the first points are 2 m away, twice as far as pruning leaves any.
    assert planner.cropped_plan[0, 0] == 0.0


def test_control_fails_when_all_points_are_pruned_until_the_next_plan():
    planner = local_planner(np.array([[2.0, 0, 0], [3.0, 0, 0]]))
    assert command(planner, ORIGIN) == NO_COMMAND
    assert command(planner, (2, 0, 0)) == NO_COMMAND
    planner.set_plan(straight(3.0))
    ok, _ = command(planner, ORIGIN)
    assert ok


# -- driving ---------------------------------------------------------------------------------------


def test_stops_before_it_turns():
    planner = local_planner(straight(1.0, yaw=1.5), acc_lim_x=2.0, acc_lim_theta=2.0)
    # In a cycle of 0.05 s, 2 m/s^2 take 0.1 m/s off the speed.
    assert command(planner, AT_GOAL, (0.5, 0.3)) == (True, (0.4, pytest.approx(0.2)))
    assert command(planner, AT_GOAL, (-0.05, 0.0)) == (True, (-0.0, 0.0))
    assert command(planner, AT_GOAL) == (True, (0.0, 0.314))
    # Once the robot turns, its motion does not make it stop again.
    _, (_, w) = command(planner, (0.9, 0, 0.1), (0.0, 0.5))
    # 0.5 rad/s, and 2 rad/s^2 for a cycle.
    assert w == pytest.approx(0.6)


@pytest.mark.parametrize(("speed", "turns"), [(0.01, True), (0.011, False)])
def test_a_robot_up_to_a_centimetre_per_second_counts_as_stopped(speed, turns):
    planner = local_planner(straight(1.0, yaw=1.5))
    _, (_, w) = command(planner, AT_GOAL, (speed, 0.0))
    assert (w > 0.0) is turns


def test_turning_obeys_max_rotational_vel_and_not_the_server():
    planner = local_planner(straight(1.0, yaw=3.0), max_rotational_vel=0.8)
    assert command(planner, AT_GOAL) == (True, (0.0, 0.8))
    slower_parameters = dict(
        PARAMS,
        max_vel_theta=0.4,
        min_in_place_vel_theta=0.6,
        acc_lim_theta=0.1,
    )
    planner.reconfigure(slower_parameters)
    assert command(planner, AT_GOAL) == (True, (0.0, 0.8))


def test_turns_no_faster_than_it_can_stop_and_never_too_slowly():
    planner = local_planner(straight(1.0, yaw=0.2), acc_lim_theta=0.5)
    assert command(planner, AT_GOAL) == (True, (0.0, 0.314))

    planner = local_planner(straight(1.0, yaw=-0.3), acc_lim_theta=0.5)
    # The robot has stopped and turns.
    command(planner, AT_GOAL)
    _, (_, w) = command(planner, AT_GOAL, (0.0, -2.0))
    # 0.5 rad/s^2 stop this turn rate within the 0.3 rad that are left.
    assert w == pytest.approx(-math.sqrt(2 * 0.5 * 0.3))


def test_an_illegal_turn_is_refused():
    map_with_wall = open_map()
    planner = local_planner(straight(1.0, yaw=1.5))
    # The corners would hit this wall 0.4 m to the left.
    map_with_wall.cells[100 + 8, 100:140] = LETHAL
    assert planner.compute_velocity(AT_GOAL, (0.0, 0.0), map_with_wall) == NO_COMMAND


@pytest.mark.parametrize(("columns", "rows"), [(80, 40), (40, 80)])
def test_a_plan_is_cut_at_half_of_the_longer_side_of_the_map(columns, rows):
    assert half_size(open_map(columns, rows, resolution=0.05)) == pytest.approx(2.0)


def test_the_goal_is_reported_in_the_cycle_that_reaches_it_although_plans_keep_coming():
    """In C++ each new plan clears the latch before it is read: the robot stands for seconds."""
    planner = local_planner(straight(1.0))
    for _ in range(3):
        planner.set_plan(straight(1.0))
        assert not planner.goal_reached
        assert command(planner, AT_GOAL, (0.5, 0.0)) == (True, (0.0, 0.0))
        assert planner.goal_reached


@pytest.mark.parametrize(
    ("tolerances", "pose", "is_reached"),
    [
        # The goal is at x = 1 m.
        ({"xy_goal_tolerance": 0.25}, (0.75, 0.0, 0.0), True),
        ({"xy_goal_tolerance": 0.25}, (0.749, 0.0, 0.0), False),
        # A quaternion, through which the yaw passes, may change the last bits of any yaw but 0.
        ({"yaw_goal_tolerance": 0.0}, AT_GOAL, True),
        ({"yaw_goal_tolerance": 0.0}, (0.9, 0.0, 0.001), False),
    ],
)
def test_a_goal_exactly_a_tolerance_away_is_reached(tolerances, pose, is_reached):
    planner = local_planner(straight(1.0), **tolerances)
    command(planner, pose)
    assert planner.goal_reached is is_reached


def test_a_reached_goal_is_forgotten_in_a_reconfigure_as_in_cpp():
    """TrajectoryPlannerROS::reconfigureCB clears the flag, which C++ reads in its next cycle."""
    planner = local_planner(straight(1.0))
    command(planner, AT_GOAL)
    assert planner.goal_reached
    planner.reconfigure(PARAMS)
    assert not planner.goal_reached


@pytest.mark.parametrize("latches", [False, True])
def test_the_latch_keeps_the_position_reached(latches):
    before_the_goal = (0.5, 0.0, 0.0)
    planner = local_planner(straight(1.0, yaw=2.0), latch_xy_goal_tolerance=latches)
    command(planner, AT_GOAL)
    _, (v, w) = command(planner, before_the_goal)
    turns_in_place = v == 0.0 and w > 0
    assert turns_in_place is latches
    # A new plan clears the latch, as in C++.
    planner.set_plan(straight(1.0, yaw=2.0))
    _, (v, _) = command(planner, before_the_goal)
    assert v > 0


def test_flags_survive_plans():
    planner = local_planner(straight(1.0, yaw=2.0))
    command(planner, AT_GOAL)
    flags = [1, 1, 1, 1, 1]
    planner.planner.state = [*flags, 0.9, 0, 0.9, 0, 0]
    planner.set_plan(straight(1.0, yaw=2.0))
    assert planner.planner.state[:5] == flags


def test_the_control_period_is_the_inverse_of_the_frequency():
    # Without a frequency, C++ takes 20 Hz.
    for frequency, period in ((10.0, 0.1), (0.0, 0.05)):
        planner = local_planner(controller_frequency=frequency).planner
        assert planner.in_force["sim_period"] == period
