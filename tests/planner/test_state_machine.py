"""Tests of the state machine with stubs in place of maps and planners: how long it waits before a
recovery, and which recovery comes.
"""

import math

import numpy as np
import pytest

from applr_ros1.planner.state_machine import NO_PLAN, Components, Cycle, CycleInput, StateMachine
from tests.support.robots import Scripted

CYCLE_S = 0.05  # time between two cycles [s]
STOP = (0.0, 0.0)
TURN = (0.0, 1.0)
NO_COMMAND = (False, STOP)
GOAL = (10.0, 0.0, 0.0)
PLAN = np.array([(0.0, 0.0, 0.0), GOAL])
LATE = 3 * CYCLE_S  # a due recovery is noticed in one cycle, and begins in the next


class Recovery:
    """Recovery stub that turns for a number of cycles, and notes the poses that it gets."""

    def __init__(self, name, turn_count=0):
        self.name = name
        self.turn_count = turn_count
        self.poses = []

    def start(self, now, pose):
        pass

    def step(self, now, pose, local_costmap, global_costmap, global_pose):
        self.poses.append(pose)
        return TURN if len(self.poses) <= self.turn_count else None


class Drive:
    """Drive at 20 Hz whose plans, commands and poses the test sets. At first the robot stands at
    the origin with a plan and with valid commands.
    """

    def __init__(self, *recoveries, begin=0.0, recovery_rounds=0, **settings):
        self.plan = PLAN
        self.answer = (True, STOP)
        self.pose = (0.0, 0.0, 0.0)
        self.begin = begin
        self.cycle_count = 0
        self.settings = {
            "planner_frequency": 20.0,
            "planner_patience": 1.0,
            "controller_patience": 1.0,
            "max_planning_retries": -1,
            "recovery_behavior_enabled": True,
            "oscillation_timeout": 0.0,
            "oscillation_distance": 0.5,
            **settings,
        }
        components = Components(
            local_planner=Scripted(lambda n: self.answer),
            local_costmap=None,
            global_costmap=None,
            recoveries=recoveries,
            plan=lambda start, goal: self.plan,
            recovery_rounds=recovery_rounds,
        )
        self.machine = StateMachine(components)
        self.machine.set_frequencies(planner=20.0, controller=20.0)

    @property
    def time(self):
        return self.begin + CYCLE_S * self.cycle_count

    def step(self):
        """Return the next cycle."""
        cycle = Cycle()
        inputs = CycleInput(
            time=self.time,
            local_pose=self.pose,
            global_pose=self.pose,
            local_origin=None,
            twist=STOP,
            settings=self.settings,
            scan_is_stale=False,
        )
        self.machine.step(inputs, cycle)
        self.cycle_count += 1
        return cycle

    def run(self, seconds):
        """Return the cycles of some seconds."""
        return [self.step() for _ in range(round(seconds / CYCLE_S))]

    def next_recovery(self):
        """Return the name of the next recovery, and the time [s] until it begins."""
        begin = self.time
        for _ in range(round(10.0 / CYCLE_S)):
            now = self.time
            cycle = self.step()
            assert cycle.result is None
            if cycle.recovery:
                _, _, name = cycle.recovery
                return name, now - begin
        return None, math.inf


def begun(*recoveries, **settings):
    """Return a drive with a goal 10 m ahead."""
    drive = Drive(*recoveries, **settings)
    drive.machine.set_goal(GOAL, drive.time)
    return drive


# -- goals and requests ----------------------------------------------------------------------------
def test_a_valid_goal_after_a_refused_one_is_driven():
    drive = Drive()
    drive.machine.refuse_goal("not finite")
    drive.machine.set_goal(GOAL, drive.time)
    drive.answer = (True, TURN)
    cycles = drive.run(0.2)
    assert [cycle.result for cycle in cycles] == [None] * 4
    assert cycles[-1].command == TURN


def test_a_cancellation_without_a_goal_neither_stops_the_base_nor_has_a_result():
    drive = Drive()
    drive.machine.cancel()
    assert drive.step() == Cycle()


# -- patience --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("patience", "answer"),
    [
        ("controller_patience", NO_COMMAND),
        ("oscillation_timeout", (True, STOP)),
    ],
)
def test_patience_begins_with_the_goal_however_long_the_robot_was_idle(patience, answer):
    drive = begun(Recovery("reset"), begin=100.0, **{patience: 1.0})
    drive.answer = answer
    _, waited = drive.next_recovery()
    assert 1.0 < waited <= 1.0 + LATE


@pytest.mark.parametrize(
    ("plan", "settings"),
    [
        (NO_PLAN, {"planner_patience": 1.0}),
        (PLAN, {"oscillation_timeout": 1.0}),
    ],
    ids=["no plan", "oscillation"],
)
def test_patience_begins_anew_after_a_recovery(plan, settings):
    drive = begun(Recovery("reset"), Recovery("turn"), **settings)
    drive.plan = plan
    drive.next_recovery()
    name, waited = drive.next_recovery()
    assert name == "turn"
    assert 0.9 < waited <= 1.0 + LATE


def test_a_planner_has_its_whole_patience_after_a_lost_command():
    drive = begun(Recovery("reset"), planner_patience=1.0, controller_patience=9.0)
    drive.run(5.0)
    drive.plan = NO_PLAN
    drive.answer = NO_COMMAND
    _, waited = drive.next_recovery()
    assert 1.0 < waited <= 1.0 + LATE


def test_without_retries_the_first_failed_plan_leads_to_a_recovery():
    drive = begun(Recovery("reset"), max_planning_retries=0, planner_patience=9.0)
    drive.plan = NO_PLAN
    cycle = drive.step()
    assert cycle.planned
    assert cycle.recovery == (0, 1, "reset")


# -- oscillation -----------------------------------------------------------------------------------
def test_a_robot_that_gets_on_does_not_oscillate_until_it_stands():
    drive = begun(Recovery("reset"), oscillation_timeout=1.0, oscillation_distance=0.5)
    # By exactly 0.5 m at a time, in less than the timeout
    for x in (0.5, 1.0, 1.5, 2.0):
        drive.pose = (x, 0.0, 0.0)
        cycles = drive.run(0.9)
        assert not any(cycle.recovery for cycle in cycles)
    # The place to get away from is the last one, not the first one 2 m behind.
    _, waited = drive.next_recovery()
    assert waited == pytest.approx(0.1, abs=LATE)


def test_a_robot_that_gets_away_begins_with_the_first_recovery_again():
    recoveries = Recovery("reset"), Recovery("turn"), Recovery("wide reset")
    drive = begun(*recoveries, oscillation_timeout=1.0, oscillation_distance=0.5)
    names = [drive.next_recovery()[0], drive.next_recovery()[0]]
    drive.pose = (0.5, 0.0, 0.0)
    names.append(drive.next_recovery()[0])
    assert names == ["reset", "turn", "reset"]


# -- recoveries ------------------------------------------------------------------------------------
def recoveries_until_the_goal_is_given_up(drive, x):
    """Return how many recoveries begin. After each one, the robot finds a plan, and then neither a
    command nor another plan. The first recovery gets it to x [m].
    """
    drive.plan = NO_PLAN
    drive.answer = NO_COMMAND
    recovery_count = 0
    cycle = drive.step()
    while cycle.result is None:
        assert drive.time < 20.0
        cycle = drive.step()
        if cycle.new_plan:
            drive.plan = NO_PLAN
        if cycle.recovery:
            recovery_count += 1
            drive.plan = PLAN
            drive.pose = (x, 0.0, 0.0)
    return recovery_count


@pytest.mark.parametrize(
    ("x", "begun_count"),
    [
        (0.0, 2),
        (0.4, 2),
        (0.5, 3),
    ],
)
def test_recovery_rounds_are_counted_anew_half_a_metre_nearer_to_the_goal(x, begun_count):
    drive = begun(Recovery("reset"), recovery_rounds=2, controller_patience=99.0)
    # The goal is given up after two recoveries that have brought the robot no nearer.
    assert recoveries_until_the_goal_is_given_up(drive, x) == begun_count


def test_an_earlier_goal_that_was_nearer_does_not_count_in_the_rounds_of_the_next_one():
    drive = Drive(Recovery("reset"), recovery_rounds=1, controller_patience=99.0)
    drive.machine.set_goal((2.0, 0.0, 0.0), drive.time)
    assert recoveries_until_the_goal_is_given_up(drive, 0.0) == 1
    # 9.5 m are farther than 2 m, and half a metre nearer to this goal.
    drive.machine.set_goal(GOAL, drive.time)
    assert recoveries_until_the_goal_is_given_up(drive, 0.5) == 2


def test_a_robot_that_loses_its_pose_in_a_recovery_stands_until_it_knows_it_again():
    recovery = Recovery("turn", turn_count=3)
    drive = begun(recovery, max_planning_retries=0)
    drive.plan = NO_PLAN
    known_pose = drive.pose
    commands = []
    for pose in (known_pose, None, None, known_pose, known_pose):
        drive.pose = pose
        commands.append(drive.step().command)
    assert commands == [TURN, STOP, STOP, TURN, TURN]
    assert recovery.poses == [known_pose] * 3
