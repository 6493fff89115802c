"""Tests of the events of a drive, and of the reasons that its columns show."""

from dataclasses import fields, replace

import numpy as np
import pytest

from applr_ros1.drives.drive import (
    Commands,
    Goal,
    Motion,
    Plans,
    Scans,
    SentGoal,
    Transforms,
    Verdicts,
)
from applr_ros1.monitor.monitor import BRAKING, REVERSING
from applr_ros1.robots import JACKAL
from applr_ros1.why import events, reasons
from applr_ros1.why.diagnosis import NOT_ENDED, OCCUPIED, give_outside_reason
from applr_ros1.why.events import AT_GOAL, UNHEARD, DriveLimits, Event
from applr_ros1.why.reasons import NO_PATH
from applr_ros1.why.recorded import with_planned
from applr_ros1.why.stretch import Stretch
from tests.support.measured_drives import DRIVES, RATE_HZ, STANDS, drive_of, stopped_drive

# top speed [m/s] and turn rate [rad/s]
TOP = 0.5
TURN = 1.5
LIMITS = DriveLimits(TOP, TURN, tolerance=0.25, scale=1.0, end=9.0, rates=[(-np.inf, 20.0)])


def found(drive, tolerance=0.25, scale=1.0):
    """Return the events of a robot of this size, in Jackals, whose goal has a tolerance [m]."""
    limits = LIMITS._replace(
        speed=np.full(len(drive.odometry), TOP),
        tolerance=tolerance,
        scale=scale,
        end=drive.end,
        yaw_tolerance=0.1,
    )
    return events.find(drive, drive.odometry, limits)


def kinds(drive):
    """Return the kinds of the events in order of time."""
    return [event.kind for event in found(drive)]


def with_gap(drive, first_row, end_row):
    """Return a drive without some rows of its odometry."""
    odometry = drive.odometry
    kept_rows = np.r_[0:first_row, end_row : len(odometry)]
    received = Motion(
        odometry.time[kept_rows],
        odometry.stamp[kept_rows],
        odometry.pose[kept_rows],
        odometry.twist[kept_rows],
    )
    return replace(drive, odometry=received)


# -- events
# Velocities (v, w) of one event each, longer than the shortest one that counts: 0.1 m/s lie below a
# quarter of the top speed, 0.2 m/s below half of it, and the last turn rate changes its sign four
# times a second.
SEEN = {
    "stood": STANDS,
    "turned on the spot": [(0.0, 0.4)] * 60,
    "drove backwards": [(-0.1, 0.1)] * 60,
    "crept": [(0.1, 0.1)] * 30,
    "was slow": [(0.2, 0.1)] * 120,
    "swung from side to side": ([(0.5, 0.8)] * 5 + [(0.5, -0.8)] * 5) * 8,
}


def test_a_moment_has_the_place_of_the_latest_pose():
    drive = drive_of(DRIVES)
    odometry = drive.odometry
    for moment in (0.0, 1.02):
        event = events.around(moment, odometry, LIMITS)
        latest_pose = odometry.pose[odometry.time <= moment][-1]
        assert event.place == tuple(latest_pose[:2])
        assert (event.begin, event.end) == (moment - events.AROUND_S, moment + events.AROUND_S)


@pytest.mark.parametrize(
    ("twist", "words"),
    [
        ((0.2, 0.5), "drove with 0.20 m/s"),
        ((-0.1, 0.0), "drove backwards with 0.10 m/s"),
        ((0.0, -0.4), "turned on the spot with 0.40 rad/s"),
        ((0.01, 0.0), "stood"),
    ],
)
def test_of_a_moment_is_said_what_the_robot_did(twist, words):
    drive = drive_of([twist] * 60)
    event = events.around(1.0, drive.odometry, LIMITS)
    assert event.kind == words
    assert event.is_asked


@pytest.mark.parametrize("kind", SEEN)
def test_each_kind_of_event_is_seen_in_the_measured_motion_with_begin_and_end(kind):
    drive = drive_of(DRIVES + SEEN[kind] + DRIVES)
    # Full commands all the time: what is commanded decides on no event.
    full_twists = np.full((len(drive.odometry), 2), 0.5)
    full_commands = Commands(drive.odometry.time, full_twists)
    drive.planned = full_commands
    drive.commands = full_commands

    (event,) = found(drive)

    # Changes of sign are counted within a second on both sides of a row. Otherwise a row decides.
    slack = 1.0 if kind.startswith("swung") else 0.06
    duration = len(SEEN[kind]) / RATE_HZ
    assert event.kind == kind
    assert event.begin == pytest.approx(3.0, abs=slack)
    assert event.end == pytest.approx(3.0 + duration, abs=slack)


def test_slow_or_rare_changes_of_the_turn_are_no_swings():
    # 0.3 rad/s lie below a quarter of the top turn rate: the heading is corrected all the time.
    corrections = ([(0.5, 0.3)] * 5 + [(0.5, -0.3)] * 5) * 8
    assert kinds(drive_of(DRIVES + corrections + DRIVES)) == []
    # A slalom turns the other way every 1.2 s.
    slalom = ([(0.5, 0.8)] * 24 + [(0.5, -0.8)] * 24) * 3
    assert kinds(drive_of(DRIVES + slalom + DRIVES)) == []


def test_a_robot_that_gains_no_way_goes_to_and_fro():
    there_and_back = [(0.4, 0.0)] * 30 + [(-0.4, 0.0)] * 30
    trapped = drive_of(DRIVES + there_and_back * 4 + DRIVES)
    assert kinds(trapped) == ["went to and fro"]

    # It is an event if no way is gained for half of the eight seconds.
    shorter = [(0.4, 0.0)] * 20 + [(-0.4, 0.0)] * 20
    assert kinds(drive_of(DRIVES + shorter * 4 + DRIVES)) == ["went to and fro"]
    assert kinds(drive_of(DRIVES + shorter * 3 + DRIVES)) == []

    # Half a second backwards, after which the robot goes on, is no trap.
    backing_out = [(-0.4, 0.0)] * 10
    free = drive_of(DRIVES + backing_out + DRIVES * 3)
    assert kinds(free) == []


def test_short_stops_and_an_arrival_are_no_events():
    short_stop = STANDS[:15]  # 0.75 s
    assert kinds(drive_of(DRIVES + short_stop + DRIVES)) == []

    # Three seconds at 0.5 m/s end at this goal. Three more seconds are usual there, six are not.
    goal = (1.5, 0.0)
    arrives = drive_of(DRIVES + STANDS, goal)
    waits = drive_of(DRIVES + STANDS * 2, goal)
    assert kinds(arrives) == []
    assert kinds(waits) == [AT_GOAL]


@pytest.mark.parametrize(
    ("end_m", "yaw", "reason"),
    [
        (1.5, 0.0, NOT_ENDED),
        (1.74, 0.09, NOT_ENDED),
        (1.5, 2.0 * np.pi, NOT_ENDED),
        (1.5, 0.11, ""),
        (1.76, 0.0, ""),  # It is at the end of its plan, by the radius of a larger tolerance.
    ],
)
def test_a_wait_within_both_tolerances_is_the_goals_and_not_the_tolerances(end_m, yaw, reason):
    # Given: a robot that stands at x = 1.5 m, and a planner that publishes no poses at its goal
    drive = drive_of(DRIVES + STANDS * 2, goal=(end_m, 0.0))
    times = drive.plans.time
    paths = [np.array([(end_m, 0.0, yaw)]), *[np.zeros((0, 3))] * (len(times) - 1)]
    waits = replace(drive, plans=Plans(times, paths))
    # Then
    (event,) = found(waits, tolerance=0.25, scale=3.0)
    give_outside_reason(event, waits, LIMITS)
    assert (event.kind, event.reason, event.is_outside) == (AT_GOAL, reason, bool(reason))


def test_a_robot_that_circles_a_goal_beyond_its_tolerance_is_at_its_goal():
    # It ends 0.09 m before the goal.
    waits = drive_of(DRIVES + STANDS * 2, goal=(1.59, 0.0))
    farther = drive_of(DRIVES + STANDS * 2, goal=(1.62, 0.0))
    for drive, kind in ((waits, AT_GOAL), (farther, "stood")):
        (event,) = found(drive, tolerance=0.01)
        assert event.kind == kind


@pytest.mark.parametrize(
    ("kind", "twist", "shortest"),
    [
        ("drove backwards", (-0.2, 0.0), 2.0),
        ("drove backwards", (-0.1, 0.0), 2.0),
        ("turned on the spot", (0.0, 0.4), 2.0),
        ("crept", (0.1, 0.0), 1.0),
        ("was slow", (0.2, 0.0), 5.0),
    ],
)
def test_to_turn_to_back_out_or_to_be_slow_for_a_moment_is_no_event(kind, twist, shortest):
    for duration, expected in ((shortest - 0.2, []), (shortest + 0.2, [kind])):
        row_count = round(duration * RATE_HZ)
        assert kinds(drive_of(DRIVES + [twist] * row_count + DRIVES)) == expected, duration


def test_a_robot_that_creeps_between_short_turns_creeps():
    turns = [(0.0, 0.4)] * 25
    creeps = [(0.1, 0.0)] * 15
    assert kinds(drive_of(DRIVES + turns + creeps * 2 + DRIVES)) == ["crept"]
    assert kinds(drive_of(DRIVES + creeps + turns + creeps + DRIVES)) == ["crept"]
    assert kinds(drive_of(DRIVES + turns + creeps + DRIVES)) == []


def test_lengths_of_events_are_smaller_for_a_small_robot():
    def kinds_at(scale, drive):
        """Return the kinds of the events of a robot of this size, which can meet its goal."""
        return [event.kind for event in found(drive, tolerance=0.01, scale=scale)]

    # Two stops 0.3 m apart: within 0.5 m for the Jackal, beyond the half of it
    a_little_on = [(0.3, 0.0)] * 20
    stops = drive_of(DRIVES + STANDS + a_little_on + STANDS + DRIVES)
    assert kinds_at(1.0, stops) == ["stood"]
    assert kinds_at(0.5, stops) == ["stood", "stood"]

    # In eight seconds it drives 0.4 m to and fro.
    there_and_back = [(0.05, 0.0)] * 30 + [(-0.05, 0.0)] * 30
    trapped = drive_of(DRIVES + there_and_back * 8 + DRIVES)
    assert kinds_at(1.0, trapped) == ["crept"]
    assert kinds_at(0.5, trapped) == ["went to and fro"]

    # It ends 0.09 m before its goal: within 0.1 m, but not within the half of it.
    waits = drive_of(DRIVES + STANDS * 2, goal=(1.59, 0.0))
    assert kinds_at(1.0, waits) == [AT_GOAL]
    assert kinds_at(0.5, waits) == ["stood"]


def test_there_are_no_events_without_a_goal():
    drive = drive_of(DRIVES + STANDS + DRIVES)
    ends_before_the_stop = [Goal("one", 0.0, 3.0)]
    assert kinds(replace(drive, goals=ends_before_the_stop)) == []
    # A bag need not hold move_base's status. Then the planner's commands tell until when there was
    # a goal: here until the end, and with the commands of the first three seconds not any longer.
    without_status = replace(drive, goals=[])
    assert kinds(without_status) == ["stood"]
    odometry = drive.odometry
    early_commands = Commands(odometry.time[:60], odometry.twist[:60])
    assert kinds(replace(without_status, planned=early_commands)) == []
    # Commands that pause for as long as between two goals end it, too.
    pauses = drive_of(DRIVES + STANDS * 4 + DRIVES)
    moving_rows = pauses.odometry.twist.any(axis=1)
    with_pause = Commands(pauses.odometry.time[moving_rows], pauses.odometry.twist[moving_rows])
    assert kinds(replace(pauses, goals=[], planned=with_pause)) == []
    # Nor was there one before the first command to move.
    waits_first = drive_of(STANDS + DRIVES)
    assert kinds(waits_first) == ["stood"]
    assert kinds(replace(waits_first, goals=[])) == []


def test_a_robot_has_its_goal_from_the_first_to_the_last_moment_of_it():
    drive = drive_of(DRIVES)
    times = drive.odometry.time
    goal = Goal("one", float(times[20]), float(times[40]))
    is_pursued = events.pursued(replace(drive, goals=[goal]), drive.odometry)
    assert np.flatnonzero(is_pursued).tolist() == list(range(20, 41))


def test_events_that_follow_each_other_at_one_place_are_one_trap():
    a_little_on = [(0.3, 0.0)] * 20  # 0.3 m in a second
    one_place = drive_of(DRIVES + STANDS + a_little_on + STANDS * 2 + DRIVES)
    (trap,) = found(one_place)
    assert trap.kind == "stood"
    assert trap.begin == pytest.approx(3.0)
    assert trap.end == pytest.approx(12.95)

    # 1.5 m lie between these stops, more than the 0.5 m of one trap.
    two_places = drive_of(DRIVES + STANDS + DRIVES + STANDS + DRIVES)
    assert len(found(two_places)) == 2


def test_a_gap_of_the_odometry_is_an_event():
    drive = with_gap(drive_of(DRIVES * 3), 60, 100)
    (gap,) = found(drive)
    assert gap.kind == UNHEARD
    # From the last message before the gap, row 59, to the first one after it, row 100
    assert gap.begin == pytest.approx(2.95)
    assert gap.end == pytest.approx(5.0)
    # After its last goal, nobody waits for the robot.
    assert kinds(replace(drive, goals=[Goal("one", 0.0, 2.0)])) == []


def test_odometry_that_comes_once_a_second_shows_the_same_stop():
    drive = drive_of(DRIVES * 3 + STANDS * 2 + DRIVES * 3)
    each_second = np.arange(0, len(drive.odometry), 20)
    rare = {}
    for column in fields(drive.odometry):
        rare[column.name] = getattr(drive.odometry, column.name)[each_second]
    # Its messages come up to 0.2 s late.
    rare["time"] = rare["time"] + np.resize([0.0, 0.2], len(each_second))
    (event,) = found(replace(drive, odometry=Motion(**rare)))
    assert event.kind == "stood"
    assert (event.begin, event.end) == pytest.approx((9.0, 15.0), abs=1.3)


def test_a_stop_at_the_same_place_on_the_next_round_is_another_event():
    # A circle of 1.25 m radius takes 15.7 s, more than the 10 s within which stops are one trap.
    round_trip = [(0.5, 0.4)] * 314
    drive = drive_of(DRIVES + STANDS + round_trip + STANDS + DRIVES)
    first_stop, second_stop = found(drive)
    assert first_stop.place == pytest.approx(second_stop.place, abs=0.05)
    assert second_stop.begin - first_stop.end == pytest.approx(15.7, abs=0.1)


def test_a_silence_and_a_wait_at_the_goal_are_no_part_of_a_trap_beside_them():
    # It stands from 3 to 12 s, and is not heard of from 6 to 8 s.
    silent = with_gap(drive_of(DRIVES + STANDS * 3 + DRIVES), 120, 160)
    assert kinds(silent) == ["stood", UNHEARD, "stood"]

    # It stands 0.4 m before its goal, and then 0.2 m, within the tolerance.
    a_little_on = [(0.2, 0.0)] * 20
    arrives = drive_of(DRIVES + STANDS + a_little_on + STANDS * 2, goal=(1.9, 0.0))
    assert kinds(arrives) == ["stood", AT_GOAL]


# -- reasons
def stretch_of(drive, begin=3.0, end=6.0, share=0.5):
    """Return a part of a drive, by default the three seconds in which it stands."""
    return Stretch(drive, begin, end, share, 1.0 / RATE_HZ)


def scans_of(times, metres):
    """Return scans of three beams at times (n,) [s], of which scan i has only the range metres[i].

    The ranges of all scans differ if the times themselves are given for them.
    """
    times = np.array(times, float)
    fan = np.tile([-1.0, 1.0, 0.1, 30.0], (len(times), 1))
    ranges = [np.full(3, distance, np.float32) for distance in metres]
    return Scans(times, times, fan, ranges)


@pytest.fixture
def stopped():
    """Return a drive that stands from 3 to 6 s, although 0.5 m/s are commanded."""
    return stopped_drive()


def test_a_silence_counts_within_the_stop_alone_and_beyond_the_usual_gaps(stopped):
    def silences(first, last):
        """Return the reasons if scans, or else commands, are silent from `first` to `last` [s]."""
        times = stopped.planned.time
        is_sent = (times <= first) | (times >= last)
        scans = scans_of(times[is_sent], times[is_sent])
        planned = stopped.planned.part(np.flatnonzero(is_sent))
        return (
            reasons.silent(stretch_of(replace(stopped, scans=scans))),
            reasons.silent_planner(stretch_of(replace(stopped, planned=planned))),
        )

    # The stop lasts from 3 to 6 s: half of it is a reason, whatever was before.
    assert silences(0.5, 4.4) == ("", "")
    assert silences(0.5, 4.7) == (
        "there was no scan for 1.7 s",
        "move_base sent no command for 1.7 s",
    )
    # A source that fails for good sends nothing after its gap.
    assert silences(3.0, 9.0) == (
        "there was no scan for 3.0 s",
        "move_base sent no command for 3.0 s",
    )
    # A laser that scans every two seconds is slow, not silent.
    times = np.arange(0.0, 9.0, 2.0)
    slow = replace(stopped, scans=scans_of(times, times))
    assert reasons.silent(stretch_of(slow)) == ""


def test_the_time_without_a_plan_is_a_reason_if_nothing_proves_that_there_is_one(stopped):
    path = np.zeros((5, 3))
    empty = np.zeros((0, 3))
    waits = replace(stopped, plans=None, planned=None, truth=None)
    followed = Plans(np.arange(0.0, 9.0, 0.1), [empty] * 90)
    early = followed.between(0.0, 3.2)
    from_bag_on = [Goal("one", 0.0, 9.0)]
    seen_to_begin = [Goal("one", 1.5, 9.0)]
    for times, paths, changes, reason in (
        ([0.0], [path], {}, ""),  # One plan serves the whole drive.
        ([0.0, 3.2], [path, empty], {}, NO_PATH),
        ([0.0, 3.2, 4.0], [path, empty, path], {}, ""),  # 0.8 s are less than half of it.
        # The first plan comes after the stretch: an earlier one may be older than the bag.
        ([8.0], [path], {"goals": from_bag_on}, ""),
        ([8.0], [path], {"goals": seen_to_begin}, NO_PATH),
        # An empty plan for somebody else: what the local planner does shows that it has another.
        ([0.0, 3.2], [path, empty], {"plans": followed}, ""),
        ([0.0, 3.2], [path, empty], {"plans": early}, NO_PATH),
        ([0.0, 3.2], [path, empty], {"planned": stopped.planned}, ""),
        ([8.0], [path], {"goals": seen_to_begin, "plans": followed}, ""),
    ):
        drive = replace(waits, routes=Plans(np.array(times), paths), **changes)
        assert reasons.no_plan(stretch_of(drive)) == reason, (times, changes)


@pytest.mark.parametrize(
    ("goal", "metres", "scale", "is_occupied"),
    [
        ((5.0, 1.0), 2.0, 1.0, True),  # It lies on the surface that the laser sees.
        ((5.0, 1.0), 1.55, 1.0, True),  # It lies inside of an obstacle,
        ((5.0, 1.0), 1.45, 1.0, False),  # or behind another one.
        ((5.0, 1.0), 2.1, 1.0, True),  # The robot's centre does not come so near to it,
        ((5.0, 1.0), 2.2, 1.0, False),
        ((5.0, 1.0), 2.2, 2.0, True),  # that of a larger robot.
        ((5.0, 1.0), np.inf, 1.0, False),
        ((3.3, 1.0), 0.0, 1.0, False),  # A beam that measures nothing shows no obstacle.
        ((1.0, 1.0), 2.0, 1.0, False),  # It lies behind the laser's fan.
    ],
)
def test_a_goal_in_an_obstacle_is_said_if_there_is_no_path(
    stopped, goal, metres, scale, is_occupied
):
    # Given: a laser at (3, 1) m in the map with beams ahead and 1 rad to both sides
    times = np.arange(0.0, 9.0, 0.1)
    rows = 2
    place = np.array([[3.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    drive = replace(
        stopped,
        plans=None,
        planned=None,
        routes=Plans(np.array([0.0]), [np.zeros((0, 3))]),
        scans=scans_of(times, [metres] * len(times)),
        frames={"scans": ["laser"]},
        transforms=Transforms(
            np.zeros(rows),
            np.zeros(rows),
            ["map", "odom"],
            ["odom", "laser"],
            np.concatenate([place, [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]]),
            [True] * rows,
        ),
        # The latest goal counts.
        sent=[SentGoal(0.0, (9.0, 1.0, 0.0), "map"), SentGoal(1.0, (*goal, 0.0), "map")],
    )
    event = Event("stood", 3.0, 6.0, (0.0, 0.0))
    # When
    give_outside_reason(event, drive, LIMITS._replace(scale=scale))
    # Then
    assert event.reason == NO_PATH + (OCCUPIED if is_occupied else "")
    # Without tf, nobody knows where the laser sees the goal.
    event = Event("stood", 3.0, 6.0, (0.0, 0.0))
    give_outside_reason(event, replace(drive, transforms=None), LIMITS)
    assert event.reason == NO_PATH


def test_a_jump_of_the_pose_about_the_begin_is_a_reason(stopped):
    odometry = stopped.odometry

    def jump(time, offset, yaw=0.0):
        """Return the reason if poses, which look this way, shift by (x, y, yaw) at a time [s]."""
        poses = odometry.pose + (0.0, 0.0, yaw)
        poses[odometry.time > time] += offset
        poses[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
        drive = replace(stopped, odometry=replace(odometry, pose=poses))
        return reasons.jumping(stretch_of(drive))

    # The way at the measured speed, 2.5 cm a row, is no jump.
    assert jump(0.2, (0.0, 0.0, 0.0)) == ""
    assert jump(0.2, (0.8, 0.0, 0.0)) == "the pose jumped by 0.8 m"
    assert jump(0.2, (0.0, 0.0, -1.0)) == "the heading jumped by 1.0 rad"
    # From 3.12 to -3.12 rad the heading turns by 0.04 rad across the back.
    assert jump(2.0, (0.0, 0.0, 0.04), yaw=3.12) == ""
    # The cause of a stop at 3 s may show until 4 s.
    assert jump(3.9, (0.8, 0.0, 0.0)) == "the pose jumped by 0.8 m"
    assert jump(4.5, (0.8, 0.0, 0.0)) == ""


def test_a_jump_of_the_pose_is_the_cause_of_a_missing_plan(stopped):
    odometry = stopped.odometry
    poses = odometry.pose.copy()
    poses[odometry.time > 2.9] += (0.8, 0.0, 0.0)
    no_path = Plans(np.array([0.0, 3.0]), [np.zeros((5, 3)), np.zeros((0, 3))])
    drive = replace(stopped, odometry=replace(odometry, pose=poses), routes=no_path)
    event = Event("stood", 3.0, 6.0, (1.5, 0.0))
    give_outside_reason(event, drive, LIMITS)
    assert event.reason == "the pose jumped by 0.8 m"
    assert event.is_outside


def limited(drive, shares, verdicts=None):
    """Return a drive of which shares of the planner's commands reach the base, 20 ms later."""
    planned = drive.planned
    passed_twists = np.broadcast_to(shares, len(planned))[:, None] * planned.twist
    commands = Commands(planned.time + 0.02, passed_twists)
    return replace(drive, commands=commands, verdicts=verdicts)


# Rows of a second at 20 Hz: 70 % of the commands are limited, or the share of them that passes.
LIMITED = np.arange(180) % 20 < 14


@pytest.mark.parametrize(
    ("shares", "percent"),
    [
        pytest.param(0.0, 100, id="nothing passes"),
        pytest.param(0.2, 80, id="a fifth passes"),
        pytest.param(np.where(LIMITED, 0.2, 1.0), 56, id="a fifth, in 70 % of the cycles"),
        pytest.param(np.where(LIMITED, 0.4, 1.0), None, id="two fifths, in 70 % of the cycles"),
        pytest.param(0.51, None, id="more than half passes"),
        # The monitor still brakes a base that is to change its direction.
        pytest.param(-0.5, 100, id="another direction"),
        # A base that brakes slower than commanded makes up for nothing.
        pytest.param(np.where(LIMITED, 0.0, 1.5), 70, id="nothing, then more than commanded"),
    ],
)
def test_a_monitor_that_lets_less_than_half_of_the_commanded_motion_pass_is_the_reason(
    stopped, shares, percent
):
    limits = Verdicts(np.array([0.0]), ["slow"], ["limited: a wall"])
    passes = Verdicts(np.array([0.0]), ["pass"], [""])
    others = f"{percent} % of the commanded motion does not reach the base (collision monitor, mux"
    for verdicts, words in (
        (limits, f"the collision monitor blocks {percent} % of the commanded motion: limited: a"),
        (passes, others),
        (None, others),
    ):
        reason = reasons.blocked(stretch_of(limited(stopped, shares, verdicts)))
        if percent is None:
            assert reason == ""
        else:
            assert reason.startswith(words)


def test_a_verdict_of_the_monitor_holds_until_the_next_one(stopped):
    def held(*rows):
        """Return the reason by verdicts (time, action, reason), which come with each change."""
        times, actions, words = zip(*rows)
        verdicts = Verdicts(np.array(times), list(actions), list(words))
        return reasons.blocked(stretch_of(replace(stopped, verdicts=verdicts)))

    # The stretch lasts from 3 to 6 s.
    stops_before = held((1.0, "pass", ""), (2.5, "stop", "a wall"), (5.4, "pass", ""))
    assert stops_before == "the collision monitor blocks 80 % of the commanded motion: a wall"
    stops_within = held((1.0, "pass", ""), (3.9, "stop", "a wall"))
    assert stops_within == "the collision monitor blocks 70 % of the commanded motion: a wall"
    assert held((1.0, "stop", "a wall"), (2.9, "pass", "")) == ""
    assert held((6.5, "stop", "a wall")) == ""


def test_of_several_reasons_the_monitor_held_for_the_one_of_most_time_is_said(stopped):
    # From 3 to 6 s: 0.9 s for the wall, 1.2 s for the chair, and 0.9 s for the wall again
    times = np.array([1.0, 3.9, 5.1])
    verdicts = Verdicts(times, ["stop"] * 3, ["a wall", "a chair", "a wall"])
    words = reasons.blocked(stretch_of(replace(stopped, verdicts=verdicts)))
    assert words == "the collision monitor blocks 100 % of the commanded motion: a wall"


def test_a_reversal_that_the_monitor_delays_is_a_reason_and_other_braking_is_none(stopped):
    def held(since, reason):
        """Return the reason if the monitor brakes the base from a time [s] on."""
        verdicts = Verdicts(np.array([1.0, since]), ["pass", "brake"], ["", reason])
        return reasons.blocked(stretch_of(replace(stopped, verdicts=verdicts)))

    # The stretch lasts from 3 to 6 s.
    assert held(3.9, REVERSING).startswith("the collision monitor blocks 70 % of ")
    assert held(5.4, REVERSING) == ""
    assert held(3.9, BRAKING) == ""


def test_a_monitor_that_blocks_each_way_ahead_is_a_reason_while_the_planner_backs_out(stopped):
    planned = stopped.planned
    # The planner drives forward in the first 0.4 s of each second, and backs out in the others.
    is_forward = np.arange(180) % 20 < 8
    twists = np.where(is_forward[:, None], (0.5, 0.0), (-0.1, 0.0))

    def blocked(blocked_s, backing=planned.time < 0.0):
        """Return the reason if the monitor blocks the robot for the first part of each second."""
        commanded = np.where(backing[:, None], (-0.1, 0.0), twists)
        drive = replace(stopped, planned=Commands(planned.time, commanded))
        shares = np.where(np.arange(180) % 20 < blocked_s * RATE_HZ, 0.0, 1.0)
        wall = Verdicts(np.array([0.0]), ["stop"], ["a wall"])
        return reasons.blocked(stretch_of(limited(drive, shares, wall)))

    words = "the collision monitor blocks 100 % of the commanded motion: a wall"
    assert blocked(0.39) == words
    assert blocked(0.1) == ""
    # One that only backs out is not kept from anything.
    assert blocked(0.39, backing=planned.time >= 0.0) == ""


def test_a_command_to_drive_sideways_asks_for_motion_and_a_steering_angle_does_not():
    def reason(angles, twist, sideways=0.0):
        """Return the reason of a base that stands with a command, by a parameter of its planner."""
        robot = JACKAL.with_parameters({JACKAL.local_planner: angles}, "cart")
        stands = drive_of(STANDS)
        commands = Commands(
            stands.planned.time, np.tile(twist, (60, 1)), np.full(60, float(sideways))
        )
        commanded = with_planned(replace(stands, planned=None, commands=commands), robot)
        return reasons.unmoved(stretch_of(commanded, 0.0, 3.0))

    words = "the base did not follow its commands of 0.40"
    assert reason({}, (0.0, 0.0), sideways=0.4) == f"{words} m/s"
    assert reason({}, (0.0, 0.4)) == f"{words} rad/s"
    has_angles = {"cmd_angle_instead_rotvel": True}
    assert reason(has_angles, (0.0, 0.4)) == ""
    assert reason(has_angles, (0.4, 0.4)) == f"{words} m/s"


def test_a_turn_that_does_not_reach_the_base_or_that_it_does_not_follow_is_a_reason(stopped):
    def with_commands(twist, measured=(0.0, 0.0)):
        """Return the drive if this is commanded, and the base drives as measured, all the time."""
        commands = Commands(stopped.planned.time, np.tile(twist, (180, 1)))
        odometry = replace(stopped.odometry, twist=np.tile(measured, (180, 1)))
        return replace(stopped, planned=commands, commands=commands, odometry=odometry)

    turns = with_commands((0.0, 0.4))
    words = "the base did not follow its commands of 0.40 rad/s"
    assert reasons.unmoved(stretch_of(turns)) == words
    nothing = Commands(turns.planned.time, 0.0 * turns.planned.twist)
    words = "100 % of the commanded motion does not reach the base"
    # A mux that is locked until the end may send nothing at all.
    silent = turns.planned.part(slice(0, 30))
    assert reasons.blocked(stretch_of(replace(turns, commands=silent))).startswith(words)
    assert reasons.blocked(stretch_of(replace(turns, commands=nothing))).startswith(words)

    # Turns to either side all pass, if a little later.
    alternating = np.where(np.arange(180) % 2, 1.0, -1.0)[:, None] * turns.planned.twist
    swings = replace(turns, planned=Commands(turns.planned.time, alternating))
    assert reasons.blocked(stretch_of(limited(swings, 1.0))) == ""

    # A base that turns on the spot as it is told follows.
    assert reasons.unmoved(stretch_of(with_commands((0.0, 0.4), measured=(0.0, 0.4)))) == ""
    # Commands so small ask for no motion.
    assert reasons.unmoved(stretch_of(with_commands((0.04, 0.15)))) == ""


def test_scans_that_stay_the_same_while_the_robot_goes_to_and_fro_are_no_reason(stopped):
    times = np.arange(0.0, 9.0, 0.1)
    poses = stopped.odometry.pose.copy()
    poses[1::2] = poses[0]  # It comes back each time.
    poses[::2] = poses[0] + (0.1, 0.0, 0.0)
    swinging = replace(
        stopped,
        odometry=replace(stopped.odometry, pose=poses),
        scans=scans_of(times, np.full(90, 2.0)),
    )
    assert swinging.odometry.length > 3.0
    assert reasons.stuck(stretch_of(swinging, 6.0, 9.0)) == ""


def test_scans_with_another_number_of_beams_are_not_compared(stopped):
    times = np.arange(0.0, 9.0, 0.1)
    scans = scans_of(times, np.full(90, 2.0))
    # Every other scan has a beam more, and other ranges.
    scans.ranges[1::2] = [np.full(4, 5.0, np.float32)] * 45
    drive = replace(stopped, scans=scans)
    assert reasons.stuck(stretch_of(drive, 6.0, 9.0)).startswith("the scans stay the same")


def test_a_robot_is_held_if_its_odometry_moves_far_and_its_scans_change_little(stopped):
    times = np.arange(0.0, 9.0, 0.1)

    def is_held(end, change):
        """Return whether a robot counts as held that drives at 0.5 m/s from 6 s to an end [s],
        while its ranges change by this much [m].
        """
        scans = scans_of(times, np.where(times > 6.05, 2.0 + change, 2.0))
        return bool(reasons.stuck(stretch_of(replace(stopped, scans=scans), 6.0, end)))

    # 0.6 m are far, 0.4 m are not.
    assert is_held(end=7.2, change=0.0)
    assert not is_held(end=6.8, change=0.0)
    # Noise changes ranges of 2 m by less than 0.09 m.
    assert is_held(end=9.0, change=0.08)
    assert not is_held(end=9.0, change=0.1)


def test_a_recovery_that_began_up_to_a_second_before_the_stop_is_a_reason(stopped):
    def reason(begin, next_plan):
        """Return the reason if a recovery begins, and the next plan comes, at these times [s]."""
        plans = Plans(np.array([0.0, next_plan]), [np.zeros((1, 3))] * 2)
        drive = replace(stopped, recoveries=np.array([begin]), plans=plans)
        return reasons.recovering(stretch_of(drive))

    # The stretch lasts from 3 to 6 s.
    assert reason(2.1, next_plan=8.0) == "a recovery behaviour ran"
    assert reason(1.9, next_plan=8.0) == ""
    # Only its time within the stretch counts: here 1.4 s, less than half of it.
    assert reason(2.1, next_plan=4.4) == ""


def test_commands_are_late_from_twice_the_control_period_on(stopped):
    def reason(interval):
        """Return the reason if commands come at this interval [s] instead of every 0.05 s."""
        times = np.arange(0.0, 9.0, interval)
        commands = Commands(times, np.zeros((len(times), 2)))
        return reasons.late(stretch_of(replace(stopped, planned=commands)))

    assert reason(0.09) == ""
    assert reason(0.11) == "commands came every 0.11 s instead of every 0.05 s"
    assert reasons.late(replace(stretch_of(stopped), period=0.0)) == ""


def test_late_commands_are_no_reason_for_a_wait_at_the_goal(stopped):
    every_fourth = stopped.planned.part(slice(0, None, 4))
    late = replace(stopped, planned=every_fourth)
    # From 6 s on the robot drives as it is told, so that no other reason comes first.
    creeps = Event("crept", 6.0, 9.0, (3.0, 0.0))
    waits = Event(AT_GOAL, 6.0, 9.0, (3.0, 0.0))
    for event in (creeps, waits):
        give_outside_reason(event, late, LIMITS)
        # The planner itself is late.
        assert not event.is_outside
    assert creeps.reason == "commands came every 0.20 s instead of every 0.05 s"
    assert waits.reason == ""
