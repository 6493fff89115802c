"""Tests of the logbook: the stops of many bags, their places, the change that would help most, and
the answers that are kept beside the bags.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Commands, Drive, Plans, Transforms
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.why import alternatives, factors
from applr_ros1.why.answer import Answer
from applr_ros1.why.events import Event
from tests.support.bags import write
from tests.support.browser import focused, needs_browser, opened
from tests.support.drives import until
from tests.support.pages import data_of
from tests.support.replays import spoilt_drive, updates
from training.attempts import trials as whole_drives
from training.attempts.candidates import Candidate
from training.attempts.trials import Arrival, DrivenCourse, try_out
from training.why import __main__ as why
from training.why import common_change, logbook, logbook_page
from training.why.bag_answer import placed_frame
from training.why.common_change import CommonChange, change_for, merged, worst_bags
from training.why.driven import arrival_from, values_of_arrival
from training.why.logbook import Logbook, lost_in, places_of, stops_of
from training.why.logbook_words import (
    advice,
    by_day,
    by_parameter,
    by_reason,
    how_sure,
    lines_of,
    place_in_words,
)
from training.why.logged_bag import KEPT, LoggedBag, bag_hash
from training.why.recorded import BagAnswerOptions
from training.workers.calls import CallFailed, CallLost
from training.workers.pool import Pool
from worlds.map_reader import OCCUPIED
from worlds.world import Grid

JACKAL = robots.JACKAL
PLANNER = "TrajectoryPlannerROS"
NOON = 1_700_000_000.0  # a day in 2023 [s]


# -- one change for several courses
def candidate_of(sim_time):
    return Candidate((Change(PLANNER, "sim_time", 2.0, sim_time),))


def course_with(seconds, limit=60.0):
    """Return a course on which values of sim_time take {value: seconds}, "" the recorded one."""

    def begin(changes, seed, to_beat):
        duration = seconds[changes[0].after if changes else ""]
        success = duration < min(limit, to_beat + 1e-9)
        path = np.zeros((1, 3), np.float32)
        arrival = Arrival(success, duration if success else limit, not success, path)
        return lambda: arrival

    return DrivenCourse(JACKAL, False, begin)


def remedy_on(*courses, values=(1.0, 1.5)):
    """Return the value of sim_time that is advised for some courses, or None."""
    trials = try_out(list(map(course_with, courses)), list(map(candidate_of, values)))
    return trials.remedy and trials.remedy.candidate.changes[0].after


def test_a_change_for_several_courses_gains_over_all_of_them_and_harms_none():
    # 1.0 is best on the first course alone, and harms on the second; 1.5 helps on one of both.
    first = {"": 40.0, 1.0: 10.0, 1.5: 20.0}
    assert remedy_on(first, {"": 20.0, 1.0: 24.0, 1.5: 21.0}) == 1.5
    assert remedy_on(first, {"": 20.0, 1.0: 20.0, 1.5: 20.0}) == 1.0
    # Too little over both: 3 s of 60 s
    assert remedy_on({"": 40.0, 1.0: 37.0}, {"": 20.0, 1.0: 20.0}, values=(1.0,)) is None
    # A failure where the recorded values arrive harms, whatever it gains elsewhere.
    assert remedy_on(first, {"": 20.0, 1.0: 99.0, 1.5: 99.0}) is None
    # Also if the limit of 60 s is hardly more, and as many arrive as before
    assert remedy_on({"": 99.0, 1.0: 10.0}, {"": 58.0, 1.0: 99.0}, values=(1.0,)) is None


def test_the_drives_of_one_course_are_found_among_those_of_all():
    courses = [course_with({"": 40.0, 1.0: 10.0}), course_with({"": 20.0, 1.0: 19.0})]
    trials = try_out(courses, [candidate_of(1.0)])
    assert trials.on_course(0).recorded.seconds == 40.0
    assert trials.on_course(1).remedy.seconds == 19.0
    change = CommonChange([logged_bag(), logged_bag()], trials)
    assert change.gains == [30.0, 1.0]
    assert change.helped == [True, False]
    (line,) = advice(book_of(logged_bag(stop_at(0.0))), change)
    assert "whole drives take 30 s less in 1 of the 2 worlds of the worst stops" in line
    assert ", and in none a tenth more;" in line

    in_vain = try_out([course_with({"": 10.0, 1.0: 10.0})], [candidate_of(1.0)])
    (line,) = advice(book_of(logged_bag(stop_at(0.0))), CommonChange([logged_bag()], in_vain))
    assert line.startswith("Nothing that was tried in the 1 world of the worst stops helped")


# -- stops and places
def stop_at(x, y=0.0, lost=10.0, begin=1.0, end=11.0, reason="the plan leads back", outside=False):
    return Event("stood", begin, end, (x, y), reason=reason, is_outside=outside, lost=lost)


def answer_with(*stops, robot="jackal", begin=0.0, **fields):
    values = {"robot": robot, "length": 0.5, "scale": 1.0, "begin": begin, "frame": "odom"}
    values.update(name="drive", track=[[0.0, 0.0, 0.0, 0.0]], told_row=len(stops) - 1)
    return Answer(**{**values, **fields}, events=list(stops))


def logged_bag(*stops, name="a.bag", floor=0, **fields):
    bag = LoggedBag(Path(name), "key")
    bag.problem = "a test keeps nothing"
    bag.keep(answer_with(*stops, **fields))
    bag.floor = floor
    return bag


def book_of(*bags):
    stops = stops_of(bags)
    return Logbook(list(bags), stops, places_of(stops), [])


def test_stops_within_a_robots_length_in_one_frame_are_one_place():
    here = logged_bag(stop_at(0.0, lost=9.0), stop_at(0.4, lost=5.0), stop_at(0.6, lost=20.0))
    elsewhere = logged_bag(stop_at(0.0, lost=30.0), name="b.bag", floor=1)
    places = book_of(here, elsewhere).places
    assert [[logged.stop.place[0] for logged in place] for place in places] == [
        [0.0],
        [0.6, 0.4],
        [0.0],
    ]
    assert list(map(lost_in, places)) == [30.0, 25.0, 9.0]


def test_a_stop_is_counted_once_if_track_or_laser_show_one_drive_whatever_its_names():
    def bag_from(begin, name, drives=True, **fields):
        """Return a bag of 30 s from a time on, of a robot that stands from the 10th to the 20th."""
        elapsed = np.arange(0.0, 30.0, 0.5)
        x = np.sin(0.1 * (elapsed + begin - NOON)) if drives else 0.0 * elapsed
        track = np.column_stack([elapsed, x, 0.0 * x, 0.0 * x]).tolist()
        stop = stop_at(0.0, begin=NOON + 10.0 - begin, end=NOON + 20.0 - begin)
        return logged_bag(stop, name=name, begin=begin, track=track, **fields)

    def count(*bags):
        return len(stops_of(bags))

    first = bag_from(NOON, "a.bag")
    assert count(first, bag_from(NOON + 1.0, "b.bag")) == 1
    assert count(first, bag_from(NOON, "c.bag", robot="husky")) == 2
    # The same place and time, but another track
    assert count(first, bag_from(NOON + 1.0, "d.bag", drives=False)) == 2
    # Two robots at their docks, each at the origin of its own odometry
    docked = [bag_from(NOON, f"{number}.bag", False, map=wall(number)) for number in range(2)]
    assert count(*docked) == 2
    assert count(docked[0], bag_from(NOON, "e.bag", False, map=wall(0.0))) == 1
    assert count(bag_from(NOON, "f.bag", False), bag_from(NOON, "g.bag", False)) == 2
    # Nothing is known of robots without odometry.
    assert count(*[logged_bag(stop_at(0.0), begin=NOON, track=[], name=name) for name in "ab"]) == 2


def wall(x):
    """Return what the laser sees of a wall of 20 m and of a wavy one."""
    along = np.arange(0.0, 20.0, 0.1)
    return np.column_stack([along, x + np.sin(along)]).tolist()


def test_frames_are_one_only_if_the_laser_saw_the_same_there():
    bags = [
        logged_bag(map=wall(0.0)),
        logged_bag(map=wall(0.01)),
        logged_bag(map=wall(0.9)),
        logged_bag(frame="map", is_shared=True, map=wall(0.0)),
        logged_bag(frame="map", is_shared=True),
        # Another floor is called map, too; localisation is off by a few centimetres.
        logged_bag(frame="map", is_shared=True, map=wall(0.9)),
        logged_bag(frame="map", is_shared=True, map=wall(0.95)),
        logged_bag(map=[]),
        # Too little to compare
        logged_bag(map=[[50.0, 50.0]]),
        logged_bag(map=[[50.0, 50.0]]),
    ]
    logbook.set_floors(bags)
    assert [bag.floor for bag in bags] == [0, 0, 1, 2, 2, 3, 3, 4, 5, 6]


def test_a_drive_is_placed_in_the_frame_of_its_plans_if_tf_connects_both():
    half = np.sqrt(0.5)
    # map -> odom: a quarter turn to the left
    place = np.array([(1.0, 2.0, 0.0, 0.0, 0.0, half, half)])
    transforms = Transforms(np.zeros(1), np.zeros(1), ["map"], ["odom"], place, [True])
    times = np.array([0.0, 1.0])
    drive = Drive(
        frame="odom",
        frames={"odometry": ["odom"], "routes": ["map"]},
        transforms=transforms,
        routes=Plans(times, [np.zeros((1, 3))] * 2),
    )
    planned = Commands(times, np.zeros((2, 2)))
    recording = SimpleNamespace(drive=drive, robot=JACKAL, planned=planned)
    placed = placed_frame(recording, None)
    assert (placed.frame, placed.is_shared) == ("map", True)
    assert placed.origin == pytest.approx((1.0, 2.0, np.pi / 2))

    # Without tf it stays in its own frame.
    recording.drive = replace(drive, transforms=None)
    assert placed_frame(recording, None) == ("odom", False, (0.0, 0.0, 0.0))
    # The local costmap may be in the map.
    recording.drive = replace(drive, frame="map")
    assert placed_frame(recording, None) == ("map", True, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("frame", ["odom", "matched", "robot1/matched"])
@pytest.mark.parametrize("route_frame", ["odom", "matched", "robot1/matched"])
def test_matched_poses_begin_anew_at_each_start_as_odometry_does(frame, route_frame):
    drive = Drive(
        frame=frame,
        frames={"odometry": ["odom"], "routes": [route_frame]},
        routes=Plans(np.zeros(1), [np.zeros((1, 3))]),
    )
    recording = SimpleNamespace(drive=drive, robot=JACKAL)
    assert placed_frame(recording, None) == (frame, False, (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("frame", "is_shared", "words"),
    [
        ("map", True, "(1.00, 0.00) in map"),
        ("matched", False, "(1.00, 0.00) in matched (odometry since that start)"),
    ],
)
def test_a_place_in_a_frame_of_one_start_says_so(frame, is_shared, words):
    bag = logged_bag(stop_at(1.0), frame=frame, is_shared=is_shared)
    ((stop,),) = book_of(bag).places
    assert place_in_words(stop) == words


def test_a_map_lies_under_the_drives_in_its_frame_alone():
    cells = np.zeros((4, 4), np.int8)
    cells[1, 2] = OCCUPIED
    floor_map = Grid(cells, 0.5, (1.0, 0.0, 0.0))
    in_map = logged_bag(frame="map", is_shared=True, map=[[7.0, 7.0]])
    in_odometry = logged_bag(map=[[3.0, 3.0]], name="b.bag", floor=1)
    floors = logbook_page.floors_of(book_of(in_map, in_odometry), floor_map)
    # The centre of the occupied cell, and what the laser saw
    assert [floor["points"] for floor in floors] == [[[2.25, 0.75]], [[3.05, 3.05]]]
    assert [floor["cell"] for floor in floors] == [0.5, 0.1]


def test_stops_are_grouped_by_reason_whatever_was_measured_and_by_guess_and_day():
    near = "every faster command meets the obstacle {} m ahead and 0.1 m to the left, from the scan"
    bags = [
        logged_bag(
            stop_at(0.0, reason=near.format(0.5)),
            stop_at(2.0, reason=near.format(0.7)),
            guess=(Change("P", "sim_time", 2.0, 1.0),),
            begin=NOON,
        ),
        logged_bag(
            stop_at(0.0, lost=5.0, reason="there was no scan for 3.2 s", outside=True),
            guess=(Change("P", "sim_time", 2.0, 1.0),),
            begin=NOON + 86_400.0,
            name="b.bag",
        ),
    ]
    book = book_of(*bags)
    reasons = [str(group) for group in by_reason(book.stops)]
    assert reasons == [
        "20 s in 2 stops: every faster command meets an obstacle",
        "5 s in 1 stop: there was no scan for 3.2 s",
    ]
    words = [group.words for group in by_parameter(book.stops)]
    assert words == ["P/sim_time", "outside the planner"]
    assert [len(group.stops) for group in by_day(book.stops)] == [2, 1]
    assert advice(book, None) == ["No parameter helps in 1 stop: there was no scan for 3.2 s (1)."]
    assert lines_of(book, None)[0].startswith("3 stops in 2 drives cost 25 s, from 2023-11-1")


def test_a_stop_in_two_bags_of_a_simulation_is_one_if_their_tracks_agree():
    def bag_from(begin, y=0.0):
        """Return a bag of the minute from a time of the simulation on, with a stop at 80 s."""
        elapsed = np.arange(0.0, 60.0, 0.5)
        track = [[time, np.sin(0.1 * (begin + time)), y, 0.0] for time in elapsed.tolist()]
        stop = stop_at(0.0, begin=80.0 - begin, end=90.0 - begin)
        return logged_bag(stop, name=f"{begin}.bag", begin=begin, track=track)

    first = bag_from(35.0)
    assert len(stops_of([first, bag_from(50.3)])) == 1
    assert len(stops_of([first, bag_from(50.3, y=0.03)])) == 2
    assert len(stops_of([first, bag_from(79.0)])) == 1


def test_drives_of_which_few_commands_are_reproduced_are_counted():
    good = logged_bag(stop_at(0.0), commands=2000, reproduced=1990)
    guessed = replace(stop_at(0.0), is_guessed=True)
    poor = logged_bag(guessed, name="b.bag", commands=1000, reproduced=799)
    not_replayed = logged_bag(stop_at(0.0), name="c.bag")
    assert how_sure(book_of(good, not_replayed)) == "1,990 of 2,000 commands reproduced (99.5%)."
    assert how_sure(book_of(good, poor)) == (
        "2,789 of 3,000 commands reproduced (93.0%); "
        "few in 1 drive, whose planner's reasons are not to be trusted."
    )
    assert how_sure(book_of(not_replayed)) == "No drive was replayed."


# -- the change for the worst stops
def drivable(lost, *values, **fields):
    candidates = [candidate_of(value)[:2] for value in values]
    return logged_bag(stop_at(0.0, lost=lost), candidates=candidates, goal=(5.0, 0.0), **fields)


def test_candidates_of_many_stops_come_first():
    bags = [drivable(9.0, 1.0, 3.0), drivable(8.0, 1.5, 3.0), drivable(7.0, 3.0)]
    values = [candidate.changes[0].after for candidate in merged(bags)]
    assert values == [3.0, 1.0, 1.5]


def test_the_worst_stops_are_those_a_parameter_may_help_of_one_robot():
    outside = logged_bag(stop_at(0.0, lost=99.0, outside=True), candidates=[])
    husky = drivable(20.0, 1.0, robot="husky", name="h.bag")
    bags = [drivable(float(lost), 1.0, name=f"{lost}.bag") for lost in range(1, 12)]
    chosen = worst_bags(book_of(outside, husky, *bags))
    assert [bag.answer.events[0].lost for bag in chosen] == [11, 10, 9, 8, 7, 6, 5, 4]


def test_bags_of_several_robots_are_named_with_the_one_that_gets_advice():
    bags = [drivable(5.0, 1.0), drivable(20.0, 1.0, robot="husky", name="h.bag")]
    (note,) = logbook.notes_of_robots(book_of(*bags))
    assert note.startswith("bags of several robots, husky (20 s), jackal (5 s): a change is sought")
    assert logbook.notes_of_robots(book_of(bags[0])) == []


def test_drives_are_made_once_and_kept_and_those_of_a_world_that_is_closed_do_not_count(
    monkeypatch,
):
    calls = []

    def drive_once(conditions, changes, seed, to_beat):
        calls.append(seed)
        seconds = 10.0 if changes else 20.0
        has_arrived = bool(changes) or conditions.is_open
        return Arrival(has_arrived, seconds, False, np.zeros((1, 3), np.float32))

    monkeypatch.setattr(whole_drives, "drive_once", drive_once)
    monkeypatch.setattr(common_change, "with_description", lambda path, options: options)
    bags = [drivable(9.0, 1.0), drivable(8.0, 1.0, name="b.bag")]
    # The recorded robot came to 1 m from its goal. The simulated one does not leave the start.
    to_goal = [[0.0, 0.0, 0.0, 0.5], [9.0, 4.0, 0.0, 0.5]]
    closed = drivable(99.0, 1.0, name="closed.bag", track=to_goal)
    for bag in (*bags, closed):
        is_open = bag is not closed
        bag.conditions = SimpleNamespace(robot=JACKAL, policy_decides=False, is_open=is_open)
    options = BagAnswerOptions(robot=JACKAL)
    book = book_of(closed, *bags)
    with Pool(0) as pool:
        change = change_for(book, options, pool, lambda: None)
        driven_count = len(calls)
        # As after a restart, when the conditions are not known
        for bag in bags:
            bag.conditions = None
        again = change_for(book_of(*bags), options, pool, lambda: None)
        assert change_for(book_of(closed), options, pool, lambda: None) is None
    assert driven_count == len(calls) > 0
    assert change.bags == bags
    (note,) = book.notes
    assert note.startswith(
        "closed.bag: simulated with the recorded values, the robot does not come"
    )
    assert change.gains == again.gains == [10.0, 10.0]
    (line,) = advice(book_of(*bags), change)
    result = "in simulation, whole drives take 20 s less in 2 of the 2 worlds of the worst stops"
    assert line.startswith(f"Try sim_time 2 -> 1: {result}, and in none a tenth more; arrives 12")


def course_that_fails(monkeypatch, failure):
    """Return a logbook of one drive whose simulated drives fail, but for the recorded values."""
    bag = drivable(9.0, 1.0)

    def begin(changes, seed, to_beat):
        def arrival_of():
            if changes or failure is None:
                raise failure or CallFailed("no footprint")
            return Arrival(True, 20.0, False, np.zeros((1, 3), np.float32))

        return arrival_of

    bag.conditions = SimpleNamespace()
    course = DrivenCourse(JACKAL, False, begin)
    monkeypatch.setattr(common_change, "course_in", lambda conditions, pool: course)
    monkeypatch.setattr(common_change, "with_description", lambda path, options: options)
    return book_of(bag)


@pytest.mark.parametrize(
    ("failure", "is_kept"), [(CallFailed("no footprint"), True), (CallLost("out of memory"), False)]
)
def test_only_values_that_move_base_refuses_are_kept_as_refused(monkeypatch, failure, is_kept):
    book = course_that_fails(monkeypatch, failure)
    change_for(book, BagAnswerOptions(robot=JACKAL), None, lambda: None)
    assert (None in book.bags[0].answer.drives.values()) == is_kept


def test_a_drive_that_cannot_be_simulated_is_named_and_not_kept(monkeypatch):
    book = course_that_fails(monkeypatch, None)
    with pytest.raises(
        ApplrError, match="a.bag: the recorded values cannot be driven .* footprint"
    ):
        change_for(book, BagAnswerOptions(robot=JACKAL), None, lambda: None)
    assert not book.bags[0].answer.drives


def test_a_bag_that_cannot_be_read_any_more_is_named():
    bag = drivable(9.0, 1.0)
    with Pool(0) as pool:
        kept = common_change.KeptCourse(
            bag, JACKAL, BagAnswerOptions(robot=JACKAL), pool, lambda: None
        )
        with pytest.raises(ApplrError, match="a.bag: "):
            kept.course.begin((), 1, 60.0)


# -- files beside the bags
def test_an_answer_is_kept_for_its_key_and_a_damaged_file_is_none(tmp_path):
    bag_path = tmp_path / "a.bag"
    kept = LoggedBag(bag_path, "key")
    arrival = Arrival(True, 12.34567, False, np.array([[0.0, 1.0, 2.0]], np.float32))
    drives = {"drive": values_of_arrival(arrival), "refused": None}
    kept.keep(drivable(9.0, 1.0, drives=drives).answer)

    again = LoggedBag(bag_path, "key")
    assert KEPT.dump_json(("", again.answer)) == KEPT.dump_json(("", kept.answer))
    assert arrival_from(again.answer.drives["drive"]).seconds == 12.34567
    assert Candidate(*again.answer.candidates[0]) == candidate_of(1.0)
    assert not LoggedBag(bag_path, "another key").is_answered

    (tmp_path / "a.bag.why.json").write_text('{"key": "key", "answer": {"robot": 1}}')
    assert not LoggedBag(bag_path, "key").is_answered


def test_the_hash_of_a_ros2_bag_is_that_of_its_files_and_opens_no_device(tmp_path):
    bag_path = tmp_path / "drive"
    (bag_path / "notes").mkdir(parents=True)
    (bag_path / "drive.db3").write_bytes(b"one")
    first_hash = bag_hash(bag_path)
    (bag_path / "device").symlink_to("/dev/null")
    assert bag_hash(bag_path) == first_hash
    (bag_path / "drive.db3").write_bytes(b"two")
    assert bag_hash(bag_path) != first_hash


def test_the_answer_to_a_bag_that_is_the_current_folder_lies_beside_it(tmp_path, monkeypatch):
    bag_path = tmp_path / "drive"
    bag_path.mkdir()
    monkeypatch.chdir(bag_path)
    LoggedBag(Path(), "key").keep(answer_with())
    assert (tmp_path / "drive.why.json").is_file()


# -- the command
@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with two drives, a copy and junk, and let the command try little."""
    monkeypatch.setattr(alternatives, "CYCLES", 2)
    monkeypatch.setattr(factors, "FACTORS", ())
    _, driven = spoilt_drive()
    driven = replace(driven, changes=updates((0.0, PLANNER, {"vx_samples": 1})))
    bags = tmp_path / "bags"
    (bags / "later").mkdir(parents=True)
    write(bags / "first.bag", until(driven, 4.0))
    write(bags / "later" / "first.bag", until(driven, 3.0))
    shutil.copy(bags / "first.bag", bags / "second.bag")
    (bags / "third.bag").write_bytes(b"junk")
    return bags


def ran(capsys, *arguments):
    """Run the command; return its exit status, output and errors."""
    options = ["--quick", "--workers", "0"]
    status = why.main([*map(str, arguments), *options])
    output, errors = capsys.readouterr()
    return status, output, errors


@needs_browser
def test_a_folder_gives_a_logbook_that_goes_on_where_it_stopped(folder, capsys, monkeypatch):
    page_file = folder.parent / "log.html"
    status, output, errors = ran(capsys, folder, "--json", "--out", page_file)
    assert status == 0, errors
    values = json.loads(output)
    assert values["lines"][0].startswith("2 stops in 2 drives cost ")
    assert values["reproduced"] == 1.0
    assert len(values["places"]) == 1
    first_note, second_note = errors.splitlines()
    assert first_note.endswith(f"second.bag: left out, the same as {folder / 'first.bag'}")
    assert "third.bag: cannot be read" in second_note

    # The second time nothing is replayed, but for the bag that cannot be read.
    answered = []
    monkeypatch.setattr(logbook, "answer_to", lambda path, options: answered.append(path.name))
    (folder / "third.bag").unlink()
    status, again, _ = ran(capsys, folder, "--json")
    assert status == 0
    assert answered == []
    assert json.loads(again)["events"] == values["events"]

    # Every stop is a click away.
    pages = sorted(path.name for path in (folder.parent / "log_drives").iterdir())
    assert pages == ["first.bag.html", "first.bag_.html"]
    linked, *_ = data_of(page_file.read_text())["links"]
    assert (folder.parent / linked.partition("#")[0]).is_file()
    with opened(folder.parent / linked.partition("#")[0]) as page:
        assert page.get_by_role("link", name="All stops").count() == 1
    with opened(page_file) as page:
        sides = {}
        for head in page.get_by_role("columnheader").all():
            sides[head.inner_text()] = head.evaluate("head => getComputedStyle(head).textAlign")
        assert (sides["lost"], sides["stop"], sides["what and why"]) == ("right", "left", "left")
        focused(page, "button", "Place 1").press("Enter")
        assert page.get_by_role("heading", name="2 stops").count() == 1
        assert page.get_by_role("link", name="first.bag").count() == 2


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ([], "no bags there"),
        (["junk.bag"], "junk.bag: cannot be read"),
        (["junk.bag", "--at", "0"], "--at is about one bag, there are several: give one bag"),
        (["junk.bag", "--on", "map.yaml"], "name the page with --out"),
    ],
)
def test_a_folder_without_a_readable_bag_is_a_line(tmp_path, capsys, arguments, problem):
    names = [argument for argument in arguments if argument.endswith(".bag")]
    for name in names:
        (tmp_path / name).write_bytes(b"junk")
    options = arguments[len(names) :]
    status, output, errors = ran(capsys, tmp_path, *options)
    assert (status, output) == (1, "")
    assert problem in errors
    assert len(errors.splitlines()) == 1


def test_stops_are_printed_even_if_no_change_can_be_driven(tmp_path, capsys, monkeypatch):
    def change_for(*_):
        raise ApplrError("a.bag: no course")

    (tmp_path / "a.bag").write_bytes(b"junk")
    monkeypatch.setattr(why, "logbook_of", lambda *_: book_of(logged_bag(stop_at(0.0))))
    monkeypatch.setattr(why, "change_for", change_for)
    assert why.main([str(tmp_path), "--workers", "0"]) == 0
    output, errors = capsys.readouterr()
    assert output.startswith("1 stop in 1 drive cost 10 s")
    assert errors == "no change is advised: a.bag: no course\n"
