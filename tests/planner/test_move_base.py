"""Tests of MoveBase with an ideal robot: goals reached and aborted, recoveries, sensors,
frequencies.
"""

import math

import numpy as np
import pytest

from applr_ros1.planner import state_machine as module
from applr_ros1.planner.move_base import INVALID_GOAL, MoveBase
from applr_ros1.planner.state_machine import Timer
from tests.support.robots import (
    ANGLE_MIN,
    BEAMS,
    INCREMENT,
    SLALOM,
    Scripted,
    ToyRobot,
    quick,
    ring,
    run,
    start,
)


def sealed(tree=None):
    """Return MoveBase and a robot that has observed a closed ring of posts around itself; the goal
    is outside.
    """
    robot = ToyRobot(circles=ring(0.0, 0.0, 0.85, posts=60, size=0.05))
    move_base = MoveBase(tree or quick())
    for yaw in (2.0, 4.0, 0.0):
        robot.pose = (0.0, 0.0, yaw)
        run(move_base, robot, 0.1)
    move_base.set_goal((4.0, 0.0, 0.0), robot.time)
    return move_base, robot


def step(made, robot):
    """Return the cycle of one step with a scan."""
    return made.step(robot.time, robot.pose, robot.twist, robot.scan())


# -- reaching a goal -------------------------------------------------------------------------------
def test_reaches_a_goal_among_obstacles():
    move_base, robot = start((4.0, 0.0, 0.5), ToyRobot(circles=SLALOM))
    cycles = []
    assert run(move_base, robot, 60.0, cycles=cycles) == ("succeeded", "Goal reached.")
    assert math.hypot(robot.pose[0] - 4.0, robot.pose[1]) <= 0.26
    assert abs(robot.pose[2] - 0.5) <= 0.16
    (_, first), (_, last) = cycles[0], cycles[-1]
    assert (first.state, first.new_plan, first.command is not None) == ("controlling", True, True)
    assert (last.command, last.state) == ((0.0, 0.0), "idle")
    commands = np.array([c.command for _, c in cycles if c.command])
    assert commands[:, 0].max() <= 0.5 + 1e-9
    assert np.abs(commands[:, 1]).max() <= 1.57 + 1e-9


def test_idle_publishes_nothing_but_updates_the_maps():
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2)])
    cycle = step(move_base, robot)
    assert cycle.command is None
    assert (cycle.state, cycle.updated) == ("idle", (True, True))
    assert (move_base.local_costmap.cells == 254).any()
    assert (move_base.global_costmap.cells == 254).any()


def test_shutdown_costmaps_stops_map_updates_without_a_goal():
    move_base = MoveBase(quick(shutdown_costmaps=True))
    robot = ToyRobot()
    assert step(move_base, robot).updated == (False, False)
    move_base.set_goal((2.0, 0.0, 0.0), 0.05)
    assert move_base.step(0.05, robot.pose, robot.twist, robot.scan()).updated == (True, True)


# -- aborting a goal -------------------------------------------------------------------------------
@pytest.mark.fault("17")
def test_sealed_goal_tries_every_recovery_in_order_and_aborts():
    move_base, robot = sealed()
    cycles = []
    result = run(move_base, robot, 60.0, cycles=cycles)
    assert result == (
        "aborted",
        "Failed to find a valid plan. Even after executing recovery behaviors.",
    )
    begun = [c.recovery for _, c in cycles if c.recovery]
    names = ["conservative_reset", "rotate_recovery", "aggressive_reset", "rotate_recovery"]
    assert begun == [(number, 4, name) for number, name in enumerate(names)]
    first = next(t for t, c in cycles if c.recovery)
    assert first - 0.3 == pytest.approx(1.0, abs=0.11)  # planner_patience
    turning = [c.command for _, c in cycles if c.state == "clearing" and c.command]
    assert any(w > 1.0 for _, w in turning)
    # A rotation ends with a zero command before anything else happens.
    for (_, a), (_, b) in zip(cycles, cycles[1:]):
        if a.state == "clearing" and b.state != "clearing":
            assert b.command == (0.0, 0.0)
    assert move_base.goal is None
    assert move_base.state == "planning"


@pytest.mark.fault("17a")
def test_a_sealed_goal_is_aborted_if_recovery_rounds_are_limited():
    """Posts enclose the goal, and each reset recovery clears the maps. Without a limit, as in C++,
    this repeats.
    """
    first = {}
    for rounds in (0, 2):
        posts = ring(3.5, 0.0, 0.7, posts=50, size=0.06)
        move_base, robot = start(
            (3.5, 0.0, 0.0), ToyRobot(circles=posts), quick(applr={"recovery_rounds": rounds})
        )
        cycles = []
        result = run(move_base, robot, 60.0, cycles=cycles)
        first[rounds] = sum(c.recovery[0] == 0 for _, c in cycles if c.recovery)
        assert result == (("aborted", module.NO_PATH) if rounds else None)
    assert first[0] > 4
    assert 2 <= first[2] < 5  # One recovery made progress, two did not.


@pytest.mark.fault("17b")
@pytest.mark.parametrize("planner", ["ours", "cpp-like"])
@pytest.mark.parametrize("free", [(-0.1, 0.4), None], ids=["one way is free", "nothing moves"])
def test_a_blocked_robot_tries_escape_motions_and_then_recovers(planner, free):
    move_base = MoveBase(quick(clearing_rotation_allowed=False), planner=planner, seed=0)
    robot = ToyRobot()
    commands = []
    recoveries = []
    run(move_base, robot, 0.1)
    move_base.set_goal((4.0, 0.0, 0.0), robot.time)
    # The planner always backs out.
    move_base.local_planner = Scripted(lambda n: (True, (-0.5, 0.0)))
    result = None
    while robot.time < 20.0 and result is None:
        cycle = step(move_base, robot)
        result = cycle.result
        if cycle.recovery:
            recoveries.append(robot.time)
        command = cycle.command or (0.0, 0.0)
        move_base.report_held(command != (0.0, 0.0) and command != free)
        commands.append((robot.time, command))
        robot.time += 0.05
    if planner == "cpp-like":  # C++ has no such input.
        assert {c for t, c in commands if t > 0.2} == {(-0.5, 0.0)}
        return
    assert {c for t, c in commands if 0.2 < t < 0.6} == {(-0.5, 0.0)}
    assert (0.0, 0.4) in [c for t, c in commands if 0.6 < t < 1.0], (
        "an escape motion starts after half a second"
    )
    assert move_base.local_planner.escapes_ended
    if free:  # The free motion lasts half a second, then the planner takes over again.
        share = sum(c == free for t, c in commands if t < 2.5)
        assert 9 <= share <= 12
    else:
        assert recoveries[0] < 8.0
        assert result == ("aborted", module.NO_CONTROL)


@pytest.mark.fault("17b")
@pytest.mark.parametrize(
    ("watched", "planner"), [(True, "ours"), (False, "ours"), (True, "cpp-like")]
)
def test_a_robot_without_a_command_tries_escape_motions_only_with_a_monitor_and_never_in_cpp(
    watched, planner
):
    move_base = MoveBase(quick(controller_patience=15.0), planner=planner)
    robot = ToyRobot()
    run(move_base, robot, 0.1)
    move_base.set_goal((4.0, 0.0, 0.0), robot.time)
    move_base.local_planner = Scripted(lambda n: (False, (0.0, 0.0)))
    driven = set()
    while robot.time < 4.0:
        command = step(move_base, robot).command
        driven.add(command)
        if watched:
            move_base.report_held(False)
        robot.time += 0.05
    assert ((0.0, 0.4) in driven) == (watched and planner == "ours")


def test_max_planning_retries_counts_and_recoveries_can_be_switched_off():
    move_base, robot = sealed(quick(max_planning_retries=3, recovery_behavior_enabled=False))
    cycles = []
    assert run(move_base, robot, 5.0, cycles=cycles)[0] == "aborted"
    assert not any(c.recovery for _, c in cycles)
    assert sum(c.planned for _, c in cycles) == 4


@pytest.mark.fault("17")
@pytest.mark.parametrize(
    "goal", [(50.0, 0.0, 0.0), (1.5, 0.0, 0.0)], ids=["off the map", "in an obstacle"]
)
def test_goals_that_cannot_be_reached_are_aborted(goal):
    move_base, robot = start(
        goal, ToyRobot(circles=[(1.5, 0.0, 0.1)]), quick(recovery_behavior_enabled=False)
    )
    assert run(move_base, robot, 5.0) == ("aborted", module.NO_PATH)


def test_goals_that_are_not_finite_are_aborted_at_once():
    (made, robot), goal = start((3.0, 0.0, 0.0)), (0, 0, math.nan)
    run(made, robot, 0.5)
    made.set_goal(goal, robot.time)
    cycle = step(made, robot)
    made.set_goal(goal, robot.time)
    again = step(made, robot)
    assert (again.result, again.command) == (cycle.result, None), (
        "nothing was under way: no command, as in C++"
    )
    assert (cycle.result, cycle.command) == (("aborted", INVALID_GOAL), (0.0, 0.0))
    # C++ would keep driving.
    assert made.step(robot.time + 0.05, robot.pose, robot.twist).command is None


@pytest.mark.fault("17")
@pytest.mark.parametrize(
    ("valid", "patience", "text", "late"),
    [  # Planning keeps succeeding at 20 Hz, which in C++ delays the first recovery of an oscillation for long.
        (False, "controller_patience", module.NO_CONTROL, 0.2),
        (True, "oscillation_timeout", module.OSCILLATING, 0.16),
    ],
)
def test_missing_control_and_oscillation_recover_and_abort_with_their_own_texts(
    valid, patience, text, late
):
    move_base, robot = start(
        (3.0, 0.0, 0.0), tree=quick(clearing_rotation_allowed=False, **{patience: 1.0})
    )
    move_base.local_planner = Scripted(lambda n: (valid, (0.0, 0.0)))
    cycles = []
    assert run(move_base, robot, 20.0, cycles=cycles) == ("aborted", text)
    begun = [(t, c.recovery[2]) for t, c in cycles if c.recovery]
    assert [name for _, name in begun] == ["conservative_reset", "aggressive_reset"]
    assert begun[0][0] - 0.1 == pytest.approx(1.0, abs=late)
    assert all(c.command == (0.0, 0.0) for _, c in cycles if c.command)


def test_a_valid_command_starts_the_recoveries_over():
    move_base, robot = start((3.0, 0.0, 0.0))
    move_base.local_planner = Scripted(lambda n: (24 <= n <= 27, (0.0, 0.0)))
    cycles = []
    run(move_base, robot, 20.0, cycles=cycles)
    names = [c.recovery[0] for _, c in cycles if c.recovery]
    assert names[:2] == [0, 1]
    assert names.count(0) == 2


class Wedged(ToyRobot):
    """Robot that ignores its commands and stands still."""

    def drive(self, command, duration):
        super().drive(None, duration)


@pytest.mark.fault("17")
@pytest.mark.parametrize("kind", [ToyRobot, Wedged])
def test_a_start_in_collision_is_left_or_ends_in_recoveries(kind):
    """Two thick posts reach into the outline of the body. One robot can drive away from the posts,
    the other cannot.
    """
    robot = kind(circles=[(0.0, 0.46, 0.3), (0.0, -0.46, 0.3)])
    points = robot.ranges() * np.sin(ANGLE_MIN + INCREMENT * np.arange(BEAMS))
    # Half the width of the footprint.
    assert np.abs(points[np.isfinite(points)]).min() < 0.165
    move_base, robot = start((3.0, 0.0, 0.0), robot, quick(oscillation_timeout=1.0))
    cycles = []
    result = run(move_base, robot, 60.0, cycles=cycles)
    if kind is ToyRobot:
        assert result == ("succeeded", "Goal reached.")
        return
    assert result == ("aborted", module.OSCILLATING)
    begun = [c.recovery[2] for _, c in cycles if c.recovery]
    assert begun == ["conservative_reset", "rotate_recovery", "aggressive_reset", "rotate_recovery"]
    assert move_base.goal is None


# -- cancel, replace -------------------------------------------------------------------------------
def test_cancel_stops_at_the_next_step():
    move_base, robot = start((4.0, 0.0, 0.0))
    run(move_base, robot, 1.0)
    move_base.cancel(robot.time)
    cycle = step(move_base, robot)
    assert (cycle.result, cycle.command, cycle.state) == (("preempted", ""), (0.0, 0.0), "idle")
    assert move_base.step(robot.time + 0.05, robot.pose, robot.twist).command is None


def test_cancel_during_a_rotation_takes_effect_at_once():
    move_base, robot = sealed()
    while not (move_base.state == "clearing" and robot.twist[1] > 1.0):
        robot.drive(step(move_base, robot).command, 0.05)
        assert robot.time < 5.0
    move_base.cancel(robot.time)
    assert move_base.step(robot.time, robot.pose, robot.twist).result == ("preempted", "")


def test_a_new_goal_replaces_the_old_one_without_driving_its_plan():
    move_base, robot = start((4.0, 0.0, 0.0))
    run(move_base, robot, 1.0)
    move_base.set_goal((0.0, 2.0, 0.0), robot.time)
    cycle = step(move_base, robot)
    assert cycle.new_plan
    assert tuple(move_base.global_plan[-1, :2]) == (0.0, 2.0)
    assert run(move_base, robot, 30.0) == ("succeeded", "Goal reached.")
    assert math.hypot(robot.pose[0], robot.pose[1] - 2.0) < 0.3


def test_a_new_goal_begins_with_the_first_recovery():
    (made, robot), begun = sealed(), []
    for goal, last in (((0.0, 4.0, 0.0), 1), ((4.0, 0.0, 0.0), 0)):
        made.set_goal(goal, robot.time)
        begun.clear()
        while last not in begun:
            cycles = []
            run(made, robot, 0.05, cycles=cycles)
            begun += [cycle.recovery[0] for _, cycle in cycles if cycle.recovery]
            assert robot.time < 20.0
    assert begun == [0]


def test_a_cancelled_goal_does_not_cancel_the_next():
    move_base, robot = start((4.0, 0.0, 0.0))
    move_base.cancel(robot.time)
    move_base.set_goal((1.0, 0.0, 0.0), robot.time)
    assert run(move_base, robot, 20.0) == ("succeeded", "Goal reached.")


# -- sensors ---------------------------------------------------------------------------------------
def test_the_robot_stops_after_a_second_without_scans_and_resumes_with_them():
    move_base, robot = start((4.0, 0.0, 0.0))
    run(move_base, robot, 1.0)
    assert robot.twist[0] > 0.3
    cycles = []
    run(move_base, robot, 2.0, scans=False, cycles=cycles)
    stale = [t for t, c in cycles if c.stale]
    assert stale[0] - cycles[0][0] == pytest.approx(0.95, abs=0.11)
    assert all(c.command == (0.0, 0.0) for t, c in cycles if t >= stale[0])
    assert run(move_base, robot, 20.0) == ("succeeded", "Goal reached.")


def test_the_robot_stops_without_a_pose():
    move_base, robot = start((4.0, 0.0, 0.0))
    run(move_base, robot, 1.0)
    cycle = move_base.step(robot.time, None, robot.twist, robot.scan())
    assert (cycle.command, cycle.updated) == ((0.0, 0.0), (False, False))
    robot.time += 0.05
    assert run(move_base, robot, 20.0) == ("succeeded", "Goal reached.")


# -- frequencies -----------------------------------------------------------------------------------
@pytest.mark.parametrize(("planner", "expected"), [(20.0, 40), (4.0, 8), (0.0, 1)])
def test_plans_are_made_at_planner_frequency(planner, expected):
    move_base, robot = start((4.0, 0.0, 0.0), tree=quick(planner_frequency=planner))
    cycles = []
    run(move_base, robot, 2.0, cycles=cycles)
    assert abs(sum(c.planned for _, c in cycles) - expected) <= 1


def test_cycles_and_costmap_updates_have_their_frequencies():
    hertz = 5.0
    tree = quick(controller_frequency=hertz)
    tree["local_costmap"]["update_frequency"] = hertz
    move_base, robot = start((4.0, 0.0, 0.0), tree=tree)
    cycles = []
    run(move_base, robot, 2.0, cycles=cycles)
    assert abs(sum(c.controlled for _, c in cycles) - 2 * hertz) <= 1
    assert abs(sum(c.updated[0] for _, c in cycles) - 2 * hertz) <= 1
    assert sum(c.updated[1] for _, c in cycles) == 40


def test_timer_keeps_its_phase_tolerates_jitter_and_restarts():
    timer = Timer()
    timer.set_frequency(20.0)
    assert [timer.due(t) for t in (0.0, 0.02, 0.049, 0.05, 0.101, 0.149)] == [
        True,
        False,
        True,
        False,
        True,
        True,
    ]
    assert timer.due(10.0)
    assert not timer.due(10.02)
    assert timer.due(10.05)
    assert timer.due(1.0)
    assert not timer.due(1.02)
    timer.set_frequency(0.0)
    assert not timer.due(2.0)
