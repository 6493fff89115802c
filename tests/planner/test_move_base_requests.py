"""Tests of requests to MoveBase between two steps: reset, reconfigure, footprints, make_plan,
clear_costmaps.
"""

import math

import numpy as np
import pytest

from applr_ros1.planner.costmap.static_layer import StaticMap
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.parameter import ParameterError
from applr_ros1.policy.parameter_space import SPACE
from tests.support.refusals import refused
from tests.support.robots import SLALOM, ToyRobot, quick, run, start

PLANNER = "TrajectoryPlannerROS"


def test_reset_equals_a_fresh_object():
    tree = quick()
    used_move_base, robot = start((4.0, 0.0, 0.0), ToyRobot(circles=SLALOM), tree)
    used_move_base.reconfigure(PLANNER, {"max_vel_x": 1.3, "vx_samples": 9})
    used_move_base.reconfigure("local_costmap/inflater_layer", {"inflation_radius": 0.5})
    run(used_move_base, robot, 3.0)

    used_move_base.reset(0.0)

    new_move_base = MoveBase(tree)
    assert not used_move_base.global_costmap.cells.any()
    assert len(used_move_base.global_plan) == 0
    # Both drive the same course: every cycle and every cell must be the same.
    drives = []
    for move_base in (used_move_base, new_move_base):
        robot = ToyRobot(circles=SLALOM)
        cycles = []
        run(move_base, robot, 0.1)
        move_base.set_goal((3.5, 0.0, 0.0), robot.time)
        run(move_base, robot, 5.0, cycles=cycles)
        drives.append([cycle for _, cycle in cycles])
    assert drives[0] == drives[1]
    for name, costmap in used_move_base.costmaps.items():
        assert (costmap.cells == new_move_base.costmaps[name].cells).all(), name


@pytest.mark.parametrize(
    ("server", "values"),
    [
        (PLANNER, {"max_vel_x": math.nan, "vx_samples": 3}),
        ("", {"controller_frequency": 0.0}),
        ("local_costmap", {"width": 2**31 - 1}),
        ("local_costmap", {"footprint": "junk", "update_frequency": 1.0}),
    ],
)
def test_reconfigure_refuses_whole_requests(server, values):
    move_base = MoveBase(quick())
    earlier = move_base.configuration(server)
    refused(lambda: move_base.reconfigure(server, values), kind=ParameterError)
    assert move_base.configuration(server) == earlier


LOCAL = "local_costmap"
GLOBAL = "global_costmap"


@pytest.mark.parametrize(
    ("server", "values", "emptied"),
    [
        (LOCAL, {}, {LOCAL}),
        # a value in force, as rqt sends it after a click
        (LOCAL, {"footprint_padding": 0.1}, {LOCAL}),
        (LOCAL, {"footprint_padding": 0.14}, {LOCAL}),
        (GLOBAL, {"publish_frequency": 1.0}, {GLOBAL}),
        ("local_costmap/inflater_layer", {"inflation_radius": 0.6}, set()),
        ("global_costmap/inflater_layer", {}, set()),
        ("global_costmap/obstacles_layer", {"max_obstacle_height": 1.0}, set()),
        (PLANNER, {"max_vel_x": 1.0}, set()),
        ("", {"planner_frequency": 2.0}, set()),
    ],
)
def test_only_calls_of_a_costmaps_own_server_clear_it(server, values, emptied):
    """Costmap2DROS::reconfigureCB of costmap_2d calls resizeMap for every request."""
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2), (-1.5, 0.0, 0.2)])
    run(move_base, robot, 0.2)
    lethal = {name: costmap.cells == 254 for name, costmap in move_base.costmaps.items()}
    # The next scans cannot clear the removed posts.
    robot.circles = robot.circles[:0]
    move_base.reconfigure(server, values)
    costmaps = move_base.costmaps.items()
    assert {name for name, costmap in costmaps if not costmap.cells.any()} == emptied

    # The cleared costmap stays without the posts, the other one keeps them.
    run(move_base, robot, 0.1)
    for name, costmap in costmaps:
        assert lethal[name].any()
        expected = lethal[name] & (name not in emptied)
        assert ((costmap.cells == 254) == expected).all(), name


def test_a_cleared_map_is_updated_at_once_and_shows_the_last_scan():
    tree = quick()
    tree[GLOBAL]["update_frequency"] = 0.5
    move_base = MoveBase(tree)
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2)])
    run(move_base, robot, 0.2)
    lethal = (move_base.global_costmap.cells == 254).sum()
    # At 0.5 Hz the next update is not due yet.
    assert not move_base.step(robot.time, robot.pose, (0.0, 0.0)).updated[1]
    move_base.reconfigure(GLOBAL, {"width": 20})
    assert move_base.step(robot.time, robot.pose, (0.0, 0.0)).updated[1]
    assert 0 < lethal == (move_base.global_costmap.cells == 254).sum()


def test_a_map_whose_size_a_static_layer_determines_is_not_cleared():
    tree = quick()
    static_layer = {"name": "static", "type": "costmap_2d::StaticLayer"}
    tree[GLOBAL]["plugins"] = [static_layer, *tree[GLOBAL]["plugins"]]
    tree[GLOBAL]["static"] = {"use_maximum": True}
    move_base = MoveBase(tree)
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2)])
    move_base.set_map(StaticMap(np.zeros((200, 200), np.int8), 0.05, (-5.0, -5.0)))
    run(move_base, robot, 0.2)
    earlier = move_base.global_costmap.cells.copy()
    move_base.reconfigure(GLOBAL, {"footprint_padding": 0.1})
    assert earlier.any()
    assert (move_base.global_costmap.cells == earlier).all()


def test_send_calls_no_server_whose_values_are_in_force():
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2)])
    theta = SPACE.theta0.copy()
    run(move_base, robot, 0.2)
    theta[SPACE.names.index("inflation_radius")] = 0.5
    # 0.1 m is in force. A call with 0.14 m clears the costmaps, a second one is not made.
    for padding, kept in ((0.1, True), (0.14, False), (0.14, True)):
        theta[SPACE.names.index("footprint_padding")] = padding
        in_force = move_base.put_in_force(SPACE.settings(theta))
        assert move_base.local_costmap.cells.any() == kept
        assert move_base.global_costmap.cells.any() == kept
        assert SPACE.read_back(in_force).tolist() == theta.tolist()
        run(move_base, robot, 0.1)


def test_maps_may_be_resized_while_driving():
    move_base, robot = start((4.0, 0.0, 0.0), ToyRobot(circles=[(1.5, 1.0, 0.2)]))
    for server, values in (
        ("local_costmap", {"width": 5, "height": 7}),
        ("local_costmap", {"resolution": 0.1}),
        ("global_costmap", {"origin_x": -3.0}),
        ("global_costmap", {"height": 16}),
    ):
        run(move_base, robot, 0.5)
        move_base.reconfigure(server, values)
    # 5 m by 7 m in cells of 0.1 m, and 20 m by 16 m in cells of 0.05 m
    assert move_base.local_costmap.cells.shape == (70, 50)
    assert move_base.global_costmap.cells.shape == (320, 400)
    assert run(move_base, robot, 20.0) == ("succeeded", "Goal reached.")


def test_footprint_follows_its_server_and_its_topic():
    square = [
        (0.3, 0.3),
        (-0.3, 0.3),
        (-0.3, -0.3),
        (0.3, -0.3),
    ]
    move_base = MoveBase(quick())
    move_base.reconfigure("local_costmap", {"footprint_padding": 0.0})
    assert move_base.local_costmap.footprint[2] == pytest.approx((0.21, 0.165))
    move_base.set_footprint("local_costmap", square)
    assert move_base.local_costmap.inscribed_radius == pytest.approx(0.3)
    # As in C++, this pads the topic's footprint.
    move_base.reconfigure("local_costmap", {"footprint_padding": 0.2})
    assert move_base.local_costmap.inscribed_radius == pytest.approx(0.5)
    # A clock jump does not change the robot's size.
    move_base.reset(0.0, restore=False)
    assert move_base.local_costmap.inscribed_radius == pytest.approx(0.5)
    move_base.reconfigure("local_costmap", {"footprint": "[]", "robot_radius": 0.4})
    assert move_base.local_costmap.circumscribed_radius == pytest.approx(0.4 + 0.2 * math.sqrt(2.0))
    # A reset restores the parameters of the start, among them padding and footprint.
    move_base.set_footprint("local_costmap", square)
    move_base.reset(0.0)
    assert move_base.local_costmap.footprint[2] == pytest.approx((0.31, 0.265))


def test_parameters_read_once_keep_their_start_up_values_after_a_reset():
    move_base = MoveBase(quick())
    start_accelerations = move_base.local_planner.accelerations
    start_slowest_turn = move_base.local_planner.slowest_turn
    changes = {
        "acc_lim_theta": 1.0,
        "min_in_place_vel_theta": 0.05,
        "max_vel_x": 1.3,
    }
    move_base.reconfigure(PLANNER, changes)
    assert move_base.local_planner.planner.in_force["max_vel_x"] == 1.3
    move_base.reset(0.0, restore=False)
    local_planner = move_base.local_planner
    assert local_planner.accelerations == start_accelerations
    assert local_planner.slowest_turn == start_slowest_turn
    assert local_planner.planner.in_force["max_vel_x"] == 1.3


def test_make_plan_frees_the_robots_square_and_searches_near_the_goal():
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(2.0, 0.0, 0.1)])
    run(move_base, robot, 0.2)
    # The goal is in the obstacle.
    assert len(move_base.make_plan(robot.pose, (2.0, 0.0, 0.0))) == 0
    near_plan = move_base.make_plan(robot.pose, (2.0, 0.0, 0.0), 1.0)
    # The plan leads to the free place nearest the goal, and then, as
    # make_plan_add_unreachable_goal says, to the goal itself.
    free_x, free_y, _ = near_plan[-2]
    assert tuple(near_plan[-1, :2]) == (2.0, 0.0)
    assert 0.2 < math.hypot(free_x - 2.0, free_y) < 1.0
    move_base.reconfigure("", {"make_plan_add_unreachable_goal": False})
    plan_without_the_goal = move_base.make_plan(robot.pose, (2.0, 0.0, 0.0), 1.0)
    assert plan_without_the_goal[-1, :2].tolist() == near_plan[-2, :2].tolist()
    assert len(move_base.make_plan(robot.pose, (math.nan, 0.0, 0.0), 1.0)) == 0
    # The search must end.
    assert len(move_base.make_plan(robot.pose, (500.0, 0.0, 0.0), 1e9)) >= 0


@pytest.mark.parametrize(("tolerance", "is_found"), [(0.0, False), (0.6, True)])
def test_a_plan_may_end_within_default_tolerance_of_an_occupied_goal(tolerance, is_found):
    move_base = MoveBase(quick(NavfnROS={"default_tolerance": tolerance}))
    robot = ToyRobot(circles=[(2.0, 0.0, 0.1)])
    run(move_base, robot, 0.1)
    plan = move_base.plan(robot.pose, (2.0, 0.0, 0.0))
    assert (len(plan) > 0) is is_found
    for x, y, _ in plan[-1:]:
        assert max(abs(x - 2.0), abs(y)) <= 0.6 + 1e-9


def test_make_plan_leaves_the_maps_unchanged_while_a_goal_is_active():
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(0.45, 0.0, 0.1)])
    run(move_base, robot, 0.2)
    move_base.set_goal((3.0, 0.0, 0.0), robot.time)
    was_lethal = move_base.global_costmap.cells == 254
    assert was_lethal.any()
    move_base.make_plan(robot.pose, (3.0, 0.0, 0.0))
    is_lethal = move_base.global_costmap.cells == 254
    assert (is_lethal == was_lethal).all()


def test_clear_costmaps_clears_both_and_the_last_scan_marks_again():
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2)])
    run(move_base, robot, 0.2)
    move_base.clear_costmaps()
    assert not move_base.local_costmap.cells.any()
    assert not move_base.global_costmap.cells.any()
    run(move_base, robot, 0.1, scans=False)
    assert (move_base.local_costmap.cells == 254).any()
