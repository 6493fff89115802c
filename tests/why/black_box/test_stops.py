"""Tests of the detector of stops: it finds live, once, what why finds in the recorded drive."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.drives.columns import SECOND, Stamp
from applr_ros1.drives.received import Received
from applr_ros1.robots import JACKAL
from applr_ros1.why import events
from applr_ros1.why.black_box.stops import GAVE_UP, HELD, SAVED, StopDetector
from tests.support.measured_drives import DRIVES, STANDS, drive_of

BEGIN_S = 1_700_000_000.0  # time at which a drive begins [s]
LOOK_S = 0.5  # interval between two looks for a stop [s]
# The Jackal's top speed and turn rate by its files are 0.5 m/s and 1.57 rad/s.
TURNS = [(0.0, 0.4)] * 60
SWINGS = ([(0.5, 0.8)] * 5 + [(0.5, -0.8)] * 5) * 6
FRO = ([(0.4, 0.0)] * 30 + [(-0.4, 0.0)] * 30) * 4


def at(seconds):
    """Return the time of the robot's clock [ns] at a time of the drive [s]."""
    return round((BEGIN_S + seconds) * SECOND)


def messages_of(drive, has_goal=True, ended="", next_goal_at=np.inf, pause=0.0):
    """Return the messages of a drive, in order of time.

    Args:
        drive: The drive.
        has_goal: Whether move_base has a goal.
        ended: How the goal ended at the end of the drive.
        next_goal_at: Time from which on move_base has another goal [s].
        pause: Time without a goal before then [s].
    """
    messages = []
    odometry = drive.odometry
    for number, time in enumerate(odometry.time.tolist()):
        row = {name: getattr(odometry, name)[number] for name in ("pose", "twist", "sideways")}
        row.update(stamp=Stamp(0), frame="odom")
        messages.append(Received(at(time), "odometry", [row]))
    last_time = float(odometry.time[-1])
    for time in np.arange(0.0, last_time, 0.2):
        running = "one" if has_goal else ""
        if time >= next_goal_at:
            running = "another"
        elif time >= next_goal_at - pause:
            running = ""
        messages.append(Received(at(time), "goals", [{"running": running}]))
    if ended:
        messages.append(Received(at(last_time), "results", [{"id": "one", "status": ended}]))
    return sorted(messages, key=lambda message: message.recording_time)


def verdict(time, action, reason=""):
    """Return a message of the collision monitor."""
    row = {"action": action, "reason": reason}
    return Received(at(time), "verdicts", [row])


def stops_of(messages, detector=None, interval=LOOK_S):
    """Return the stops that are found while messages come, with the times at which they are.

    `interval` is the time between two looks for a stop [s].
    """
    detector = detector or StopDetector(JACKAL)
    stops = []
    due_time = messages[0].recording_time / SECOND
    for message in messages:
        time = message.recording_time / SECOND
        while due_time <= time:
            stop = detector.stop(due_time)
            if stop is not None:
                found_at = round(due_time - BEGIN_S, 3)
                since_begin = stop._replace(begin=stop.begin - BEGIN_S, end=stop.end - BEGIN_S)
                stops.append((found_at, since_begin))
            due_time += interval
        if detector.wants(message.key, message.recording_time):
            detector.take(message)
    return stops


def stop_count(messages):
    """Return the number of answered stops in minutes of a drive, with few looks.

    Each look takes milliseconds.
    """
    return [stop.number for _, stop in stops_of(messages, interval=2.0)].count(1)


@pytest.mark.parametrize(
    ("kind", "twists"),
    [
        ("stood", STANDS * 3),
        ("turned on the spot", TURNS * 3),
        ("crept", [(0.1, 0.1)] * 180),
        ("swung from side to side", SWINGS * 3),
        ("drove backwards", [(-0.15, 0.0)] * 160),
        ("went to and fro", FRO),
    ],
)
def test_each_kind_is_found_once_when_it_has_lasted_five_seconds(kind, twists):
    drive = drive_of(DRIVES + twists + DRIVES)
    ((found_at, stop),) = stops_of(messages_of(drive))
    assert stop.kind == kind
    if kind == "stood":
        assert stop.place[0] == pytest.approx(1.5, abs=0.05)
    # Changes of sign are counted within a second, and ways within four.
    slack = {"swung from side to side": 1.1, "went to and fro": 4.0}.get(kind, 0.1)
    assert stop.begin == pytest.approx(3.0, abs=slack)
    assert stop.begin + 4.9 <= found_at <= stop.begin + 5.0 + LOOK_S + 2 * slack


def test_a_robot_that_stops_in_another_way_and_elsewhere_without_a_pause_stops_again():
    def kinds(*twists):
        """Return the kinds of the stops of a robot that drives for three seconds before."""
        drive = drive_of(sum(twists, DRIVES))
        return [stop.kind for _, stop in stops_of(messages_of(drive))]

    # It creeps for 3 m, and then goes to and fro.
    creeps = [(0.1, 0.0)] * 600
    assert kinds(creeps, FRO * 2) == ["crept", "went to and fro"]
    # Within the view, or within the robot's length, it is the same stop.
    assert len(kinds(creeps[:100], FRO)) == 1
    assert len(kinds(STANDS * 10, FRO)) == 1
    # Creeping on is the same stop, however far.
    assert len(kinds(creeps * 3)) == 1


def test_a_robot_that_stands_with_a_new_goal_stops_again_after_two_minutes():
    stands = drive_of(DRIVES + STANDS * 60)
    assert stop_count(messages_of(stands)) == 1
    for pause in (0.0, 2.0):
        late_messages = messages_of(stands, next_goal_at=150.0, pause=pause)
        found_times = [found_at for found_at, _ in stops_of(late_messages)]
        assert found_times == pytest.approx([8.0, 155.2], abs=0.5)
        assert stop_count(messages_of(stands, next_goal_at=100.0, pause=pause)) == 2
        early_messages = messages_of(drive_of(DRIVES + STANDS * 35), next_goal_at=90.0, pause=pause)
        assert stop_count(early_messages) == 1
        # Turning there is no other stop.
        turns = drive_of(DRIVES + STANDS * 15 + TURNS * 15)
        assert stop_count(messages_of(turns, next_goal_at=48.0, pause=pause)) == 1
    # If the new goal is given up, too, this is known.
    messages = messages_of(stands, next_goal_at=150.0, ended="aborted") + [verdict(184.0, "pass")]
    assert [stop.kind for _, stop in stops_of(messages, interval=2.0)] == ["stood", "stood"]
    messages = messages_of(stands, next_goal_at=180.0, ended="aborted") + [verdict(184.0, "pass")]
    assert [stop.kind for _, stop in stops_of(messages, interval=2.0)] == ["stood", GAVE_UP]


def test_stops_at_one_place_within_two_minutes_are_counted():
    def counts(*twists, **options):
        """Return the numbers of the stops at their places."""
        drive = drive_of(sum(twists, DRIVES))
        return [stop.number for _, stop in stops_of(messages_of(drive, **options), interval=1.0)]

    # A circle of 15.7 s leads back to the place of the stop.
    round_trip = [(0.5, 0.4)] * 314
    stands = STANDS * 2
    assert counts(stands, round_trip, stands, round_trip, stands, DRIVES) == [1, 2, 3]
    assert counts(stands, round_trip, stands, DRIVES * 2, stands) == [1, 2, 1]
    # A robot that stands on with a new goal, and then for two minutes
    assert counts(STANDS * 20, next_goal_at=30.0) == [1, 2]
    assert counts(STANDS * 60, next_goal_at=100.0) == [1, 2, 1]


def test_an_application_that_sends_its_goal_each_second_stops_the_robot_once():
    messages = messages_of(drive_of(DRIVES + STANDS * 10))
    for message in messages:
        if message.key == "goals":
            message.rows[0]["running"] = str(message.recording_time // SECOND)
    assert len(stops_of(messages)) == 1


@pytest.mark.parametrize("sideways", [0.4, -0.4])
def test_a_robot_that_drives_sideways_does_not_stand(sideways):
    strafes = np.repeat([0.0, sideways, 0.0], [60, 180, 60])
    drive = drive_of(DRIVES + STANDS * 3 + DRIVES, sideways=strafes)
    assert stops_of(messages_of(drive)) == []
    # Its poses show it as well.
    still = replace(drive.odometry, twist=0.0 * drive.odometry.twist, sideways=0.0 * strafes)
    assert stops_of(messages_of(replace(drive, odometry=still))) == []


def of_flex(messages, clients):
    """Return messages whose goals are those of these actions of move_base_flex."""
    flex_messages = []
    for message in messages:
        if message.key != "goals":
            flex_messages.append(message)
            continue
        for action in ("get_path", "exe_path", "move_base"):
            goal = message.rows[0]["running"]
            running = f"{action} {goal}" if goal and action in clients else ""
            status = {"running": running, "action": action}
            flex_messages.append(message._replace(rows=[status]))
    return flex_messages


@pytest.mark.parametrize("clients", [("move_base", "exe_path"), ("exe_path",), ("get_path",)])
def test_beside_move_base_flex_stops_are_the_same(clients):
    # Given: a stop with a goal, and a longer stand until the next goal
    drive = drive_of(DRIVES + STANDS * 2 + DRIVES + STANDS * 4 + DRIVES)
    messages = messages_of(drive, next_goal_at=24.0, pause=12.0)
    stops = stops_of(messages)
    assert [stop.kind for _, stop in stops] == ["stood"]
    assert stops_of(of_flex(messages, clients)) == stops


def test_short_stops_slow_drives_and_robots_without_a_goal_do_not_stop():
    four_seconds = STANDS + STANDS[:20]
    assert stops_of(messages_of(drive_of(DRIVES + four_seconds + DRIVES))) == []
    slow = [(0.2, 0.1)] * 400
    assert stops_of(messages_of(drive_of(DRIVES + slow))) == []
    stands = drive_of(DRIVES + STANDS * 4)
    assert stops_of(messages_of(stands, has_goal=False)) == []


def test_speeds_are_measured_by_the_limit_in_force_also_when_it_left_the_view():
    slow = messages_of(drive_of([(0.1, 0.1)] * 1000))
    values = {"max_vel_x": 0.12}
    server = JACKAL.local_planner
    lowered = Received(at(0.0), "changes", [{"server": server, "values": values}])
    # 0.1 m/s of 0.12 are no creeping, those of 0.5 are.
    assert stops_of([lowered, *slow]) == []
    assert len(stops_of(slow)) == 1


def test_a_goal_that_is_given_up_is_a_stop_unless_the_robot_is_known_to_stand():
    drives = drive_of(DRIVES * 2)
    after = [verdict(7.0, "pass")]  # Time goes on.
    ((_, stop),) = stops_of(messages_of(drives, ended="aborted") + after)
    assert stop.kind == GAVE_UP
    assert stop.begin == pytest.approx(5.95, abs=0.2)  # The status comes five times a second.
    assert stops_of(messages_of(drives, ended="reached") + after) == []

    stands = drive_of(DRIVES + STANDS * 3)
    ((_, known_stop),) = stops_of(messages_of(stands, ended="aborted") + [verdict(13.0, "pass")])
    assert known_stop.kind == "stood"


def test_a_robot_that_the_monitor_holds_for_three_seconds_stops():
    # Its odometry goes on: the robot slides, or is pushed.
    messages = messages_of(drive_of(DRIVES * 4))
    held = [verdict(1.0, "stop", "a wall"), verdict(2.0, "stop", "another wall")]

    def stops(*verdicts):
        """Return the stops with these verdicts."""
        in_order = sorted([*messages, *verdicts], key=lambda message: message.recording_time)
        return stops_of(in_order)

    ((found_at, stop),) = stops(*held)
    assert stop.kind == HELD
    assert stop.begin == pytest.approx(1.0)
    assert found_at == 4.0
    assert stops(*held, verdict(3.5, "pass")) == []
    # A reason that was said before the view still holds.
    long_drive = messages_of(drive_of(DRIVES * 20))
    late_goal = [message for message in long_drive if message.key == "odometry"]
    late_goal += [m for m in long_drive if m.key == "goals" and m.recording_time > at(50.0)]
    late_goal.sort(key=lambda message: message.recording_time)
    ((_, late_stop),) = stops_of([held[0], *late_goal])
    assert late_stop.begin == pytest.approx(50.2, abs=0.25)


def test_a_goal_ends_with_its_status_for_a_robot_that_the_monitor_holds():
    messages = messages_of(drive_of(DRIVES * 4))

    def found_with_status_until(last_status):
        """Return when stops are found if move_base sends no status after a time [s]."""
        kept = [verdict(1.0, "stop", "a wall")]
        for message in messages:
            if message.key != "goals" or message.recording_time <= at(last_status):
                kept.append(message)
        kept.sort(key=lambda message: message.recording_time)
        return [found_at for found_at, _ in stops_of(kept)]

    # After 3 s of holding, at 4 s, the status may have been missing for up to a second.
    assert found_with_status_until(3.2) == [4.0]
    assert found_with_status_until(2.8) == []


def test_a_goal_that_is_given_up_long_after_the_odometry_fell_silent_is_a_stop():
    messages = messages_of(drive_of(DRIVES * 10), ended="aborted")
    silent = [m for m in messages if m.key != "odometry" or m.recording_time < at(1.0)]
    after = [verdict(31.0, "pass")]  # Time goes on.
    (_, unheard), (_, given_up) = stops_of(silent + after)
    assert (unheard.kind, given_up.kind) == (events.UNHEARD, GAVE_UP)
    assert unheard.begin == pytest.approx(0.95, abs=0.1)
    assert given_up.begin == pytest.approx(29.95, abs=0.2)


def test_the_detector_starts_anew_when_the_clock_jumps_back():
    detector = StopDetector(JACKAL)
    drive = drive_of(DRIVES + STANDS * 3 + DRIVES)
    assert len(stops_of(messages_of(drive), detector)) == 1
    detector.forget()
    assert len(stops_of(messages_of(drive), detector)) == 1


def test_a_save_that_is_asked_for_has_the_robots_place():
    detector = StopDetector(JACKAL)
    for message in messages_of(drive_of(DRIVES)):
        if detector.wants(message.key, message.recording_time):
            detector.take(message)
    stop = detector.asked(BEGIN_S + 3.0)
    assert stop.kind == SAVED
    assert stop.place[0] == pytest.approx(1.5, abs=0.05)
