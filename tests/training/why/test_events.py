"""Tests of the events of a drive, and of the reasons that its columns show."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.drives.drive import (
    ABORTED,
    REACHED,
    TIMED_OUT,
    Commands,
    Drive,
    Goal,
    Motion,
    Plans,
    Refusals,
    Scans,
    Verdicts,
)
from training.why import events, reasons
from training.why.events import AT_GOAL, UNHEARD, Limits
from training.why.reasons import Stretch, failure_of

RATE_HZ = 20.0
# top speed [m/s] and turn rate [rad/s]
TOP = 0.5
TURN = 1.5
DRIVES = [(0.5, 0.0)] * 60  # three seconds at full speed
STANDS = [(0.0, 0.0)] * 60


def drive_of(twists, goal=(100.0, 0.0)):
    """Return a drive with these measured velocities (v, w), which had a goal all the time."""
    twist = np.array(twists, float)
    time = np.arange(len(twist)) / RATE_HZ
    yaw = np.cumsum(twist[:, 1]) / RATE_HZ
    x = np.cumsum(twist[:, 0] * np.cos(yaw)) / RATE_HZ
    y = np.cumsum(twist[:, 0] * np.sin(yaw)) / RATE_HZ
    odometry = Motion(time, time, np.column_stack([x, y, yaw]), twist)
    plans = Plans(time, [np.array([(*goal, 0.0)])] * len(time))
    commands = Commands(time, twist)
    return Drive(
        odometry=odometry,
        truth=odometry,
        plans=plans,
        planned=commands,
        commands=commands,
        goals=[Goal("one", 0.0, float(time[-1]), TIMED_OUT)],
    )


def found(drive):
    count = len(drive.odometry)
    return events.find(drive, Limits(np.full(count, TOP), np.full(count, TURN), 0.25, 1.0))


def kinds(drive):
    return [event.kind for event in found(drive)]


# -- events
SEEN = {
    "stood": STANDS,
    "turned on the spot": [(0.0, 0.4)] * 60,
    "drove backwards": [(-0.1, 0.1)] * 60,
    "crept": [(0.1, 0.1)] * 30,
    "was slow": [(0.2, 0.1)] * 120,
    "swung from side to side": ([(0.5, 0.8)] * 5 + [(0.5, -0.8)] * 5) * 8,
}


@pytest.mark.parametrize("kind", SEEN)
def test_each_kind_of_event_is_seen_in_the_measured_motion_with_begin_and_end(kind):
    drive = drive_of(DRIVES + SEEN[kind] + DRIVES)
    drive.planned = drive.commands = Commands(
        drive.odometry.time, np.full((len(drive.odometry), 2), 0.5)
    )
    (event,) = found(drive)
    slack = 1.0 if kind.startswith("swung") else 0.06
    assert event.kind == kind
    assert event.begin == pytest.approx(3.0, abs=slack)
    assert event.end == pytest.approx(3.0 + len(SEEN[kind]) / RATE_HZ, abs=slack)


def test_a_robot_that_gains_no_way_goes_to_and_fro():
    there_and_back = [(0.4, 0.0)] * 30 + [(-0.4, 0.0)] * 30
    (event,) = found(drive_of(DRIVES + there_and_back * 4 + DRIVES))
    assert event.kind == "went to and fro"
    assert kinds(drive_of(DRIVES + [(-0.4, 0.0)] * 10 + DRIVES * 3)) == []


def test_short_stops_and_an_arrival_are_no_events():
    assert kinds(drive_of(DRIVES + STANDS[:15] + DRIVES)) == []
    at_goal = drive_of(DRIVES + STANDS, goal=(1.5, 0.0))
    assert kinds(at_goal) == []
    assert kinds(drive_of(DRIVES + STANDS * 2, goal=(1.5, 0.0))) == [AT_GOAL]


def test_there_are_no_events_without_a_goal():
    drive = drive_of(DRIVES + STANDS + DRIVES)
    assert kinds(replace(drive, goals=[Goal("one", 0.0, 3.0)])) == []
    without_status = replace(drive, goals=[])
    assert kinds(without_status) == ["stood"]  # The planner commanded until the end.
    moves = Commands(drive.odometry.time[:60], drive.odometry.twist[:60])
    assert kinds(replace(without_status, planned=moves)) == []


def test_events_that_follow_each_other_at_one_place_are_one_trap():
    (trap,) = found(drive_of(DRIVES + STANDS + [(0.3, 0.0)] * 20 + STANDS * 2 + DRIVES))
    assert (trap.kind, trap.begin, trap.end) == ("stood", pytest.approx(3.0), pytest.approx(12.95))
    assert len(found(drive_of(DRIVES + STANDS + DRIVES + STANDS + DRIVES))) == 2


def test_a_gap_of_the_odometry_is_an_event():
    drive = drive_of(DRIVES * 3)
    rows = np.r_[0:60, 100:180]
    odometry = drive.odometry
    drive.odometry = Motion(
        odometry.time[rows], odometry.stamp[rows], odometry.pose[rows], odometry.twist[rows]
    )
    (gap,) = found(drive)
    assert (gap.kind, gap.begin, gap.end) == (UNHEARD, pytest.approx(2.95), pytest.approx(5.0))


# -- reasons
def stretch_of(drive, begin=3.0, end=6.0, share=0.5):
    return Stretch(drive, begin, end, share, 1.0 / RATE_HZ)


def scans_of(times, metres):
    """Return scans of three beams at these ranges [m]."""
    times = np.array(times, float)
    fan = np.tile([-1.0, 1.0, 0.1, 30.0], (len(times), 1))
    return Scans(times, times, fan, [np.full(3, each, np.float32) for each in metres])


@pytest.fixture
def stopped():
    """Return a drive that stands from 3 to 6 s, although 0.5 m/s are commanded."""
    drive = drive_of(DRIVES + STANDS + DRIVES)
    commands = Commands(drive.odometry.time, np.tile([0.5, 0.0], (len(drive.odometry), 1)))
    return replace(drive, planned=commands, commands=commands)


def test_a_silent_laser_is_the_reason_also_if_it_stays_silent(stopped):
    every = np.arange(0.0, 9.0, 0.1)
    silent = every[(every < 2.8) | (every > 6.2)]
    assert reasons.silent(stretch_of(replace(stopped, scans=scans_of(every, every)))) == ""
    words = "there was no scan for 3.6 s"
    assert reasons.silent(stretch_of(replace(stopped, scans=scans_of(silent, silent)))) == words
    ended = every[every < 2.8]
    assert (
        reasons.silent(stretch_of(replace(stopped, scans=scans_of(ended, ended))))
        == "there was no scan for 6.2 s"
    )


def test_a_planner_that_sends_nothing_is_silent(stopped):
    keeps = stopped.planned.time < 2.5
    drive = replace(
        stopped, planned=Commands(stopped.planned.time[keeps], stopped.planned.twist[keeps])
    )
    assert reasons.silent_planner(stretch_of(drive)) == "move_base sent no command for 6.5 s"
    assert reasons.silent_planner(stretch_of(stopped)) == ""


def test_the_time_without_a_plan_is_a_reason(stopped):
    path = np.zeros((5, 3))
    empty = np.zeros((0, 3))
    for times, paths, words in (
        ([0.0], [path], ""),  # One plan serves the whole drive.
        ([0.0, 3.2], [path, empty], "the global planner finds no path"),
        ([0.0, 3.2, 4.0], [path, empty, path], ""),
        ([8.0], [path], "the global planner finds no path"),
    ):
        drive = replace(stopped, routes=Plans(np.array(times), paths))
        assert reasons.no_plan(stretch_of(drive)) == words


def test_a_jump_of_the_pose_at_the_begin_is_a_reason(stopped):
    assert reasons.jumping(stretch_of(stopped)) == ""
    moved = stopped.odometry.pose + np.where(
        stopped.odometry.time[:, None] > 2.9, [0.8, 0.0, 0.0], 0.0
    )
    drive = replace(stopped, odometry=replace(stopped.odometry, pose=moved))
    assert reasons.jumping(stretch_of(drive)) == "the pose jumped by 0.8 m"
    turned = stopped.odometry.pose + np.where(
        stopped.odometry.time[:, None] > 2.9, [0.0, 0.0, -1.0], 0.0
    )
    drive = replace(stopped, odometry=replace(stopped.odometry, pose=turned))
    assert reasons.jumping(stretch_of(drive)) == "the heading jumped by 1.0 rad"


def test_commands_that_do_not_reach_the_base_are_a_reason(stopped):
    assert reasons.stopped(stretch_of(stopped)) == ""  # There is no monitor.
    nothing = Commands(stopped.planned.time, np.zeros_like(stopped.planned.twist))
    words = reasons.stopped(stretch_of(replace(stopped, commands=nothing)))
    assert words.startswith("move_base commanded 0.50 m/s, but nothing of it reached the base")
    half = Commands(stopped.planned.time, 0.5 * stopped.planned.twist)
    assert reasons.stopped(stretch_of(replace(stopped, commands=half))) == ""


def test_a_base_that_does_not_follow_is_a_reason(stopped):
    words = "the base did not follow its commands of 0.50 m/s"
    assert reasons.unmoved(stretch_of(stopped)) == words
    assert reasons.unmoved(stretch_of(stopped, 6.0, 9.0)) == ""


def test_scans_that_stay_the_same_while_the_odometry_moves_are_a_reason(stopped):
    times = np.arange(0.0, 9.0, 0.1)
    same = replace(stopped, scans=scans_of(times, np.full(90, 2.0)))
    words = (
        "the scans stay the same while the odometry moves 1.5 m: "
        "the robot is held, or its wheels slip"
    )
    assert reasons.stuck(stretch_of(same, 6.0, 9.0)) == words
    assert reasons.stuck(stretch_of(same)) == ""  # It stands.
    assert reasons.stuck(stretch_of(replace(stopped, scans=scans_of(times, times)), 6.0, 9.0)) == ""


def test_scans_that_stay_the_same_while_the_robot_goes_to_and_fro_are_no_reason(stopped):
    times = np.arange(0.0, 9.0, 0.1)
    pose = stopped.odometry.pose.copy()
    pose[1::2] = pose[0]  # It comes back each time.
    pose[::2] = pose[0] + (0.1, 0.0, 0.0)
    swinging = replace(
        stopped,
        odometry=replace(stopped.odometry, pose=pose),
        scans=scans_of(times, np.full(90, 2.0)),
    )
    assert swinging.odometry.length > 3.0
    assert reasons.stuck(stretch_of(swinging, 6.0, 9.0)) == ""


def test_a_recovery_lasts_until_the_next_plan_is_followed(stopped):
    recovers = replace(stopped, recoveries=np.array([3.1]))
    # Plans were followed all the time.
    assert reasons.recovering(stretch_of(recovers)) == ""
    without = Plans(np.array([0.0, 8.0]), [np.zeros((1, 3))] * 2)
    assert (
        reasons.recovering(stretch_of(replace(recovers, plans=without)))
        == "a recovery behaviour ran"
    )


def test_late_commands_are_a_reason(stopped):
    assert reasons.late(stretch_of(stopped)) == ""
    seldom = replace(stopped, planned=stopped.planned.part(slice(0, None, 4)))
    assert reasons.late(stretch_of(seldom)) == "commands came every 0.20 s instead of every 0.05 s"


# -- failures of simulated drives
def failed(drive, status=TIMED_OUT, reason="time limit", **columns):
    return failure_of(replace(drive, goals=[Goal("one", 0.0, 9.0, status, reason)], **columns))


def test_a_drive_that_arrives_has_not_failed_unless_it_touches_something(stopped):
    assert failed(stopped, REACHED) == ""
    assert failed(stopped, REACHED, contacts=np.array([4.0])) == "it touches something"


def test_failures_are_worded_by_their_causes_first(stopped):
    times = stopped.planned.time
    assert failed(stopped).startswith(f"{reasons.STANDS}, and has not arrived after 9 s")
    aborts = failed(stopped, ABORTED, "planner aborted: no way")
    assert aborts == "move_base ends with no way"

    some = [{"samples": 90, "obstacle": 80, "path": 1}] * 30 + [{}] * 150
    rejects = {"refusals": Refusals(times, some)}
    assert (
        failed(stopped, **rejects)
        == "the planner rejects every velocity in 17 % of its cycles, mostly by obstacle"
    )
    assert failed(stopped, refusals=Refusals(times, [{}] * 170 + some[:10])).startswith(
        reasons.STANDS
    )

    blocked = [time > 6.0 for time in times]
    holds = Verdicts(times, ["stop"] * 180, ["a wall"] * 180, blocked)
    intervenes = "the collision monitor intervenes 33 % of the time: a wall"
    assert failed(stopped, verdicts=holds) == intervenes
    # What the planner rejects never reaches the monitor.
    assert failed(stopped, verdicts=holds, **rejects).startswith("the planner rejects")

    fast = Commands(times, np.tile([2.0, 0.0], (180, 1)))
    assert failed(stopped, commands=fast) == "it moves 3.0 m although 18.0 m are commanded"
    lost = failed(stopped, routes=Plans(np.empty(0), []), **rejects)
    assert lost == "the global planner finds no path"
    assert failed(stopped, contacts=np.array([1.0]), **rejects).startswith(
        "it touches something, and the planner"
    )
