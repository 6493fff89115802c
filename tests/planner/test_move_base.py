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

STOP = (0.0, 0.0)
GOAL = (4.0, 0.0, 0.0)  # goal straight ahead
REACHED = ("succeeded", "Goal reached.")
# Default recoveries of move_base.cpp, in its order.
ALL_RECOVERIES = ["conservative_reset", "rotate_recovery", "aggressive_reset", "rotate_recovery"]


def sealed(tree=None):
    """Return MoveBase and a robot that has observed a closed ring of posts around itself; the goal
    is outside.
    """
    robot = ToyRobot(circles=ring(0.0, 0.0, 0.85, posts=60, size=0.05))
    move_base = MoveBase(tree or quick())
    # The laser does not see behind the robot: three headings close the ring in the costmaps.
    for yaw in (2.0, 4.0, 0.0):
        robot.pose = (0.0, 0.0, yaw)
        run(move_base, robot, 0.1)
    move_base.set_goal(GOAL, robot.time)
    return move_base, robot


def step(move_base, robot):
    """Return the cycle of one step with a scan."""
    return move_base.step(robot.time, robot.pose, robot.twist, robot.scan())


def recoveries(cycles):
    """Return [(time, (number, count, name))] of the recovery behaviours that began."""
    return [(time, cycle.recovery) for time, cycle in cycles if cycle.recovery]


def recovery_names(cycles):
    """Return the names of the recovery behaviours that began."""
    return [name for _, (_, _, name) in recoveries(cycles)]


def commands_of(cycles):
    """Return the commands (v, w) of the cycles that have one."""
    return [cycle.command for _, cycle in cycles if cycle.command]


def count(cycles, name):
    """Return the number of cycles of which an attribute is true."""
    return sum(bool(getattr(cycle, name)) for _, cycle in cycles)


# -- reaching a goal -------------------------------------------------------------------------------
def test_reaches_a_goal_among_obstacles():
    move_base, robot = start((4.0, 0.0, 0.5), ToyRobot(circles=SLALOM))
    cycles = []
    assert run(move_base, robot, 60.0, cycles=cycles) == REACHED
    # The Jackal's tolerances of 0.25 m and 0.157 rad.
    x, y, yaw = robot.pose
    assert math.hypot(x - 4.0, y) <= 0.26
    assert abs(yaw - 0.5) <= 0.16
    _, first_cycle = cycles[0]
    assert first_cycle.state == "controlling"
    assert first_cycle.new_plan
    assert first_cycle.command is not None
    _, last_cycle = cycles[-1]
    assert last_cycle.command == STOP
    assert last_cycle.state == "idle"
    # No command is beyond max_vel_x and max_vel_theta.
    v, w = np.transpose(commands_of(cycles))
    assert v.max() <= 0.5 + 1e-9
    assert np.abs(w).max() <= 1.57 + 1e-9


def test_idle_publishes_nothing_but_updates_the_maps():
    move_base = MoveBase(quick())
    robot = ToyRobot(circles=[(1.5, 0.0, 0.2)])
    cycle = step(move_base, robot)
    assert cycle.command is None
    assert cycle.state == "idle"
    assert cycle.updated == (True, True)
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
    reason = "Failed to find a valid plan. Even after executing recovery behaviors."
    assert result == ("aborted", reason)
    begins = recoveries(cycles)
    assert [recovery for _, recovery in begins] == [
        (0, 4, "conservative_reset"),
        (1, 4, "rotate_recovery"),
        (2, 4, "aggressive_reset"),
        (3, 4, "rotate_recovery"),
    ]
    # planner_patience is 1 s, from the goal at 0.3 s on.
    first_time, _ = begins[0]
    assert first_time - 0.3 == pytest.approx(1.0, abs=0.11)

    # Rotations turn, and end with a zero command before anything else happens.
    clearing = [(time, cycle) for time, cycle in cycles if cycle.state == "clearing"]
    assert max(w for _, w in commands_of(clearing)) > 1.0
    for (_, cycle), (_, following) in zip(cycles, cycles[1:]):
        if cycle.state == "clearing" and following.state != "clearing":
            assert following.command == STOP
    assert move_base.goal is None
    assert move_base.state == "planning"


def to_an_enclosed_goal(recovery_rounds):
    """Return the result of a drive to a goal among posts, and how often the recoveries began."""
    posts = ring(3.5, 0.0, 0.7, posts=50, size=0.06)
    tree = quick(applr={"recovery_rounds": recovery_rounds})
    move_base, robot = start((3.5, 0.0, 0.0), ToyRobot(circles=posts), tree)
    cycles = []
    result = run(move_base, robot, 60.0, cycles=cycles)
    return result, recovery_names(cycles).count("conservative_reset")


@pytest.mark.heavy
@pytest.mark.fault("17a")
def test_a_sealed_goal_is_aborted_if_recovery_rounds_are_limited():
    """Each reset recovery clears the maps. Without a limit, as in C++, this repeats."""
    result, begun_count = to_an_enclosed_goal(recovery_rounds=0)
    # The drive's 60 s were over first.
    assert result is None
    # Each time the recoveries begin anew with the first one.
    assert begun_count > 4

    result, begun_count = to_an_enclosed_goal(recovery_rounds=2)
    assert result == ("aborted", module.NO_PATH)
    # One recovery made progress, two did not.
    assert 2 <= begun_count < 5


@pytest.mark.fault("17b")
@pytest.mark.parametrize("planner", ["ours", "cpp-like"])
@pytest.mark.parametrize(
    "free",
    [(-0.1, 0.4), None],
    ids=["one way is free", "nothing moves"],
)
def test_a_blocked_robot_tries_escape_motions_and_then_recovers(planner, free):
    # Given: a planner that always backs out, and a monitor that lets pass `free` alone
    backwards = (-0.5, 0.0)
    move_base = MoveBase(quick(clearing_rotation_allowed=False), planner=planner, seed=0)
    robot = ToyRobot()
    run(move_base, robot, 0.1)
    move_base.set_goal(GOAL, robot.time)
    move_base.local_planner = Scripted(lambda n: (True, backwards))

    # When: it drives until the goal ends
    commands = []
    cycles = []
    result = None
    while robot.time < 20.0 and result is None:
        cycle = step(move_base, robot)
        result = cycle.result
        command = cycle.command or STOP
        if robot.time < 0.6:
            assert not move_base.local_planner.escapes_ended
        move_base.report_held(command not in (STOP, free))
        cycles.append((robot.time, cycle))
        commands.append((robot.time, command))
        robot.time += 0.05

    def commands_within(begin, end):
        """Return the distinct commands between two times [s]."""
        return {command for time, command in commands if begin < time < end}

    # Then: C++ has no such input, and this planner tries an escape motion after half a second
    if planner == "cpp-like":
        assert commands_within(0.2, 20.0) == {backwards}
        return
    assert commands_within(0.2, 0.6) == {backwards}
    assert (0.0, 0.4) in commands_within(0.6, 1.0)
    assert move_base.local_planner.escapes_ended
    if free:
        # The free motion lasts half a second, then the planner takes over again.
        free_count = sum(command == free for time, command in commands if time < 2.5)
        assert 9 <= free_count <= 12
    else:
        first_time, _ = recoveries(cycles)[0]
        assert first_time < 8.0
        assert result == ("aborted", module.NO_CONTROL)


@pytest.mark.fault("17b")
@pytest.mark.parametrize(
    ("watched", "planner"),
    [
        (True, "ours"),
        (False, "ours"),
        (True, "cpp-like"),
    ],
)
def test_a_robot_without_a_command_tries_escape_motions_only_with_a_monitor_and_never_in_cpp(
    watched, planner
):
    # A patience longer than the 4 s here, so that no recovery interferes.
    move_base = MoveBase(quick(controller_patience=15.0), planner=planner)
    robot = ToyRobot()
    run(move_base, robot, 0.1)
    move_base.set_goal(GOAL, robot.time)
    move_base.local_planner = Scripted(lambda n: (False, STOP))
    commands = set()
    while robot.time < 4.0:
        commands.add(step(move_base, robot).command)
        if watched:
            move_base.report_held(False)
        robot.time += 0.05
    assert ((0.0, 0.4) in commands) == (watched and planner == "ours")


@pytest.mark.fault("17")
@pytest.mark.parametrize(
    "goal",
    [(50.0, 0.0, 0.0), (1.5, 0.0, 0.0)],
    ids=["off the map", "in an obstacle"],
)
def test_goals_that_cannot_be_reached_are_aborted(goal):
    move_base, robot = start(
        goal, ToyRobot(circles=[(1.5, 0.0, 0.1)]), quick(recovery_behavior_enabled=False)
    )
    assert run(move_base, robot, 5.0) == ("aborted", module.NO_PATH)


def test_goals_that_are_not_finite_are_aborted_at_once():
    goal = (0, 0, math.nan)
    move_base, robot = start((3.0, 0.0, 0.0))
    run(move_base, robot, 0.5)
    move_base.set_goal(goal, robot.time)
    cycle = step(move_base, robot)
    assert cycle.result == ("aborted", INVALID_GOAL)
    assert cycle.command == STOP
    # If nothing was under way, there is no command, as in C++.
    move_base.set_goal(goal, robot.time)
    second_cycle = step(move_base, robot)
    assert second_cycle.result == cycle.result
    assert second_cycle.command is None
    # C++ would keep driving.
    assert move_base.step(robot.time + 0.05, robot.pose, robot.twist).command is None


def test_a_valid_command_starts_the_recoveries_over():
    move_base, robot = start((3.0, 0.0, 0.0))
    # Calls 24 to 27 have a command: after the first two recoveries, and before the third.
    move_base.local_planner = Scripted(lambda n: (24 <= n <= 27, STOP))
    cycles = []
    run(move_base, robot, 20.0, cycles=cycles)
    names = recovery_names(cycles)
    assert names[:2] == ALL_RECOVERIES[:2]
    assert names.count("conservative_reset") == 2


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
    angles = ANGLE_MIN + INCREMENT * np.arange(BEAMS)
    lateral_offsets = np.abs(robot.ranges() * np.sin(angles))
    # Half the width of the footprint. Beams without a return are infinite.
    assert lateral_offsets.min() < 0.165
    move_base, robot = start((3.0, 0.0, 0.0), robot, quick(oscillation_timeout=1.0))
    cycles = []
    result = run(move_base, robot, 60.0, cycles=cycles)
    if kind is ToyRobot:
        assert result == REACHED
        return
    assert result == ("aborted", module.OSCILLATING)
    assert recovery_names(cycles) == ALL_RECOVERIES
    assert move_base.goal is None


# -- cancel, replace -------------------------------------------------------------------------------
def test_cancel_stops_at_the_next_step():
    move_base, robot = start(GOAL)
    run(move_base, robot, 1.0)
    move_base.cancel()
    cycle = step(move_base, robot)
    assert cycle.result == ("preempted", "")
    assert cycle.command == STOP
    assert cycle.state == "idle"
    assert move_base.step(robot.time + 0.05, robot.pose, robot.twist).command is None


def rotating():
    """Return MoveBase and robot while a recovery turns, which would last for another half turn."""
    move_base, robot = sealed()
    while not (move_base.state == "clearing" and robot.twist[1] > 1.0):
        robot.drive(step(move_base, robot).command, 0.05)
        assert robot.time < 5.0
    return move_base, robot


def test_cancel_during_a_rotation_takes_effect_at_once():
    move_base, robot = rotating()
    move_base.cancel()
    assert move_base.step(robot.time, robot.pose, robot.twist).result == ("preempted", "")


def test_a_goal_that_replaces_another_during_a_rotation_stops_the_base():
    move_base, robot = rotating()
    move_base.set_goal((41.0, 0.0, 0.0), robot.time)
    assert step(move_base, robot).command == STOP


def test_a_new_goal_replaces_the_old_one_without_driving_its_plan():
    move_base, robot = start(GOAL)
    run(move_base, robot, 1.0)
    move_base.set_goal((0.0, 2.0, 0.0), robot.time)
    cycle = step(move_base, robot)
    assert cycle.new_plan
    assert tuple(move_base.global_plan[-1, :2]) == (0.0, 2.0)
    assert run(move_base, robot, 30.0) == REACHED
    x, y, _ = robot.pose
    assert math.hypot(x, y - 2.0) < 0.3


def test_a_new_goal_begins_with_the_first_recovery():
    # Given: a goal whose second recovery has begun
    move_base, robot = sealed()
    move_base.set_goal((0.0, 4.0, 0.0), robot.time)
    cycles = []
    while len(recoveries(cycles)) < 2:
        run(move_base, robot, 0.05, cycles=cycles)
        assert robot.time < 20.0

    # When: another goal comes
    move_base.set_goal(GOAL, robot.time)
    cycles = []
    while not recoveries(cycles):
        run(move_base, robot, 0.05, cycles=cycles)
        assert robot.time < 20.0

    # Then: it begins with the first recovery
    assert recovery_names(cycles) == ALL_RECOVERIES[:1]


def test_a_cancelled_goal_does_not_cancel_the_next():
    move_base, robot = start(GOAL)
    # The cancellation is noticed at the next step only, when another goal is there.
    move_base.cancel()
    move_base.set_goal((1.0, 0.0, 0.0), robot.time)
    assert run(move_base, robot, 20.0) == REACHED


# -- sensors ---------------------------------------------------------------------------------------
def test_the_robot_stops_after_a_second_without_scans_and_resumes_with_them():
    move_base, robot = start(GOAL)
    run(move_base, robot, 1.0)
    assert robot.twist[0] > 0.3
    cycles = []
    run(move_base, robot, 2.0, scans=False, cycles=cycles)
    first_time, _ = cycles[0]
    stale_cycles = [(time, cycle) for time, cycle in cycles if cycle.stale]
    stale_time, _ = stale_cycles[0]
    # The last scan came one cycle of 0.05 s before the first one without.
    assert stale_time - first_time == pytest.approx(0.95, abs=0.11)
    stale_commands = [cycle.command for time, cycle in cycles if time >= stale_time]
    assert set(stale_commands) == {STOP}
    assert run(move_base, robot, 20.0) == REACHED


def test_the_robot_stops_without_a_pose():
    move_base, robot = start(GOAL)
    run(move_base, robot, 1.0)
    cycle = move_base.step(robot.time, None, robot.twist, robot.scan())
    assert cycle.command == STOP
    assert cycle.updated == (False, False)
    robot.time += 0.05
    assert run(move_base, robot, 20.0) == REACHED


# -- frequencies -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("frequency", "plan_count"),
    [
        (20.0, 40),
        (4.0, 8),
        (0.0, 1),  # one plan for each goal
    ],
)
def test_plans_are_made_at_planner_frequency(frequency, plan_count):
    move_base, robot = start(GOAL, tree=quick(planner_frequency=frequency))
    cycles = []
    run(move_base, robot, 2.0, cycles=cycles)
    assert abs(count(cycles, "planned") - plan_count) <= 1


def test_cycles_and_costmap_updates_have_their_frequencies():
    hertz = 5.0
    tree = quick(controller_frequency=hertz)
    tree["local_costmap"]["update_frequency"] = hertz
    move_base, robot = start(GOAL, tree=tree)
    cycles = []
    run(move_base, robot, 2.0, cycles=cycles)
    updates = [cycle.updated for _, cycle in cycles]
    local_updates, global_updates = np.sum(updates, axis=0)
    assert abs(count(cycles, "controlled") - 2 * hertz) <= 1
    assert abs(local_updates - 2 * hertz) <= 1
    assert global_updates == 40


def test_timer_keeps_its_phase_tolerates_jitter_and_restarts():
    timer = Timer()
    timer.set_frequency(20.0)
    assert timer.due(0.0)
    assert not timer.due(0.02)
    # A cycle that is a little early counts for its own time, so that jitter loses none.
    assert timer.due(0.049)
    assert not timer.due(0.05)
    assert timer.due(0.101)
    # The phase is that of the first call: 0.101 does not shift it.
    assert timer.due(0.149)
    # A gap, and a clock that jumps back
    assert timer.due(10.0)
    assert not timer.due(10.02)
    assert timer.due(10.05)
    assert timer.due(1.0)
    assert not timer.due(1.02)
    timer.set_frequency(0.0)
    assert not timer.due(2.0)
