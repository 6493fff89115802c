"""Tests of `./applr why`: bags, options, page, and mistakes."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer

from applr_ros1 import robots
from applr_ros1.drives.columns import SECOND, TopicNames
from applr_ros1.drives.drive import REACHED, Goal, Plans
from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.parameters.obstacle_range import laser_sources
from applr_ros1.why import alternatives
from applr_ros1.why.answer import answer_of
from applr_ros1.why.black_box.answering import answers_of
from applr_ros1.why.black_box.description import DescribedRobot, driving, unknown_robot
from applr_ros1.why.black_box.stops import HELD
from applr_ros1.why.diagnosis import Diagnosis
from applr_ros1.why.events import GAVE_UP, SAVED, Event, RobotStop
from applr_ros1.why.outside import NO_PLAN, NO_SCAN, OTHER_PLANNER, SIDEWAYS
from applr_ros1.why.replay import changes_of
from applr_ros1.why.rerun import RerunPlanner
from tests.support.bags import write
from tests.support.browser import focused, needs_browser, opened
from tests.support.drives import before_a_monitor, changed, decided, simulated, until
from tests.support.measured_drives import DRIVES, STANDS, drive_of
from tests.support.pages import data_of
from tests.support.raw_messages import (
    bag_of,
    description_of,
    deserialize,
    messages_in,
    raw_messages,
)
from tests.support.replays import (
    JACKAL,
    PLANNER,
    replayed,
    sound_replay,
    spoilt_drive,
    updates,
)
from training.attempts.candidates import CandidateList
from training.bags.read import CUT_SHORT, BagError, bags_in
from training.why import __main__ as why
from training.why import remedies
from training.why.bag_answer import answer_to
from training.why.pages import drive_page
from training.why.recorded import BagAnswerOptions, recording_of
from training.why.remedies import CANDIDATES
from training.why.replayed import with_likely_robot


@pytest.fixture(scope="module")
def spoilt():
    """Return a Jackal with a fault, and a recording of its drive."""
    return spoilt_drive()


@pytest.fixture(scope="module")
def sound():
    """Return a replay of a drive without a fault."""
    return sound_replay()


@pytest.fixture(scope="module")
def bag(sound, tmp_path_factory):
    """Return the bag of the drive without a fault."""
    bag_path = tmp_path_factory.mktemp("why") / "drive.bag"
    return write(bag_path, sound.drive)


def read_back(path, robot=JACKAL):
    """Return the drive that `./applr why` reads from a bag."""
    options = why.WhyOptions(bag=[str(path)], robot=robot)
    return recording_of(path, options, RerunPlanner(robot)).drive


def values_in(cycles, server, name):
    """Return all values that a parameter had in some cycles."""
    return {cycle.settings[server][name] for cycle in cycles}


def lethal_cells(cycle):
    """Return the number of lethal cells in the local costmap of a cycle."""
    _, cells, *_ = cycle.map
    return np.count_nonzero(cells == LETHAL)


@pytest.mark.heavy
def test_costmaps_are_cleared_where_a_decision_says_so(tmp_path):
    driven, _ = simulated(JACKAL, "generated:40", limit=8, clearings=[2, 7])
    bag_path = write(tmp_path / "cleared.bag", driven)
    replay = replayed(JACKAL, read_back(bag_path))
    assert replay.share == 1.0
    clearing_times = [cycle.at for cycle in replay.cycles if cycle.is_cleared]
    assert clearing_times == pytest.approx([2.0, 7.0], abs=0.11)

    # Without the decisions, what the laser no longer sees stays in the costmap.
    silent_replay = replayed(JACKAL, replace(driven, decisions=[]))
    assert lethal_cells(replay.cycles[-1]) < lethal_cells(silent_replay.cycles[-1])


def test_parameters_in_force_come_from_the_updates_in_the_bag(spoilt, tmp_path):
    robot, driven = spoilt
    # Given: a bag in which a parameter changes after half a second
    update = updates((0.5, PLANNER, {"sim_time": 1.25, "unknown": 3.0}))
    updated_drive = replace(until(driven, 1.0), changes=update)
    bag_path = write(tmp_path / "updated.bag", updated_drive)

    # When: its drive is replayed
    replay = replayed(robot, read_back(bag_path, robot))

    # Then: the planner has the old value before, and the new one after
    earlier_cycles = []
    later_cycles = []
    for cycle in replay.cycles:
        if cycle.at < 0.5:
            earlier_cycles.append(cycle)
        elif cycle.at > 0.5:
            later_cycles.append(cycle)
    assert values_in(earlier_cycles, PLANNER, "sim_time") == {2.0}
    assert values_in(later_cycles, PLANNER, "sim_time") == {1.25}
    # Servers of other versions have parameters that this planner has not.
    assert "unknown" not in replay.settings[PLANNER]


@pytest.mark.heavy
def test_a_drive_without_updates_is_reproduced_with_the_parameters_of_its_decisions(tmp_path):
    """One parameter of a policy limits turns to both sides: min_vel_theta has the opposite sign."""
    turns_slowly = {"max_vel_theta": 0.8, "min_vel_theta": -0.8}
    robot = changed(JACKAL, {PLANNER: turns_slowly})
    driven, _ = simulated(robot, "generated:40", limit=8)
    decision = decided({"max_vel_theta": 0.8})
    bag_path = write(tmp_path / "decided.bag", replace(driven, decisions=[decision]))

    replay = replayed(JACKAL, read_back(bag_path))

    assert values_in(replay.cycles, PLANNER, "min_vel_theta") == {-0.8}
    assert replay.share > 0.98


def test_parameters_of_servers_without_updates_come_from_decisions(spoilt, tmp_path):
    """The C++ planner keeps the footprint that it had at start-up; the costmap takes the new
    padding.
    """
    _, driven = spoilt
    robot = JACKAL
    decision = decided({"sim_time": 9.0, "footprint_padding": 0.14})
    driven = replace(
        until(driven, 1.0),
        changes=updates((0.5, PLANNER, {"sim_time": 1.25})),
        decisions=[decision],
    )
    recorded = read_back(write(tmp_path / "decided.bag", driven), robot)
    changes_in_order = []
    for _, server, values in changes_of(recorded, robot):
        changes_in_order.append((server, values))
    # The planner's own update is what it did: the decision's 9.0 was not accepted.
    padding = {"footprint_padding": 0.14}
    assert changes_in_order == [
        ("local_costmap", padding),
        ("global_costmap", padding),
        (PLANNER, {"sim_time": 1.25}),
    ]

    # The file's padding is 0.10 m, so the outline grows by 0.04 m.
    replay = replayed(robot, recorded)
    half_length = replay.planner.footprint(replay.planner.start_settings).max()
    last_half_length = replay.planner.footprint(replay.settings).max()
    assert last_half_length == pytest.approx(half_length + 0.04)
    assert values_in(replay.cycles, "local_costmap", "footprint_padding") == {0.14}


def test_commands_before_a_collision_monitor_are_taken(spoilt, tmp_path):
    robot, driven = spoilt
    one_second = until(driven, 1.0)
    limited_bag = write(tmp_path / "limited.bag", before_a_monitor(one_second))
    recorded = read_back(limited_bag, robot)
    assert np.array_equal(recorded.planned.twist, one_second.planned.twist)
    assert not recorded.commands.twist.any()

    # Without a monitor a bag has only the commands that reach the base.
    unlimited_bag = write(tmp_path / "alone.bag", replace(one_second, planned=None))
    recorded = read_back(unlimited_bag, robot)
    assert np.array_equal(recorded.planned.twist, one_second.commands.twist)


@pytest.mark.heavy
def test_a_drive_with_the_range_of_the_robots_set_is_reproduced_with_this_range(tmp_path):
    # Given: a robot with a set for 1 m, and drives with this range and with that of its files
    folder = shutil.copytree(JACKAL.folder, tmp_path / "mine")
    (folder / "applr.safetensors").unlink()
    (folder / "static.json").write_text('{"obstacle_range": 1.0, "parameters": {}}')
    robot = robots.load(str(folder))
    of_the_set = (
        "obstacles are marked up to 1 m, as the robot's set or policy asks: "
        "with the range of its files, fewer commands are reproduced"
    )
    for driven_range, expected_range, notes in ((1.0, 1.0, [of_the_set]), (None, 2.5, [])):
        drive, _ = simulated(robot.seeing(driven_range), "generated:40", limit=8)
        # Then: the replay finds out which one it was, and says so
        replay = with_likely_robot(replayed(robot, drive))
        assert replay.reproduced == len(replay.cycles)
        sources = laser_sources(replay.robot.parameters())
        assert {source.obstacle_range for source in sources} == {expected_range}
        assert replay.drive.notes == notes


@pytest.mark.heavy
def test_a_drive_whose_distance_biases_count_per_metre_is_reproduced_with_this_unit():
    # Given: a drive with biases per cell of 0.05 m, and the weights of the same drive with biases
    # per metre, as the applr node sends them: a 16th of all, so that the biases keep their ranges
    weights = {"path_distance_bias": 0.5, "goal_distance_bias": 1.5, "occdist_scale": 0.4}
    values = {"max_vel_x": 1.3, "vx_samples": 16, "vtheta_samples": 56, "sim_time": 1.1, **weights}
    costmap = {"footprint_padding": 0.14}
    per_cell = changed(JACKAL, {PLANNER: values, "local_costmap": costmap})
    drive, _ = simulated(per_cell, "generated:40", limit=8)
    sent_weights = {
        "path_distance_bias": 0.5 * 20 / 16,
        "goal_distance_bias": 1.5 * 20 / 16,
        "occdist_scale": 0.4 / 16,
    }
    robot = changed(per_cell, {PLANNER: sent_weights})

    # Then: the replay finds out that they count per metre, and says so
    replay = replayed(robot, drive)
    assert replay.share < 0.9
    likely_replay = with_likely_robot(replay)
    assert likely_replay.reproduced == len(likely_replay.cycles)
    note = (
        "distance biases count per metre, as C++ leaves the unit to chance: "
        "with the other unit, fewer commands are reproduced"
    )
    assert likely_replay.drive.notes == [note]
    # The unit stays if nothing is gained by the other.
    assert with_likely_robot(replayed(per_cell, drive)).drive.notes == []


def ran(capsys, *arguments):
    """Run the command; return its exit status, output and errors."""
    status = why.main([str(argument) for argument in arguments])
    output, errors = capsys.readouterr()
    return status, output, errors


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder, and let the command try little, so that it is fast."""
    monkeypatch.setattr(alternatives, "CYCLES", 2)
    monkeypatch.setattr(remedies, "candidates_of", lambda robot: CandidateList([], []))
    return tmp_path


def test_the_command_answers_in_its_first_line_and_writes_a_page(bag, folder, capsys):
    page_file = folder / "why.html"
    options = ["--robot", "jackal", "--at", 3, "--quick", "--out", page_file]
    status, output, errors = ran(capsys, bag, *options)
    assert status == 0, errors

    page_data = data_of(page_file.read_text())
    first_event = page_data["events"][0]
    assert first_event["cycles"][0]["points"]
    assert page_data["lines"] == output.splitlines()
    assert page_data["notes"] == []
    # What the robot did, and what the planner chose, at a moment without a stop
    first_line = output.splitlines()[0]
    assert first_line.startswith("2.5 to 3.5 s: drove with ")
    assert first_line.endswith(": nothing held it up (max_vel_x 0.50 m/s).")
    assert "   The planner drives on (" in output


def test_of_a_moment_without_a_goal_this_is_said(sound):
    odometry = sound.drive.odometry
    late_goal = Goal("goal", odometry.time[-1] - 1.0, odometry.time[-1], REACHED)
    drive = replace(sound.drive, goals=[late_goal])
    replay = replace(sound, recording=replace(sound.recording, drive=drive))
    event = Event("stood", 2.0, 3.0, (0.0, 0.0), is_asked=True)
    first_line = answer_of(Diagnosis.of(replay, [event])).first_line
    assert first_line == "2.0 to 3.0 s: stood at (0.00, 0.00): it had no goal."


@needs_browser
def test_the_lines_of_all_that_was_tried_look_different(bag, folder, capsys):
    _, output, _ = ran(capsys, bag, "--robot", "jackal", "--at", 3, "--quick", "--json")
    path = [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
    rows = [{"words": f"row {row}", "result": "", "paths": [path]} for row in range(CANDIDATES + 1)]
    recorded, *tried = rows
    page_file = folder / "why.html"
    values = {**json.loads(output), "recorded": recorded, "tried": tried}
    page_file.write_bytes(drive_page(values).html())
    with opened(page_file) as page:
        looks = page.locator("label.named").evaluate_all(
            "labels => labels.map(label => label.children[1].outerHTML)"
        )
    assert len(set(looks)) == len(rows)


@needs_browser
def test_keys_choose_an_event_a_moment_and_the_paths_on_the_page(bag, folder, capsys):
    page_file = folder / "why.html"
    ran(capsys, bag, "--robot", "jackal", "--at", 3, "--quick", "--out", page_file)
    with opened(page_file) as page:
        focused(page, "button", "Event 1").press("Enter")
        slider = focused(page, "slider", "Moment of the event")
        slider.press("Home")
        first_moment = slider.get_attribute("aria-valuetext")
        slider.press("End")
        assert slider.get_attribute("aria-valuetext") != first_moment
        assert page.get_by_role("img", name="command").count()


@pytest.mark.heavy
def test_two_bags_are_compared_by_the_parameters_that_differ(bag, sound, folder, capsys):
    update = updates((0.0, PLANNER, {"sim_time": 1.5, "max_vel_x": 0.4}))
    other_drive = replace(until(sound.drive, 2.0), changes=update)
    other_bag = write(folder / "other.bag", other_drive)

    status, output, errors = ran(capsys, bag, other_bag, "--json", "--at", 2, "--quick")

    assert status == 0, errors
    answer_lines = json.loads(output)["lines"]
    comparison, *_ = [line for line in answer_lines if "; routes" in line]
    # The other drive ends after 2 s; the routes are apart once the first is 0.3 m farther.
    assert "; routes diverge at 2.7 s; differing parameters: max_vel_x 0.5 -> 0.4, " in comparison
    assert "sim_time 2 -> 1.5" in comparison
    # Updates of other servers say nothing of the planner.
    assert f"no updates of {PLANNER}" not in comparison
    assert any(f"no updates of {PLANNER}" in line for line in answer_lines)


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        ({"odometry": None}, "no messages on /odometry/filtered"),
        ({"planned": None, "commands": None}, "no messages on /cmd_vel"),
        (
            {"plans": None, "routes": None},
            "no messages on /move_base/TrajectoryPlannerROS/global_plan",
        ),
        ({"planners": ["DWAPlannerROS"]}, "DWAPlannerROS drove, jackal has TrajectoryPlannerROS"),
    ],
)
def test_what_a_bag_lacks_is_named_in_one_line(spoilt, folder, capsys, columns, problem):
    robot, driven = spoilt
    lacking_drive = replace(until(driven, 0.5), **columns)
    bag_path = write(folder / "drive.bag", lacking_drive)
    status, output, errors = ran(capsys, bag_path, "--quick")
    assert status == 1
    assert output == ""
    assert problem in errors
    assert len(errors.splitlines()) == 1


def test_without_a_laser_what_is_seen_from_outside_is_said(spoilt, folder, capsys):
    _, driven = spoilt
    status, output, _ = ran(capsys, write(folder / "drive.bag", replace(driven, scans=None)))
    first_line, certainty, seen, unseen, *_ = output.splitlines()
    assert status == 0
    assert ": crept at (" in first_line
    assert certainty == f"{NO_SCAN}."
    assert "/odometry/filtered" in seen
    assert "/front/scan" in unseen
    assert unseen.endswith("record them next time.")


@pytest.mark.heavy
def test_of_another_planner_what_is_seen_from_outside_is_said(spoilt, folder, capsys):
    _, driven = spoilt
    has_scan = int((driven.scans.time < 2.0).sum())
    silent = replace(
        driven,
        planners=["TebLocalPlannerROS"],
        scans=driven.scans.part(slice(0, has_scan)),
        changes=updates((0.0, "TebLocalPlannerROS", {"max_vel_x": 0.5, "max_vel_theta": 1.5})),
    )
    bag_path = write(folder / "teb.bag", silent)

    status, output, errors = ran(capsys, bag_path, "--out", folder / "why.html")

    assert status == 0
    happened, planner, *_ = output.splitlines()
    assert "crept" in happened
    assert "because there was no scan for" in happened
    assert planner == f"{OTHER_PLANNER}."
    assert errors == "--out is not used: a page shows a replay\n"
    _, _, errors = ran(capsys, bag_path, "--map", folder / "seen.yaml", "--at", "3")
    assert errors == (
        "--map is not used: a map needs a replay\n--at is not used: it explains a replay\n"
    )
    status, _, errors = ran(capsys, bag_path, bag_path)
    assert status == 1
    assert errors.endswith("ask about one bag, drives are compared by replays\n")
    _, output, _ = ran(capsys, bag_path, "--json")
    values = json.loads(output)
    assert values["reproduced"] == 0.0
    assert values["events"][0]["reason"].startswith("there was no scan")


@pytest.mark.heavy
@pytest.mark.parametrize("is_published", [True, False])
def test_where_no_plan_was_found_what_is_seen_from_outside_is_said(
    spoilt, folder, capsys, is_published
):
    # A black box has every plan that there was.
    robot, driven = spoilt
    driven = until(driven, 7.0)
    odometry = driven.odometry
    stood = replace(odometry, pose=np.tile(odometry.pose[:1], (len(odometry), 1)))
    stood = replace(stood, twist=np.zeros_like(odometry.twist))
    no_plans = Plans(np.array([1.0]), [np.zeros((0, 3))]) if is_published else None
    zeros = replace(driven.commands, twist=np.zeros_like(driven.commands.twist))
    columns = {"commands": zeros, "planned": zeros, "plans": no_plans, "routes": no_plans}
    lost = replace(driven, odometry=stood, **columns)
    bag_path = box_bag(folder / "lost.bag", robot, lost, True)

    status, output, errors = ran(capsys, bag_path, "--quick")

    assert status == 0, errors
    happened, why_no_replay, *_ = output.splitlines()
    assert "stood at (0.00, 0.00)" in happened
    assert why_no_replay == f"{NO_PLAN}."


def box_bag(path, robot, drive, is_known, stop=None):
    """Write the bag of a black box, and return its path.

    Args:
        path: The path.
        robot: Robot that drove.
        drive: Its drive.
        is_known: Whether the robot has a description.
        stop: Stop for which the bag is kept, or None.
    """
    topics = replace(TopicNames.of(robot), scan="/lidar", command="/base/cmd_vel")
    messages = raw_messages(path.with_suffix(".source.bag"), drive, robot=robot, topics=topics)
    described = robot if is_known else unknown_robot(robot.parameters())
    description = description_of(
        DescribedRobot(described, topics, is_known), messages[0].time, stop
    )
    path.write_bytes(bag_of([description, *messages]))
    return path


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("kind", "begin", "end", "expected", "words"),
    [
        ("stood", 4.0, 9.0, 3.0, "stood for 9 s"),
        ("stood", 11.0, 23.0, 18.0, "stood for 6 s"),  # It overlaps the second stop most.
        (SAVED, 25.0, 25.0, 18.0, "stood for 6 s"),  # The first one was longer.
        # Not the last half second counts, but all that led to it.
        (GAVE_UP, 11.9, 11.9, 3.0, f"{GAVE_UP}: it stood for 9 s"),
        (HELD, 2.0, 8.0, 0.0, f"which {HELD} at first, crept for 12 s"),
    ],
)
def test_box_and_desk_tell_one_event_and_one_reason_of_a_bag(
    spoilt, folder, capsys, kind, begin, end, expected, words
):
    # Given: a drive that is replayed, or one of another planner that stands from 3 to 12 s, and
    # from 18 to 24 s
    robot, driven = spoilt
    if kind != HELD:
        robot = JACKAL
        driven = drive_of(DRIVES + STANDS * 3 + DRIVES * 2 + STANDS * 2 + DRIVES)
        driven = replace(driven, planners=["TebLocalPlannerROS"], plans=None)
    stop = RobotStop(kind, 1.0 + begin, 1.0 + end, (0.0, 0.0))
    bag_path = box_bag(folder / "stop.bag", robot, driven, True, stop)

    # When: the box answers, and the desk, alone and in a logbook
    *_, box_answer = answers_of(messages_in(bag_path), deserialize)
    _, output, _ = ran(capsys, bag_path, "--quick", "--json")
    logged_answer = answer_to(bag_path, BagAnswerOptions(quick=True)).answer

    # Then: all tell the event of the stop, which need not be the longest one
    assert json.loads(output)["lines"][0] == box_answer.first_line == logged_answer.first_line
    told = box_answer.message()
    for key in ("kind", "begin", "seconds", "reason", "reproduced"):
        assert logged_answer.message()[key] == told[key], key
    assert told["begin"] == pytest.approx(1.0 + expected, abs=0.1)
    assert words in told["sentence"]
    assert told["reason"].startswith("no command faster than") == (kind == HELD)


@pytest.mark.parametrize(
    ("planner", "sideways", "note"),
    [
        ({"base_local_planner": "teb_local_planner/TebLocalPlannerROS"}, 0.4, OTHER_PLANNER),
        ({"base_local_planner": "mpc_local_planner/MpcLocalPlannerROS"}, 0.0, OTHER_PLANNER),
        ({"controllers": [{"name": "eband", "type": "eband/EBandPlannerROS"}]}, 0.0, OTHER_PLANNER),
        ({"base_local_planner": "dwa_local_planner/DWAPlannerROS"}, 0.4, SIDEWAYS),
    ],
)
def test_a_bag_of_the_black_box_is_read_back_beside_any_planner(
    folder, capsys, planner, sideways, note
):
    # Given: a robot that stands from 3 to 9 s, and then drives sideways, or ahead
    tree = {**JACKAL.parameters(), **planner}
    if "controllers" in tree:
        del tree["base_local_planner"]
    robot = driving(JACKAL, tree)
    leftward = np.repeat([0.0, sideways], [180, 180])
    driven = drive_of(DRIVES + STANDS * 2 + (STANDS if sideways else DRIVES) * 3, sideways=leftward)
    driven = replace(driven, planners=[robot.local_planner])
    stop = RobotStop("stood", 4.0, 9.0, (1.5, 0.0))
    bag_path = box_bag(folder / "stop.bag", robot, driven, True, stop)

    # When: the box answers, and the desk, alone and in a logbook
    *_, box_answer = answers_of(messages_in(bag_path), deserialize)
    status, output, errors = ran(capsys, bag_path)
    logged_answer = answer_to(bag_path, BagAnswerOptions(quick=True)).answer

    # Then: all tell the one stop, and what is not known of it
    assert status == 0, errors
    first_line, certainty, *_ = output.splitlines()
    assert first_line.startswith("3.0 to 8.9 s: stood at (1.50, 0.00)")
    assert certainty == f"{note}."
    assert box_answer.first_line == logged_answer.first_line == first_line
    assert box_answer.note == note
    # The node says it once of a planner.
    assert (note in box_answer.sentence) == (note != OTHER_PLANNER)
    assert [event.kind for event in box_answer.events] == ["stood"]


@pytest.mark.heavy
@pytest.mark.parametrize("is_known", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_bag_of_the_black_box_needs_neither_robot_nor_topics(spoilt, folder, capsys, is_known):
    # Its parameters are those of no folder.
    robot, driven = spoilt
    bag_path = box_bag(folder / "stop.bag", robot, until(driven, 4.0), is_known)
    arguments = ["--quick"] if is_known else []
    status, output, errors = ran(capsys, bag_path, "--json", *arguments)
    assert status == 0, errors
    values = json.loads(output)
    assert values["reproduced"] == 1.0
    assert "vx_samples 1" in values["lines"][0]
    # Of a robot whose body nobody knows, nothing is driven in simulation.
    assert values["recorded"] is None
    # What a person gives counts.
    status, _, errors = ran(capsys, bag_path, "--scan", "/front/scan")
    assert (status, "no messages on /front/scan" in errors) == (1, True)
    _, output, _ = ran(capsys, bag_path, "--json", "--quick", "--robot", "jackal")
    assert json.loads(output)["reproduced"] < 0.5


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["none.bag"], "none.bag: there is no such file"),
        (["BAG", "--at", "500"], "--at 500: outside the drive, give "),
        (["BAG", "--out", "none/a.html"], "--out none/a.html: give a file in a folder that can be"),
        (["BAG", "--map", "none/a.yaml"], "--map none/a.yaml: give a file in a folder that can be"),
        # The image of the map has this name.
        (["BAG", "--map", "seen.pgm"], "--map seen.pgm: give a file that ends in .yaml"),
        (["BAG", "--robot", "nobody"], "nobody"),
        (["BAG", "--on", "map.yaml"], "--on is the map of a logbook: give a folder"),
    ],
)
def test_mistakes_on_the_command_line_are_one_line(bag, folder, capsys, arguments, problem):
    named = [str(bag) if word == "BAG" else word for word in arguments]
    status, output, errors = ran(capsys, *named)
    assert status == 1
    assert output == ""
    assert problem in errors.splitlines()[-1]


# -- files
def test_a_clock_that_was_set_back_is_noticed_in_the_order_of_the_file(spoilt, folder, capsys):
    _, driven = spoilt
    path = write(folder / "drive.bag", until(driven, 6.0))
    _, expected, _ = ran(capsys, path, "--quick")
    with Reader(path) as reader, Writer(folder / "set.bag") as writer:
        connections = {}
        begin = reader.start_time
        for connection, time, raw_message in reader.messages():
            if connection.topic not in connections:
                connections[connection.topic] = writer.add_connection(
                    connection.topic,
                    connection.msgtype,
                    msgdef=connection.msgdef.data,
                    md5sum=connection.digest,
                )
            # The robot's own clock, that of the stamps, was not set.
            hours = 1 if time < begin + 3 * SECOND else 0
            writer.write(connections[connection.topic], time + hours * 3600 * SECOND, raw_message)
    _, output, errors = ran(capsys, folder / "set.bag", "--quick")
    assert output.splitlines()[0] == expected.splitlines()[0]
    assert "all times jump by -3,600 s after 3.0 s: the clock was set" in errors


def test_a_bag_that_a_folder_leaves_out_is_named_with_the_remedy(tmp_path, caplog):
    for name in ("a.bag", "b.bag.active", "c.db3.zstd", "a.bag.why.json"):
        (tmp_path / name).write_bytes(b"")
    assert bags_in([tmp_path]) == [tmp_path / "a.bag"]
    remedies = [record.getMessage().rpartition("left out: ")[2] for record in caplog.records]
    assert remedies == [CUT_SHORT, "unpack it"]
    (tmp_path / "a.bag").unlink()
    with pytest.raises(BagError, match="rosbag reindex"):
        bags_in([tmp_path])
