"""Tests of recovery behaviours: their order, the course of a rotation, and clearing of obstacle
layers of any name.
"""

import copy
import math

import numpy as np
import pytest

from applr_ros1.common.scan import PointCloud
from applr_ros1.planner import recovery
from applr_ros1.planner.parameters.check import check, complete, remarks
from applr_ros1.planner.parameters.move_base_parameters import RECOVERY_TYPES
from tests.support.robots import JACKAL_PARAMETERS, ToyRobot
from tests.support.scenes import laser_costmap, see
from tests.support.seeds import seeds


def make_costmap():
    """Return a costmap with an obstacle 2 m ahead, and one 1.15 m away at (0.81, 0.81)."""
    costmap = laser_costmap(10, 10, 0.05, (-5.0, -5.0))
    see(costmap, ORIGIN, cloud_of((2.0, 0.0), (0.81, 0.81)))
    return costmap


def lethal(costmap, x, y):
    """Return whether the cell at (x, y) [m] is lethal."""
    column, row = costmap.world_to_map(x, y)
    return costmap.cells[row, column] == 254


def rotate(pose=(0.0, 0.0, 0.0), **limits):
    """Return a rotation that has just begun."""
    parameters = dict(complete(JACKAL_PARAMETERS)["TrajectoryPlannerROS"], **limits)
    rotation = recovery.RotateRecovery("rotate_recovery", parameters)
    rotation.start(0.0, pose)
    return rotation


def cloud_of(*points):
    """Return a cloud of points (x, y) [m] seen from the origin."""
    heights = np.zeros(len(points))
    xyz = np.column_stack([np.reshape(points, (-1, 2)), heights])
    return PointCloud((0.0, 0.0, 0.0), xyz.astype(np.float32))


ORIGIN = (0.0, 0.0, 0.0)
# A costmap without obstacles
OPEN = laser_costmap(10, 10, 0.05, (-5.0, -5.0))
# Default recoveries of move_base.cpp, in its order
USUAL = ["conservative_reset", "rotate_recovery", "aggressive_reset", "rotate_recovery"]


def test_default_recoveries_have_their_order_and_sizes():
    behaviours = recovery.build(complete(JACKAL_PARAMETERS))
    assert [behaviour.name for behaviour in behaviours] == USUAL
    conservative_reset, first_rotation, aggressive_reset, second_rotation = behaviours
    assert first_rotation is second_rotation
    # 1.84 m is four times the circumscribed radius of the Jackal's footprint, as C++ sets it.
    assert conservative_reset.side == 3.0
    assert aggressive_reset.side == 1.84


def test_listed_recoveries_replace_the_defaults():
    listed = [
        {"name": "turn", "type": RECOVERY_TYPES[1]},
        {"name": "wide", "type": RECOVERY_TYPES[0]},
    ]
    tree = dict(JACKAL_PARAMETERS, recovery_behaviors=listed, wide={"reset_distance": 6.0})
    rotation, clearing = recovery.build(complete(tree))
    assert type(rotation) is recovery.RotateRecovery
    assert clearing.side == 6.0
    # As in C++, there are none.
    assert recovery.build(complete(dict(JACKAL_PARAMETERS, recovery_behaviors=[]))) == []


def test_only_the_default_list_loses_its_rotations():
    """As in C++, clearing_rotation_allowed does not concern a list of one's own."""
    tree = dict(JACKAL_PARAMETERS, clearing_rotation_allowed=False)
    behaviours = recovery.build(complete(tree))
    assert [behaviour.name for behaviour in behaviours] == [
        "conservative_reset",
        "aggressive_reset",
    ]
    tree["recovery_behaviors"] = [{"name": "turn", "type": RECOVERY_TYPES[1]}]
    (rotation,) = recovery.build(complete(tree))
    assert type(rotation) is recovery.RotateRecovery


def test_the_aggressive_reset_keeps_a_square_of_four_radii_of_the_local_costmap():
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    tree["local_costmap"]["circumscribed_radius"] = 0.5
    tree["global_costmap"]["circumscribed_radius"] = 0.7
    aggressive_reset = recovery.build(complete(tree))[2]
    assert aggressive_reset.side == 2.0


def test_a_name_given_twice_leads_to_the_default_recoveries_as_in_cpp():
    """loadRecoveryBehaviors in move_base.cpp logs an error and loads the default behaviours."""
    clearing, rotation = RECOVERY_TYPES
    listed = [
        {"name": "own", "type": clearing},
        {"name": "own", "type": rotation},
        {"name": "last", "type": rotation},
    ]
    tree = dict(JACKAL_PARAMETERS, recovery_behaviors=listed, own={"reset_distance": 6.0})
    assert check(tree) == []
    (line,) = remarks(tree)
    assert line.startswith("recovery_behaviors has {'name': 'own', ")
    behaviours = recovery.build(complete(tree))
    assert [behaviour.name for behaviour in behaviours] == USUAL


def test_clearing_removes_obstacles_only_outside_the_square():
    local_costmap = make_costmap()
    global_costmap = make_costmap()
    assert lethal(local_costmap, 2.0, 0.0)
    behaviour = recovery.ClearCostmapRecovery("conservative_reset", 3.0)
    assert behaviour.step(0.0, ORIGIN, local_costmap, global_costmap) is None
    # A scan without returns, because the last scan would mark the obstacles again
    for costmap in (local_costmap, global_costmap):
        see(costmap, ORIGIN, cloud_of())
        assert not lethal(costmap, 2.0, 0.0)
        assert lethal(costmap, 0.81, 0.81)


def test_the_global_map_is_cleared_around_the_pose_in_its_own_frame():
    local_costmap = make_costmap()
    global_costmap = make_costmap()
    behaviour = recovery.ClearCostmapRecovery("conservative_reset", 3.0)
    # In the global map's frame the robot is at (2.3, -1.0): there the other obstacle is near.
    behaviour.step(0.0, ORIGIN, local_costmap, global_costmap, (2.3, -1.0, 0.0))
    for costmap in (local_costmap, global_costmap):
        see(costmap, ORIGIN, cloud_of())
    assert lethal(local_costmap, 0.81, 0.81)
    assert not lethal(local_costmap, 2.0, 0.0)
    assert lethal(global_costmap, 2.0, 0.0)
    assert not lethal(global_costmap, 0.81, 0.81)


@seeds(8)
def test_rotation_is_one_turn_anticlockwise_at_any_control_rate(seed):
    rng = np.random.default_rng(seed)
    for period, slip in ((0.05, 0.0), (0.2, 0.03)):
        rotation = rotate((0.0, 0.0, 0.7), yaw_goal_tolerance=0.05)
        robot = ToyRobot((0.0, 0.0, 0.7))
        turned = 0.0
        rates = []
        while (command := rotation.step(robot.time, robot.pose, OPEN, OPEN)) is not None:
            v, w = command
            assert v == 0.0
            rates.append(w)
            # Wheels slip: the base turns a few percent more or less than commanded.
            slipped_w = w * rng.normal(1.0, slip)
            robot.drive((0.0, slipped_w), period)
            turned += slipped_w * period
            assert turned < 7.0
        # It may pass the tolerance by one cycle at full speed.
        assert turned == pytest.approx(2 * math.pi, abs=0.09 + 1.57 * period)
        # From min_in_place_vel_theta to max_rotational_vel of the Jackal
        assert min(rates) >= 0.314
        assert rates[0] == max(rates) == 1.57


def test_rotation_does_not_begin_if_its_second_half_is_blocked():
    """The long front of the robot would hit a post after three quarters of the turn."""
    long_front = [
        (-0.2, -0.2),
        (-0.2, 0.2),
        (0.5, 0.2),
        (0.5, -0.2),
    ]
    costmap = laser_costmap(10, 10, 0.05, (-5.0, -5.0), footprint=long_front)
    for y, is_free in ((-0.4, False), (-0.8, True)):
        costmap.reset_layers()
        see(costmap, ORIGIN, cloud_of((0.0, y)))
        begins = rotate().step(0.0, ORIGIN, costmap, costmap) is not None
        assert begins == is_free


def test_rotation_of_a_robot_that_cannot_turn_ends():
    rotation = rotate()
    seconds = 0.0
    while rotation.step(seconds, ORIGIN, OPEN, OPEN) is not None:
        seconds += 0.05
        assert seconds < 30.0
    # A turn at 1.57 rad/s, and the patience for slow ones
    assert seconds == pytest.approx(recovery.PATIENCE * 2 * math.pi / 1.57, abs=0.1)


@pytest.mark.parametrize("like_cpp", [False, True])
def test_only_in_cpp_may_a_rotation_take_an_hour(like_cpp):
    _, rotation, *_ = recovery.build(complete(JACKAL_PARAMETERS), like_cpp)
    rotation.start(0.0, ORIGIN)
    command = rotation.step(3600.0, ORIGIN, OPEN, OPEN)
    assert (command is not None) is like_cpp


@pytest.mark.parametrize(
    ("granularity", "begins"),
    [
        (0.017, False),
        # At quarter turns, the corners do not point to the obstacle.
        (0.5 * math.pi, True),
    ],
)
def test_sim_granularity_is_the_step_between_the_yaws_that_must_be_free(granularity, begins):
    # Within reach of the corners, at 0.41 m, and not of the sides, at 0.31 and 0.27 m
    costmap = make_costmap()
    see(costmap, ORIGIN, cloud_of((0.0, 0.36)))
    tree = dict(JACKAL_PARAMETERS, rotate_recovery={"sim_granularity": granularity})
    _, rotation, *_ = recovery.build(complete(tree))
    rotation.start(0.0, ORIGIN)
    command = rotation.step(0.0, ORIGIN, costmap, costmap)
    assert (command is not None) is begins


@pytest.mark.parametrize(
    ("last_yaw", "turn"),
    [
        # The turn rate that 1 rad/s^2 brakes within the last 0.2 rad
        (-0.2, math.sqrt(2.0 * 1.0 * 0.2)),
        (-0.02, 0.314),
    ],
)
def test_a_rotation_slows_down_within_its_acceleration_limit_to_the_slowest_turn(last_yaw, turn):
    rotation = rotate(acc_lim_theta=1.0)
    # Past half of the turn, of which a slow cycle sees no yaw: 2.5 and -2.5 rad are 1.28 rad apart.
    for yaw in (0.0, 2.5, -2.5, last_yaw):
        command = rotation.step(0.0, (0.0, 0.0, yaw), OPEN, OPEN)
    assert command == (0.0, pytest.approx(turn))


def test_the_angle_difference_is_the_shorter_way():
    pi = math.pi
    for begin, end, expected in [
        (0, 1, 1),
        (1, 0, -1),
        (3, -3, 2 * pi - 6),  # across the back
        (0, pi, pi),
        (0, -pi, pi),  # half a turn is one to the left
        (10, 10, 0),
    ]:
        difference = recovery.angle_difference(begin, end)
        assert difference == pytest.approx(expected, abs=1e-12), (begin, end)
