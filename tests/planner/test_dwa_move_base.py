"""Tests of MoveBase with DWAPlannerROS: goals, parameters, and a drive through a generated
course.
"""

import math

from applr_ros1.planner.move_base import MoveBase
from tests.support.robots import ToyRobot, dwa_parameters, run, start

DWA = "DWAPlannerROS"


def test_success_is_reported_at_every_planner_frequency():
    """In C++, a new plan clears no flag of this planner, so "cpp-like" and "ours" both succeed at
    once at the goal.
    """
    for planner in ("ours", "cpp-like"):
        move_base = MoveBase(dwa_parameters(), planner=planner)
        robot = ToyRobot()
        move_base.set_goal((1.0, 0.0, 0.0), 0.0)
        assert run(move_base, robot, 10.0) == ("succeeded", "Goal reached.")
        assert robot.time < 6.0


def test_the_latch_is_read_from_the_namespace_of_move_base():
    """As in C++, latch_xy_goal_tolerance in the section DWAPlannerROS of TurtleBot3's file has no
    effect.
    """
    for of_move_base, of_planner in ((True, False), (False, True)):
        tree = dwa_parameters(latch_xy_goal_tolerance=of_move_base, planner_frequency=0.0)
        tree[DWA]["latch_xy_goal_tolerance"] = of_planner
        move_base, robot = start((1.0, 0.0, 2.0), tree=tree)
        while math.hypot(robot.pose[0] - 1.0, robot.pose[1]) > 0.25:
            assert run(move_base, robot, 0.05) is None
        run(move_base, robot, 0.1)
        # The robot is pushed out of the tolerance.
        robot.pose = (0.7, 0.0, 0.0)
        robot.twist = (0.0, 0.0)
        run(move_base, robot, 0.1)
        assert (robot.twist[0] == 0.0) is of_move_base
