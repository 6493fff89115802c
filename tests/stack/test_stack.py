"""Tests of the stack with a stub of move_base."""

from dataclasses import replace

import pytest

from applr_ros1.robots import JACKAL
from applr_ros1.stack.stack import Stack
from tests.support.robots import FakeMoveBase, ToyRobot

STOP = (0.0, 0.0)
GOAL = (5.0, 0.0, 0.0)


def stack_of_standing_planner(finds_plan):
    """Return a stack whose C++-like planner commands zero."""
    planner = FakeMoveBase(STOP, variant="cpp-like", finds_plan=finds_plan)
    return Stack(JACKAL, planner, monitor=True)


def commands_of(stack, first_cycle, end_cycle):
    """Return the commands of a standing robot in some cycles of 0.05 s."""
    robot = ToyRobot()
    scan = robot.scan()
    commands = []
    for number in range(first_cycle, end_cycle):
        now = 0.05 * number
        step = stack.step(now, robot.pose, robot.twist, replace(scan, stamp=now))
        commands.append(step.command)
    return commands


@pytest.mark.parametrize("finds_plan", [True, False])
def test_a_standing_cpp_like_planner_gets_escape_motions_only_if_it_finds_plans(finds_plan):
    stack = stack_of_standing_planner(finds_plan)
    stack.set_goal(GOAL, 0.0)
    # After 2 s the motions begin with those into unobserved space, of which the monitor lets none
    # pass.
    commands = commands_of(stack, 0, 60)
    assert set(commands[:40]) == {STOP}
    moves = commands[-1] != STOP
    assert moves is finds_plan


def test_a_goal_that_is_sent_again_has_its_whole_patience():
    stack = stack_of_standing_planner(finds_plan=True)
    stack.set_goal(GOAL, 0.0)
    assert set(commands_of(stack, 0, 38)) == {STOP}
    # 0.1 s before the motions would begin
    stack.set_goal(GOAL, 1.9)
    commands = commands_of(stack, 38, 98)
    assert set(commands[:40]) == {STOP}
    assert commands[-1] != STOP
