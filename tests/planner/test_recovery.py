"""Tests of recovery behaviours: their order, the course of a rotation, and clearing of obstacle
layers of any name.
"""

import math

import numpy as np
import pytest

from applr_ros1.common.scan import PointCloud
from applr_ros1.planner import recovery
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.parameters.check import check, complete, remarks
from applr_ros1.planner.parameters.move_base_parameters import RECOVERY_TYPES
from tests.support.robots import JACKAL_FOOTPRINT, JACKAL_PARAMETERS, ToyRobot
from tests.support.seeds import seeds


def make_costmap():
    costmap = Costmap(10, 10, 0.05, (-5.0, -5.0), footprint=JACKAL_FOOTPRINT)
    points = np.array([[2.0, 0.0, 0.0], [0.81, 0.81, 0.0]], np.float32)
    costmap.update((0.0, 0.0, 0.0), PointCloud((0.0, 0.0, 0.0), points))
    return costmap


def lethal(made, x, y):
    mx, my = made.world_to_map(x, y)
    return made.cells[my, mx] == 254


def rotate(pose=(0.0, 0.0, 0.0), **limits):
    """Return a rotation that has just begun."""
    turn = recovery.RotateRecovery(
        "rotate_recovery", dict(complete(JACKAL_PARAMETERS)["TrajectoryPlannerROS"], **limits)
    )
    turn.start(0.0, pose)
    return turn


OPEN = Costmap(10, 10, 0.05, (-5.0, -5.0), footprint=JACKAL_FOOTPRINT)


USUAL = ["conservative_reset", "rotate_recovery", "aggressive_reset", "rotate_recovery"]


def test_default_recoveries_have_their_order_and_sizes():
    built = recovery.build(complete(JACKAL_PARAMETERS))
    assert [b.name for b in built] == USUAL
    assert built[1] is built[3]
    assert (built[0].side, built[2].side) == (3.0, 1.84)


def test_listed_recoveries_replace_the_defaults():
    listed = [
        {"name": "turn", "type": RECOVERY_TYPES[1]},
        {"name": "wide", "type": RECOVERY_TYPES[0]},
    ]
    built = recovery.build(
        complete(dict(JACKAL_PARAMETERS, recovery_behaviors=listed, wide={"reset_distance": 6.0}))
    )
    assert [type(b) for b in built] == [recovery.RotateRecovery, recovery.ClearCostmapRecovery]
    assert built[1].side == 6.0
    # As in C++, there are none.
    assert recovery.build(complete(dict(JACKAL_PARAMETERS, recovery_behaviors=[]))) == []


def test_a_name_given_twice_leads_to_the_default_recoveries_as_in_cpp():
    """loadRecoveryBehaviors in move_base.cpp logs an error and loads the default behaviours."""
    listed = [
        {"name": name, "type": RECOVERY_TYPES[kind]}
        for name, kind in (("own", 0), ("own", 1), ("last", 1))
    ]
    tree = dict(JACKAL_PARAMETERS, recovery_behaviors=listed, own={"reset_distance": 6.0})
    assert check(tree) == []
    (line,) = remarks(tree)
    assert line.startswith("recovery_behaviors has {'name': 'own', ")
    built = recovery.build(complete(tree))
    assert [b.name for b in built] == USUAL


def test_clearing_removes_obstacles_only_outside_the_square():
    local = make_costmap()
    world = make_costmap()
    assert lethal(local, 2.0, 0.0)
    assert lethal(local, 0.81, 0.81)
    clear = recovery.ClearCostmapRecovery("conservative_reset", 3.0)
    assert clear.step(0.0, (0.0, 0.0, 0.0), local, world) is None
    empty = PointCloud((0.0, 0.0, 0.0), local.obstacles.cloud.points[:0])
    for made in (local, world):
        made.update((0.0, 0.0, 0.0), empty)
        assert not lethal(made, 2.0, 0.0)
        assert lethal(made, 0.81, 0.81)


def test_the_global_map_is_cleared_around_the_pose_in_its_own_frame():
    local = make_costmap()
    world = make_costmap()
    clear = recovery.ClearCostmapRecovery("conservative_reset", 3.0)
    clear.step(0.0, (0.0, 0.0, 0.0), local, world, (2.3, -1.0, 0.0))
    for made, near, far in ((local, (0.81, 0.81), (2.0, 0.0)), (world, (2.0, 0.0), (0.81, 0.81))):
        made.update((0.0, 0.0, 0.0), PointCloud((0.0, 0.0, 0.0), made.obstacles.cloud.points[:0]))
        assert lethal(made, *near)
        assert not lethal(made, *far)


def test_rotation_is_one_full_turn_anticlockwise():
    robot = ToyRobot((0.0, 0.0, 0.7))
    turn = rotate((0.0, 0.0, 0.7))
    turned = 0.0
    commands = []
    while True:
        command = turn.step(robot.time, robot.pose, OPEN, OPEN)
        if command is None:
            break
        commands.append(command)
        robot.drive(command, 0.05)
        turned += command[1] * 0.05
        assert turned < 7.0
    assert turned == pytest.approx(2 * math.pi, abs=0.157 + 1.57 * 0.05)
    assert all(v == 0.0 and 0.314 <= w <= 1.57 for v, w in commands)
    assert commands[0][1] == 1.57


@seeds(8)
def test_rotation_is_one_turn_at_slow_control_rates_too(seed):
    draw = np.random.default_rng(seed)
    turn = rotate((0.0, 0.0, 0.7), yaw_goal_tolerance=0.05)
    robot = ToyRobot((0.0, 0.0, 0.7))
    turned = 0.0
    command = (0.0, 0.0)
    while command is not None:
        robot.drive(command, 0.2)
        turned += command[1] * 0.2
        command = turn.step(robot.time, robot.pose, OPEN, OPEN)
        command = command and (0.0, command[1] * draw.normal(1.0, 0.03))
    assert turned == pytest.approx(2 * math.pi, abs=0.4)


def test_rotation_is_refused_next_to_an_obstacle():
    costmap = make_costmap()
    costmap.update(
        (0.0, 0.0, 0.0), PointCloud((0.0, 0.0, 0.0), np.array([[0.0, 0.36, 0.0]], np.float32))
    )
    assert rotate().step(0.0, (0.0, 0.0, 0.0), costmap, costmap) is None


def test_rotation_does_not_begin_if_its_second_half_is_blocked():
    """The long front of the robot would hit a post after three quarters of the turn."""
    costmap = Costmap(
        10, 10, 0.05, (-5.0, -5.0), footprint=[(-0.2, -0.2), (-0.2, 0.2), (0.5, 0.2), (0.5, -0.2)]
    )
    for y, free in ((-0.4, False), (-0.8, True)):
        costmap.clear()
        costmap.update(
            (0.0, 0.0, 0.0), PointCloud((0.0, 0.0, 0.0), np.array([[0.0, y, 0.0]], np.float32))
        )
        assert (rotate().step(0.0, (0.0, 0.0, 0.0), costmap, costmap) is not None) == free


def test_rotation_of_a_robot_that_cannot_turn_ends():
    turn = rotate()
    now = 0.0
    while turn.step(now, (0.0, 0.0, 0.0), OPEN, OPEN) is not None:
        now += 0.05
        assert now < 30.0
    assert now == pytest.approx(recovery.PATIENCE * 2 * math.pi / 1.57, abs=0.1)


def test_a_rotation_slows_down_within_its_acceleration_limit():
    turn = rotate(acc_lim_theta=1.0)
    commands = [turn.step(0.0, (0.0, 0.0, yaw), OPEN, OPEN) for yaw in (0.0, 3.1, -0.2)]
    assert commands[-1] == (0.0, pytest.approx(math.sqrt(2.0 * 1.0 * 0.2)))


def test_the_angle_difference_is_the_shorter_way():
    pi = math.pi
    for a, b, want in [
        (0, 1, 1),
        (1, 0, -1),
        (3, -3, 2 * pi - 6),
        (0, pi, pi),
        (0, -pi, pi),
        (10, 10, 0),
    ]:
        assert recovery.angle_difference(a, b) == pytest.approx(want, abs=1e-12), (a, b)
