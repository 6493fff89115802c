"""Tests of the stack with a stub of move_base."""

from dataclasses import replace

import pytest

from applr_ros1.planner.state_machine import Cycle
from applr_ros1.robots import JACKAL
from applr_ros1.stack.stack import Stack
from tests.support.robots import ToyRobot
from tests.support.scenes import straight

STOP = (0.0, 0.0)
GOAL = (5.0, 0.0, 0.0)


class StandingPlanner:
    """Stub of a C++-like move_base that plans in each cycle and commands zero.

    With a failing plan, it keeps the last one.
    """

    goal = GOAL
    goal_tolerance = 0.25
    global_frame = "odom"
    global_plan = straight(5.0)
    parameters = {"applr": {"movers": False}}
    variant = "cpp-like"

    def __init__(self, finds_plan):
        self.finds_plan = finds_plan

    def set_goal(self, goal, now):
        pass

    def step(self, now, pose, twist, sensed, local_origin):
        return Cycle(command=STOP, planned=True, new_plan=self.finds_plan)


@pytest.mark.parametrize("finds_plan", [True, False])
def test_a_standing_cpp_like_planner_gets_escape_motions_only_if_it_finds_plans(finds_plan):
    stack = Stack(JACKAL, StandingPlanner(finds_plan), monitor=True)
    robot = ToyRobot()
    scan = robot.scan()
    stack.set_goal(GOAL, 0.0)
    commands = []
    # After 2 s the motions begin with those into unobserved space, of which the monitor lets none
    # pass.
    for number in range(60):
        now = 0.05 * number
        step = stack.step(now, robot.pose, robot.twist, replace(scan, stamp=now))
        commands.append(step.command)
    assert set(commands[:40]) == {STOP}
    moves = commands[-1] != STOP
    assert moves is finds_plan
