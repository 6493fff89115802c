"""Tests of the world that the laser saw, of whole drives in it, of candidates, and of the advice
that follows.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Plans, SentGoal
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import Change, Settings
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import Diagnosis, diagnose
from applr_ros1.why.events import Event
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import replay_of
from tests.support.drives import simulated
from training.attempts import trials as whole_drives
from training.attempts.candidates import Candidate, with_changes
from training.attempts.trials import (
    RECORDED,
    Arrival,
    DriveConditions,
    DrivenCourse,
    Tried,
    WholeDriveTrials,
    course_in,
    try_out,
)
from training.attempts.usual_values import COSTMAPS
from training.robot.open_floor import courses
from training.why import remedies
from training.why.driven import with_trials
from training.why.remedies import recorded_changes
from training.why.seen_world import seen_grid, seen_world, write_map
from training.workers.calls import CallLost
from training.workers.pool import Pool
from worlds import load, scaled
from worlds.map_reader import is_occupied, read_map
from worlds.world import clearance

PLANNER = "TrajectoryPlannerROS"
JACKAL = robots.JACKAL
BURGER = robots.load("turtlebot3_burger")
# The recorded drive's fault and its remedy. A planner with one sample knows only its slowest
# speed.
SPOILT = Change(PLANNER, "vx_samples", 6, 1)
# With its own padding, a sound Jackal hesitates at the narrow door with some seeds.
UNPADDED = [Change(costmap, "footprint_padding", 0.1, 0.01) for costmap in COSTMAPS]
MENDED = Candidate((Change(PLANNER, "vx_samples", 1, 6),))
CAUSE = MENDED._replace(replaces_unusual=True)


@pytest.fixture(scope="module")
def door():
    """Return the drive of a Jackal that drives very slowly through a door, and the world."""
    *_, door_world = courses(JACKAL)
    robot = with_changes(JACKAL, [SPOILT], "jackal")
    drive, _ = simulated(robot, door_world, limit=15)
    return drive, door_world


# -- the world that the laser saw
def seen_by(drive, robot, start=(0.0, 0.0, np.pi / 2), goal=(0.0, 5.0, np.pi / 2)):
    """Return the world that the laser of a robot saw in a drive."""
    return seen_world(seen_grid(Recording.of(drive, robot)), "seen", start, goal)


def test_walls_stand_where_the_laser_saw_them_and_the_door_stays_open(door):
    drive, _ = door
    world = seen_by(drive, JACKAL)
    # The laser saw the face of the wall, 0.05 m before its middle at 2.5 m.
    on_walls = np.array([(-3.0, 2.45), (-0.45, 2.45), (0.45, 2.45), (3.0, 2.45)])
    assert clearance(world, on_walls).max() < 0.03
    # The door is 0.83 m wide, and walls do not grow.
    on_floor = np.array([(0.0, 2.5), (0.0, 1.5), (2.0, 1.0)])
    assert clearance(world, on_floor).min() > 0.41


@pytest.mark.heavy
def test_a_sound_robot_arrives_in_the_seen_world_of_a_drive_that_arrived():
    """The gaps are those of a small robot: cells of 0.05 m would close them."""
    world = scaled(load("generated:211"), BURGER.world_scale)
    to_goal = replace(world, course=replace(world.course, finish_y=None))
    drive, outcome = simulated(BURGER, to_goal)
    assert outcome.success
    goal = Recording.of(drive, BURGER).goal_at(math.inf).pose
    conditions = DriveConditions(BURGER, seen_by(drive, BURGER, goal=goal), False, limit=60.0)
    for seed in (3, 4):
        assert whole_drives.drive_once(conditions, (), seed, math.inf).success


def test_what_most_beams_pass_is_free_although_a_few_ended_there(door):
    drive, _ = door
    grid = seen_grid(Recording.of(drive, JACKAL))
    # Something stands beside the way to the door in two scans, and moves on.
    ranges = [scan_ranges.copy() for scan_ranges in drive.scans.ranges]
    beside_door = len(ranges[0]) // 2 + 60
    for scan_ranges in ranges[:2]:
        scan_ranges[beside_door : beside_door + 5] *= 0.5
    passer_by = replace(drive, scans=replace(drive.scans, ranges=ranges))
    assert np.array_equal(seen_grid(Recording.of(passer_by, JACKAL)).cells, grid.cells)


def test_a_written_map_is_read_as_it_was_seen(door, tmp_path):
    drive, _ = door
    grid = seen_grid(Recording.of(drive, JACKAL))
    map_file = str(tmp_path / "seen.yaml")

    write_map(grid, map_file)
    read_back = read_map(map_file)

    # Without an edge of occupied cells, all free cells would be outside of the building.
    occupied = is_occupied(grid.cells)
    occupied_in_file = is_occupied(read_back.cells)
    assert occupied_in_file[[0, -1]].all()
    assert occupied_in_file[:, [0, -1]].all()
    assert np.array_equal(occupied_in_file[1:-1, 1:-1], occupied[1:-1, 1:-1])
    assert read_back.resolution == grid.resolution
    assert read_back.origin == pytest.approx(grid.origin)


# -- candidates
def values(robot, server, name):
    """Return a parameter's value in a move_base of the robot's files."""
    move_base = MoveBase(robot.parameters())
    settings = Settings.from_tree(move_base.parameters)
    return settings[server][name]


def test_a_change_reaches_move_base_also_where_a_costmap_makes_its_layers_itself():
    # The Burger's files list the layers as plugins. The Jackal's do not, so that its costmap
    # makes layers with the names of old.
    layer = "local_costmap/inflation_layer"
    smaller = Change(layer, "inflation_radius", 1.0, 0.4)
    changed_robot = with_changes(BURGER, [smaller], "changed")
    assert values(changed_robot, layer, "inflation_radius") == 0.4

    layer = "local_costmap/inflater_layer"
    larger = Change(layer, "inflation_radius", 0.3, 0.4)
    changed_robot = with_changes(JACKAL, [larger], "changed")
    assert values(changed_robot, layer, "inflation_radius") == 0.4


def test_files_get_the_settings_of_the_recorded_drive():
    move_base = MoveBase(JACKAL.parameters())
    file_settings = Settings.from_tree(move_base.parameters)
    recorded_settings = file_settings.with_(SPOILT)
    assert recorded_changes(JACKAL, file_settings) == []
    (change,) = recorded_changes(JACKAL, recorded_settings)
    assert change.server == PLANNER
    assert change.name == "vx_samples"
    assert change.after == 1


# -- whole drives
@pytest.fixture(scope="module")
def course(door):
    """Return the way through the door in the world that the laser saw, with the recorded fault."""
    drive, _ = door
    robot = with_changes(JACKAL, [SPOILT, *UNPADDED], "jackal")
    return DriveConditions(robot, seen_by(drive, JACKAL), has_monitor=False, limit=25.0)


@pytest.mark.heavy
def test_the_fault_is_slow_in_the_world_that_was_seen_and_its_remedy_is_found(course, monkeypatch):
    # One seed instead of two chooses: these drives are simulated.
    monkeypatch.setattr(whole_drives, "CHOOSING", (1,))
    monkeypatch.setattr(whole_drives, "CONFIRMING", (2, 3, 4, 5, 6, 7))
    # move_base does not accept a footprint of one point, so this candidate cannot drive.
    one_point = Change("local_costmap", "footprint", "", "[[0, 0]]")
    refused = Candidate((one_point,))

    with Pool(0) as pool:
        patient = course._replace(limit=40.0)
        trials = try_out([course_in(patient, pool)], [refused, MENDED])

    assert trials.remedy.candidate == MENDED
    assert trials.remedy.arrivals >= 5
    assert trials.recorded.arrivals == 0
    (tried_out,) = trials.tried
    assert tried_out.candidate == MENDED


def drives_as(monkeypatch, seconds):
    """Let a candidate take {value: {seed: seconds}} with "" for the recorded values; return the
    calls.
    """
    calls = []

    def drive_once(course, changes, seed, to_beat):
        sim_time = changes[0].after if changes else ""
        calls.append((sim_time, seed))
        # Seed 0 stands for all seeds that have no time of their own.
        seconds_of_seed = seconds[sim_time]
        duration = seconds_of_seed.get(seed, seconds_of_seed[0])
        is_slow = duration > to_beat
        success = duration < course.limit and not is_slow
        if not success:
            duration = course.limit
        return Arrival(success, duration, is_slow, path=np.zeros((1, 3)))

    monkeypatch.setattr(whole_drives, "drive_once", drive_once)
    return calls


def trials_of(course, *values):
    """Try values of sim_time out; return the trials."""
    candidates = []
    for sim_time in values:
        change = Change(PLANNER, "sim_time", 2.0, sim_time)
        candidates.append(Candidate((change,)))
    with Pool(0) as pool:
        return try_out([course_in(course, pool)], candidates)


def value_of(tried_out):
    """Return the value of sim_time that a candidate tried."""
    return tried_out.candidate.changes[0].after


def seeds_of(calls, value):
    """Return the seeds with which a value was driven."""
    return {seed for called_value, seed in calls if called_value == value}


def test_a_candidate_is_a_remedy_only_if_it_is_better_by_a_tenth_with_seeds_that_chose_nothing(
    course, monkeypatch
):
    calls = drives_as(monkeypatch, {"": {0: 20.0}, 1.0: {0: 15.0}, 1.5: {0: 17.0}})
    trials = trials_of(course, 1.0, 1.5)
    assert value_of(trials.remedy) == 1.0
    assert str(trials.remedy) == "arrives 6 of 6 in 15 s"
    assert seeds_of(calls, 1.5) == set(whole_drives.CHOOSING)
    assert seeds_of(calls, 1.0) == {1, 2, 3, 4, 5, 6, 7, 8}

    # 18.5 s are less than a tenth better than 20 s.
    drives_as(monkeypatch, {"": {0: 20.0}, 1.0: {0: 18.5}})
    assert trials_of(course, 1.0).remedy is None

    # The seeds 1 and 2 choose. With the seeds that confirm, it is as slow as the recorded value.
    drives_as(monkeypatch, {"": {0: 20.0}, 1.0: {0: 20.0, 1: 12.0, 2: 12.0}})
    assert trials_of(course, 1.0).remedy is None


def test_it_is_said_why_the_recorded_values_cannot_be_driven():
    def lost():
        raise CallLost("its worker died 3 times")

    lossy = DrivenCourse(JACKAL, False, begin=lambda changes, seed, limit: lost)
    problem = "the recorded values cannot be driven in simulation: its worker died 3 times"
    with pytest.raises(ApplrError, match=problem):
        try_out([lossy], [MENDED])


def test_a_candidate_whose_gain_may_be_luck_is_no_remedy(course, monkeypatch):
    # Much faster on average, but in eight of the twelve drives that judge not at all
    equal = dict.fromkeys((5, 6, 7, 8, 9, 10, 11, 12), 20.0)
    drives_as(monkeypatch, {"": {0: 20.0}, 1.0: {0: 5.0, **equal}})
    trials = trials_of(course, 1.0)
    assert trials.remedy is None
    assert [str(entry) for entry in trials.judged] == ["arrives 12 of 12 in 15 s"]

    # One drive as slow as before may be bad luck, but two looks are two chances for good luck.
    drives_as(monkeypatch, {"": {0: 20.0}, 1.0: {0: 5.0, 8: 20.0}})
    assert trials_of(course, 1.0).remedy.arrivals == 12


def test_the_second_best_is_judged_if_the_best_is_no_remedy(course, monkeypatch):
    # With 1.0 and 0.5, most of the drives that judge are slower than with the recorded values.
    slow = dict.fromkeys((4, 5, 6, 7, 9, 10, 11, 12), 21.0)
    seconds = {
        "": {0: 20.0},
        1.0: {0: 10.0, **slow},
        1.5: {0: 11.0},
        0.5: {0: 10.5, **slow},
    }
    calls = drives_as(monkeypatch, seconds)
    trials = trials_of(course, 1.0, 1.5)
    assert value_of(trials.remedy) == 1.5
    # The recorded values are judged once.
    assert calls.count(("", 4)) == 1

    # The third best is not: of many, one is better by chance.
    drives_as(monkeypatch, {**seconds, 1.5: {0: 12.0}})
    assert trials_of(course, 1.0, 0.5, 1.5).remedy is None


@pytest.mark.parametrize(
    ("milder", "wilder"),
    [
        # sim_time was 2 s: 0.2 is a tenth of it, and 1.0 half.
        (1.0, 0.2),
        # The default is 1.7 s. No robot has a value near 3.0, which is nearer to 2.
        (1.25, 3.0),
    ],
)
def test_the_milder_of_two_changes_that_are_about_as_fast_is_the_remedy(
    course, monkeypatch, milder, wilder
):
    # Half a second's gain is not worth the wilder change, five seconds' is.
    for seconds, value in ((14.5, milder), (10.0, wilder)):
        drives_as(monkeypatch, {"": {0: 20.0}, wilder: {0: seconds}, milder: {0: 15.0}})
        assert value_of(trials_of(course, wilder, milder).remedy) == value


def test_only_the_best_candidates_drive_with_more_seeds(course, monkeypatch):
    # Eight values of sim_time [s], each of which takes as many seconds as its number says
    seconds_of = {float(number): {0: float(number)} for number in range(10, 18)}
    calls = drives_as(monkeypatch, {"": {0: 20.0}, **seconds_of})
    trials = trials_of(course, *seconds_of)
    assert {value for value, seed in calls if seed == 2} == {"", 10.0, 11.0, 12.0}
    assert len(trials.tried) == 8


def test_a_candidate_much_slower_than_the_best_of_an_earlier_round_is_broken_off(
    course, monkeypatch
):
    # In the order in which they drive: three in the first round, three in the second. The first
    # round's best takes 10 s, of which 13 s are more than 1.25 times.
    seconds_of = {float(number): {0: float(number)} for number in (16, 10, 17, 12, 13, 11)}
    drives_as(monkeypatch, {"": {0: 20.0}, **seconds_of})
    texts = {}
    for tried_out in trials_of(course, *seconds_of).tried:
        texts[value_of(tried_out)] = str(tried_out)
    # The first round has only the recorded values to beat.
    assert texts[17.0] == "arrives 1 of 1 in 17 s"
    assert texts[12.0] == "arrives 2 of 2 in 12 s"
    assert texts[13.0] == "too slow in 1 of 1"


# -- the answer
@pytest.fixture(scope="module")
def replayed(door):
    """Return the replay of the drive through the door."""
    drive, _ = door
    robot = with_changes(JACKAL, [SPOILT], "jackal")
    return replay_of(Recording.of(drive, robot))


def diagnosed(replay, trials=None, guesses=(), **changes):
    """Return the answer for a replay with one event, at the door."""
    event = Event("stood", begin=3.0, end=9.0, place=(0.0, 0.3), reason="a reason")
    diagnosis = Diagnosis.of(replay, [replace(event, **changes)])
    return with_trials(answer_of(diagnosis, guesses), trials)


def tried(candidate, *seconds, limit=25.0, at=(0.0, 0.3)):
    """Return the drives of a candidate that took some times [s]; from the limit on, one did not
    arrive.

    All stop for five seconds at one place, by default where the event of `diagnosed` is.
    """
    times = np.arange(100) * 0.05
    path = np.column_stack([times, np.tile(at, (100, 1))])
    drives = []
    for duration in seconds:
        success = duration < limit
        drives.append(Arrival(success, min(duration, limit), is_slow=False, path=path))
    return Tried(candidate, drives)


def test_the_answer_says_what_happened_what_helped_when_it_was_driven_and_how_sure_it_is(replayed):
    remedy = tried(MENDED, 12.0, 13.0, 14.0)
    trials = WholeDriveTrials(tried(RECORDED, 29.0, 29.0, 21.0), remedy, [remedy])
    event_line, advice, certainty, *_ = diagnosed(replayed, trials).lines
    assert event_line == "3.0 to 9.0 s: stood at (0.00, 0.30), because a reason."
    assert advice == (
        "Try vx_samples 1 -> 6: in simulation, the robot arrives 3 of 3 in 13 s; "
        "with the recorded values, it arrives 1 of 3 in 21 s."
    )
    assert "commands reproduced (100.0%)" in certainty
    assert certainty.endswith("simulated with the recorded values, the robot stops there, too.")


@pytest.mark.parametrize(
    ("candidate", "seen", "is_cause"),
    [
        (CAUSE, {}, True),
        # Another value than a usual one may make up for the cause.
        (MENDED, {}, False),
        # Without the fault, the simulated robot does not stop where a silent laser stopped it ...
        (CAUSE, {"is_outside": True, "place": (0.0, 3.0)}, False),
        # ... but it does where the global planner finds no path.
        (CAUSE, {"is_outside": True}, True),
    ],
)
def test_the_first_line_names_an_unusual_value_that_was_driven_with_and_without(
    replayed, candidate, seen, is_cause
):
    remedy = tried(candidate, 12.0, 13.0, 14.0)
    trials = WholeDriveTrials(tried(RECORDED, 21.0, 21.0, 21.0), remedy, [remedy])
    first_line = diagnosed(replayed, trials, **seen).first_line
    assert first_line.endswith(" Likely cause: vx_samples 1.") == is_cause


def test_without_a_remedy_only_a_guess_that_gains_much_is_said(replayed):
    no_remedy = WholeDriveTrials(tried(RECORDED, 12.0), None, [tried(MENDED, 12.0)])
    change = Change(PLANNER, "sim_time", 2.0, 1.0)

    def advice(trials, gain):
        """Return the line of advice, with one guess that gains some speed [m/s]."""
        guess = SimpleNamespace(gain=gain, change=change, changes=(change,))
        return diagnosed(replayed, trials, [guess]).lines[1]

    guess_line = "The replay's guess: sim_time 2 -> 1."
    in_vain_line = "Nothing that was tried in simulation helped."
    assert advice(no_remedy, gain=0.2) == f"{in_vain_line} {guess_line}"
    assert advice(no_remedy, gain=0.01) == in_vain_line
    assert advice(None, gain=0.2) == guess_line

    # A guess that was driven in vain is none.
    driven_guess = tried(Candidate((change,)), 12.0)
    in_vain = WholeDriveTrials(tried(RECORDED, 12.0), None, [driven_guess])
    assert advice(in_vain, gain=0.2) == in_vain_line


def test_what_other_seeds_did_is_said_of_a_candidate_that_looked_better(replayed):
    chosen = tried(MENDED, 8.0, 8.0)
    judged = tried(MENDED, 12.0, 12.0, 9.0)
    trials = WholeDriveTrials(tried(RECORDED, 12.0), None, [chosen], [judged])
    lines = diagnosed(replayed, trials).lines
    assert lines[1] == "Nothing that was tried in simulation helped clearly."
    assert lines[-1] == (
        "   vx_samples 1 -> 6: arrives 2 of 2 in 8 s; with other seeds arrives 3 of 3 in 11 s"
    )


def test_a_drive_that_lost_little_time_says_why_nothing_was_tried(replayed):
    line = "No change was tried: the robot lost little time."
    assert diagnosed(replayed, end=3.1).advice == [line]
    # A moment that somebody asks about is short, too.
    assert diagnosed(replayed, end=3.1, is_asked=True).advice == []


def test_no_advice_rests_on_a_world_in_which_the_robot_does_not_come_as_far_as_it_came(
    replayed,
):
    # With a metre to spare, all simulated drives end where the robot was after nine seconds.
    remedy = tried(MENDED, 12.0)
    stays_behind = WholeDriveTrials(tried(RECORDED, 29.0, at=(0.0, -2.0)), remedy, [remedy])
    comes_as_far = WholeDriveTrials(tried(RECORDED, 29.0, at=(0.0, 1.0)), remedy, [remedy])
    assert diagnosed(replayed, comes_as_far).advice[0].startswith("Try vx_samples 1 -> 6: ")
    # It stops where the recorded robot stopped, and nowhere with the remedy.
    at_stop = comes_as_far._replace(recorded=tried(RECORDED, 29.0, at=(0.0, 0.3)))
    assert diagnosed(replayed, at_stop).advice[0].startswith("Try vx_samples 1 -> 6: ")
    assert "so no advice" in diagnosed(replayed, at_stop._replace(remedy=None)).sure

    answer = diagnosed(replayed, stays_behind)

    # Nor can it be said that nothing helps.
    assert answer.advice == []
    assert answer.remedies == []
    assert answer.sure.endswith(
        "the robot does not come as far as it did, so no advice rests on what was driven."
    )


def test_a_stop_of_the_simulated_drive_elsewhere_is_another_one(replayed):
    trials = WholeDriveTrials(tried(RECORDED, 12.0), None, [])
    far_away = diagnosed(replayed, trials, place=(4.0, 4.0))
    assert "the robot does not stop there." in far_away.sure


def test_a_doubtful_replay_is_called_so(replayed):
    # A third of the commands is not reproduced.
    cycles = list(replayed.cycles)
    for row in range(0, len(cycles), 3):
        cycles[row] = replace(cycles[row], error=1.0)
    doubtful = replace(replayed, cycles=cycles)
    certainty = diagnosed(doubtful).sure
    assert "% of the planner's commands are reproduced, so its reasons are not to" in certainty


@pytest.mark.parametrize("columns", ["routes", "sent"])
def test_of_several_goals_the_one_of_the_event_counts_and_one_sent_again_is_one(door, columns):
    # Given: a patrol from B to A and to B again, whose goals are sent every second
    drive, _ = door
    # In the odometry's frame, a goal on a map moves a little with each correction.
    here = (0.0, 0.5, 1.0)
    goals = [(2.0 + 0.01 * row, 0.0, 0.0) for row in range(10)]
    goals[4:7] = [here] * 3
    times = np.arange(10.0)
    if columns == "routes":
        routes = Plans(times, [np.array([(9.0, 9.0, 0.0), goal]) for goal in goals])
        recording = Recording.of(replace(drive, routes=routes), JACKAL)
    else:
        sent = [SentGoal(time, goal, drive.frame) for time, goal in zip(times, goals)]
        recording = Recording.of(replace(drive, routes=None, sent=sent), JACKAL)

    assert recording.goal_at(-1.0) == recording.goal_at(3.9) == (goals[3], -math.inf, 4.0)
    assert recording.goal_at(4.0) == recording.goal_at(6.9) == (here, 4.0, 7.0)
    assert recording.goal_at(7.0) == recording.goal_at(math.inf) == (goals[9], 7.0, math.inf)


def test_of_a_drive_with_several_goals_the_course_to_the_one_of_the_event_is_driven(replayed):
    # Given: a drive whose robot got another goal after five seconds, and stood on the way to it
    drive = replayed.drive
    first_goal = np.array([(0.0, 0.0, 0.0), (0.0, -3.0, 0.0)])
    x, y, _ = drive.odometry.pose[-1]
    second_goal = np.array([(0.0, 0.0, 0.0), (x, y, 0.0)])
    routes = Plans(np.array([0.0, 5.0]), [first_goal, second_goal])
    recording = Recording.of(replace(drive, routes=routes), replayed.robot)
    event = Event("crept", 4.0, 12.0, (0.0, 0.3))

    conditions = remedies.course_of(Diagnosis.of(replay_of(recording), [event]), []).conditions

    course = conditions.world.course
    assert course.goal == (x, y, 0.0)
    row = drive.odometry.latest(5.0)
    assert course.start[:2] == pytest.approx(drive.odometry.pose[row, :2], abs=0.01)
    way_seconds = drive.odometry.time[-1] - 5.0
    expected_limit = max(whole_drives.SLOWEST * way_seconds, whole_drives.SHORTEST_LIMIT_S)
    assert conditions.limit == pytest.approx(expected_limit, abs=0.2)


def test_whole_drives_may_take_half_as_long_again_as_the_recorded_one():
    assert whole_drives.limit_of(100.0, 20.0) == 150.0
    assert whole_drives.limit_of(10.0, 5.0) == 20.0
    # A drive that did not arrive gives no time. A straight way of 10 m takes a Burger 45 s.
    assert whole_drives.limit_of(math.inf, 20.0) == 60.0
    assert whole_drives.limit_of(math.inf, 10.0 / 0.22) == pytest.approx(136.4, abs=0.1)


def test_the_end_of_a_followed_part_far_from_the_robot_is_no_goal(door):
    drive, _ = door
    without_routes = replace(drive, routes=None, sent=[])
    far_plan = drive.plans.path[-1] + (0.0, 5.0, 0.0)
    far_away = replace(without_routes, plans=Plans(drive.plans.time[-1:], [far_plan]))
    assert Recording.of(far_away, JACKAL).goal_at(math.inf) is None

    x, y, _ = drive.odometry.pose[-1]
    near_plan = np.array([(x, y + 1.0, 0.5)])
    near = replace(without_routes, plans=Plans(drive.plans.time[-1:], [near_plan]))
    assert Recording.of(near, JACKAL).goal_at(math.inf).pose == pytest.approx((x, y + 1.0, 0.5))

    in_map = SentGoal(0.0, (1.0, 2.0, 0.0), "map")
    in_odometry = SentGoal(0.0, (3.0, 4.0, 0.0), drive.frame)
    sent = replace(far_away, sent=[in_odometry, in_map])
    assert Recording.of(sent, JACKAL).goal_at(math.inf).pose == (3.0, 4.0, 0.0)


def test_nothing_is_driven_for_a_part_of_the_robot_or_a_moment_that_is_asked_about(
    replayed, monkeypatch
):
    monkeypatch.setattr(remedies, "try_out", lambda *args: "trials")
    event = Event("crept", 1.0, 12.0, (0.0, 0.3))
    moment = replace(event, is_asked=True)
    with Pool(0) as pool:
        assert remedies.driven_trials(Diagnosis.of(replayed, [event]), [], pool) == "trials"
        assert remedies.driven_trials(Diagnosis.of(replayed, [moment]), [], pool) is None
        with_part = Diagnosis.of(replayed, [event], part=(0.5, 0.0))
        assert remedies.driven_trials(with_part, [], pool) is None


def test_whole_drives_plan_in_the_frame_in_which_the_robot_planned(replayed, monkeypatch):
    robots_driven = []
    monkeypatch.setattr(
        remedies, "try_out", lambda courses, *rest: robots_driven.append(courses[0].robot)
    )
    for frame in ("odom", "matched"):
        drive = replace(replayed.drive, frames={"routes": [frame]})
        replay = replay_of(Recording.of(drive, replayed.robot))
        with Pool(0) as pool:
            remedies.driven_trials(diagnose(replay), [], pool)
    frames = [robot.parameters()["global_costmap"]["global_frame"] for robot in robots_driven]
    assert frames == ["odom", "matched"]


@pytest.mark.heavy
def test_a_drive_that_ended_on_its_way_does_not_limit_the_time_of_whole_drives(
    replayed, monkeypatch
):
    limits = []
    drive = replayed.drive
    x, y, _ = drive.odometry.pose[-1]
    # The drive ended 3 m before the end of its route, and then 1 m before it, as good as there.
    for distance in (3.0, 1.0):
        goal_pose = [x, y + distance, np.pi / 2]
        path = np.array([[0.0, 0.0, np.pi / 2], goal_pose])
        routes = replace(drive.routes, path=[path] * len(drive.routes))
        replay = replay_of(Recording.of(replace(drive, routes=routes), replayed.robot))
        limits.append(remedies.course_of(diagnose(replay), []).conditions.limit)

    limit_on_its_way, limit_at_its_goal = limits
    assert limit_on_its_way == whole_drives.UNKNOWN_LIMIT_S
    drive_duration = drive.odometry.time[-1]
    longest = whole_drives.SLOWEST * drive_duration
    assert limit_at_its_goal == pytest.approx(longest, abs=1.0)


def test_nothing_is_sought_for_a_drive_that_is_nearly_as_fast_as_it_can_be(replayed):
    """The drive is slow, because it samples only the slowest speed; it would be fast if this were
    its top speed.
    """
    # An event of eleven seconds, and one of one second
    long_event = Event("crept", 1.0, 12.0, (0.0, 0.3))
    short_event = Event("crept", 1.0, 2.0, (0.0, 0.3))
    assert Diagnosis.of(replayed, [long_event]).wants_remedy
    assert not Diagnosis.of(replayed, [short_event]).wants_remedy

    slow_top_speed = Change(PLANNER, "max_vel_x", 0.5, 0.1)
    slow_robot = with_changes(JACKAL, [SPOILT, slow_top_speed], "jackal")
    slow_replay = replay_of(Recording.of(replayed.drive, slow_robot))
    assert not Diagnosis.of(slow_replay, [long_event]).wants_remedy
