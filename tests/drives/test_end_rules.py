"""Tests of the rules that end a course, on control cycles made of numbers."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.drives.drive import ABORTED, FLIPPED, REACHED, STALLED, TIMED_OUT, TOUCHED
from applr_ros1.drives.end_rules import Destination, Rules
from applr_ros1.planner.state_machine import Cycle
from applr_ros1.stack.simulated import Tick
from applr_ros1.stack.stack import Step
from sim_bridge.simulator import RobotState
from worlds import Course

# A course without a finish of its own ends where the planner arrives.
COURSE = Course(
    start=(0.0, 0.0, 0.0),
    goal=(4.0, 0.0, 0.0),
    finish_y=None,
    goal_tolerance=-1.0,
    path=np.array([(0.0, 0.0), (4.0, 0.0)]),
    planner_ends=True,
)
DESTINATION = Destination(COURSE, goal=COURSE.goal, tolerance=0.25)


def tick(x, result=None, **state):
    """Return a control cycle at whose end the robot is at x [m] on the course."""
    place = (x, 0.0, 0.0)
    after = replace(RobotState(pose=place), **state)
    step = Step(Cycle(result=result), verdict=None, command=None)
    return Tick(RobotState(), scan=None, step=step, after=after, place=place, planner_pose=place)


def status(ruling):
    """Return the status of a ruling, or None if the course goes on."""
    return ruling and ruling.status


@pytest.mark.parametrize(
    ("rules", "last_tick", "expected"),
    [
        (Rules(), tick(1.0), None),
        (Rules(), tick(3.8), REACHED),
        # The robot has still to turn to the goal's heading.
        (Rules(ends_at_tolerance=False), tick(3.8), None),
        (Rules(ends_at_tolerance=False), tick(3.8, ("succeeded", "")), REACHED),
        (Rules(), tick(1.0, flipped=True), FLIPPED),
        (Rules(), tick(3.8, flipped=True), REACHED),
        (Rules(), tick(1.0, contact=True), None),
        (Rules(end_on_contact=True), tick(1.0, contact=True), TOUCHED),
        # A robot that falls touches the ground, too.
        (Rules(end_on_contact=True), tick(1.0, flipped=True, contact=True), FLIPPED),
        # After a result away from the goal the robot would only stand.
        (Rules(), tick(1.0, ("aborted", "no plan")), ABORTED),
        (Rules(end_on_contact=True), tick(1.0, ("aborted", "no plan"), contact=True), TOUCHED),
    ],
)
def test_a_control_cycle_ends_a_course_by_the_rules(rules, last_tick, expected):
    assert status(rules.judge(last_tick, DESTINATION)) == expected


def test_a_period_ends_a_course_at_a_stall_or_the_limit_rounded_to_whole_periods():
    rules = Rules(limit=7.0)
    assert [rules.periods(period) for period in (1.0, 2.0, 3.0, 30.0)] == [7, 4, 2, 1]
    assert rules.judge_period(2.0, period_count=3, has_stalled=True) is None
    assert status(rules.judge_period(2.0, period_count=4, has_stalled=False)) == TIMED_OUT
    rules = Rules(limit=7.0, end_on_stall=True)
    assert status(rules.judge_period(2.0, period_count=4, has_stalled=True)) == STALLED
