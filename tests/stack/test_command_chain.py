"""Tests of when the escape motions for a standing or blocked planner begin and end."""

import math

import pytest

from applr_ros1.monitor.monitor import PASS, CollisionMonitor, Verdict
from applr_ros1.planner.escape import MOTIONS, TRIES
from applr_ros1.stack.command_chain import Progress, StalledPlanner, judged
from tests.monitor.scenes import AT_REST, HERE, scan_of, verdict_on, wall

# Commands of the planner (v, w) [m/s, rad/s].
STOP = (0.0, 0.0)
GO = (0.5, 0.1)
TOLERANCE = 0.3  # distance from the goal at which the planner stops [m]


class Drive:
    """Drive with twenty commands per second. `is_held` returns whether the monitor blocks one."""

    def __init__(self, is_held=lambda driven: False):
        self.planner = StalledPlanner(TOLERANCE)
        self.time = 0.0
        self.is_held = is_held

    def __call__(self, seconds, command=STOP, goal="a", distance=5.0):
        """Return the escape motions, or None, during `seconds` of a planner's command."""
        motions = []
        for _ in range(round(seconds / 0.05)):
            progress = Progress(goal, plan_time=self.time, distance=distance)
            motion = self.planner.escape_motion(self.time, command, progress)
            self.planner.report_held(self.is_held(motion or command))
            motions.append(motion)
            self.time += 0.05
        return motions


def test_a_planner_stalled_for_two_seconds_gets_escape_motions_until_it_drives():
    drive = Drive()
    # The patience is 2 s.
    assert set(drive(1.95)) == {None}
    assert not drive.planner.has_stalled
    motions = drive(0.3)
    assert motions[-1] == MOTIONS[0]
    assert drive.planner.has_stalled
    assert drive(0.05, GO) == [None], "the planner's own command passes at once"
    assert set(drive(1.9)) == {None}, "the waiting time begins again"
    assert drive(0.3)[-1] == MOTIONS[1]
    assert set(drive(1.2, GO)) == {None}
    assert not drive.planner.has_stalled


@pytest.mark.parametrize(
    "state",
    [
        {"goal": None},  # no goal, a cancelled goal, or no move_base
        {"distance": None},  # planning or recovering
        {"distance": TOLERANCE},  # arrived
        {"command": (math.nan, 0.0)},
    ],
    ids=["no goal", "no plan", "arrived", "absurd"],
)
def test_a_planner_without_need_to_drive_is_not_overridden(state):
    blocked_drive = Drive(is_held=lambda driven: driven != STOP)
    assert set(blocked_drive(9.0, **state)) == {None}
    drive = Drive()
    assert drive(2.2)[-1] is not None
    assert set(drive(9.0, **state)) == {None}
    assert set(drive(1.9)) == {None}, "the waiting time begins again"
    assert drive(0.3)[-1] is not None


def test_a_planner_silent_from_the_start_gets_escape_motions():
    planner = StalledPlanner(TOLERANCE)
    assert planner.escape_motion(0.0, STOP, Progress("a", 0.0, 5.0)) is None
    assert planner.escape_motion(2.1, STOP, Progress("a", 2.1, 5.0)) == MOTIONS[0]


def test_a_plan_that_is_not_renewed_says_nothing_about_the_way_that_is_left():
    planner = StalledPlanner(TOLERANCE)
    old_plan = Progress("a", plan_time=0.0, distance=5.0)
    planner.escape_motion(0.0, STOP, old_plan)
    assert planner.escape_motion(1.9, STOP, old_plan) is None
    assert planner.escape_motion(2.1, STOP, old_plan) is None, "the plan is older than 2 s"
    assert planner.escape_motion(4.2, STOP, Progress("a", 4.2, 5.0)) is None, "it waits again"
    assert planner.escape_motion(6.3, STOP, Progress("a", 6.3, 5.0)) == MOTIONS[0]


def test_a_chain_lets_no_escape_motion_creep_and_reports_what_is_blocked():
    planner = StalledPlanner(TOLERANCE)
    blocked = Verdict.stop(STOP, "wall")
    judgements = []

    def judge(command, may_creep):
        judgements.append((command, may_creep))
        return blocked

    # A planner that is blocked for half a second gets an escape motion.
    for step in range(12):
        now = 0.05 * step
        motion = planner.escape_motion(now, GO, Progress("a", now, 5.0))
        judged(GO, motion, judge, planner)
    assert judgements[0] == (GO, True)
    assert judgements[-1] == (MOTIONS[0], False)


def test_another_goal_restarts_the_detector():
    drive = Drive()
    assert drive(2.2)[-1] is not None
    assert set(drive(1.9, goal="b")) == {None}
    assert drive(0.3, goal="b")[-1] == MOTIONS[0]


def changes_of(motions):
    """Return the motions that differ from the one before."""
    changes = []
    for previous, motion in zip(motions, motions[1:]):
        if motion != previous:
            changes.append(motion)
    return changes


def test_escape_motions_turn_in_place_first_and_then_drive_curves_back_and_ahead():
    drive = Drive(is_held=lambda driven: driven != STOP)
    assert changes_of(drive(3.0, GO))[:9] == [
        # 0.4 rad/s in place
        (0.0, 0.4),
        (0.0, -0.4),
        # 0.1 m/s back, then ahead, in curves
        (-0.1, 0.4),
        (-0.1, -0.4),
        (0.1, 0.4),
        (0.1, -0.4),
        # Straight ahead, then back
        (0.1, 0.0),
        (-0.1, 0.0),
        # From the beginning
        (0.0, 0.4),
    ]


def test_a_blocked_planner_gets_escape_motions_after_half_a_second():
    drive = Drive(is_held=lambda driven: driven != MOTIONS[2])
    motions = drive(3.0, GO)
    assert set(motions[:10]) == {None}
    assert changes_of(motions)[:3] == list(MOTIONS[:3])
    assert 10 <= motions.count(MOTIONS[2]) <= 11, "for half a second"
    # One past the last command of the motion
    end_step = len(motions) - motions[::-1].index(MOTIONS[2])
    motions_afterwards = motions[end_step : end_step + 9]
    assert set(motions_afterwards) == {None}, "then the planner's commands pass again"


def test_escape_motions_end_after_a_number_of_tries_until_the_planner_drives():
    drive = Drive(is_held=lambda driven: driven != STOP)
    # A motion that is blocked, too, is given up after 0.2 s; TRIES of them are made.
    drive(TRIES * 0.2 + 1.0, GO)
    assert set(drive(60.0, GO)) == {None}
    drive.is_held = lambda driven: False
    drive(2.0, GO)
    drive.is_held = lambda driven: driven != STOP
    assert drive(1.0, GO)[-1] is not None


def test_escape_motions_never_creep_into_unobserved_space():
    """The laser covers the front only: space behind is unknown, and space ahead is free."""
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of(wall(3.0), HERE))
    planned = verdict_on(monitor, -0.1)
    assert planned.command == (-0.1, 0.0)
    assert not planned.blocked
    escape_back = monitor.filter(0.0, HERE, AT_REST, (-0.1, 0.0), creeps=False)
    v, _ = escape_back.command
    assert abs(v) < 0.02
    assert escape_back.blocked
    escape_ahead = monitor.filter(0.0, HERE, AT_REST, (0.1, 0.0), creeps=False)
    assert escape_ahead.action == PASS
