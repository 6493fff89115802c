"""Tests of the replay of recorded drives: reproduction, events, explanations, alternatives,
comparison, mistakes.
"""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.drives.drive import Changes, Plans
from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.parameters.obstacle_range import laser_sources
from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from applr_ros1.why import alternatives
from applr_ros1.why import replay as replay_module
from applr_ros1.why.alternatives import Alternative, Result, guesses_of
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.explanation import explain, part_of_robot
from applr_ros1.why.moment import Memory
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import changes_of, replay_of, some
from applr_ros1.why.rerun import RerunPlanner
from applr_ros1.why.stretch import SLOW
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.browser import focused, needs_browser, opened
from tests.support.drives import before_a_monitor, changed, decided, simulated, until
from tests.support.pages import data_of
from training.bags.read import BagError
from training.bags.write import write
from training.why import __main__ as why
from training.why.answer import Answer, lines_of

PLANNER = "TrajectoryPlannerROS"
# The fault of the `spoilt` drive: the planner samples only its slowest speed, 0.1 m/s.
FAULT = {PLANNER: {"vx_samples": 1}}
JACKAL = robots.JACKAL
WAFFLE = robots.load("turtlebot3_waffle_pi")


@pytest.fixture(scope="module")
def spoilt():
    """Return a Jackal with a fault, and a recording of its drive."""
    robot = changed(JACKAL, FAULT)
    drive, _ = simulated(robot, "generated:40", limit=12)
    return robot, drive


@pytest.fixture(scope="module")
def sound():
    """Return a replay of a drive without a fault."""
    drive, _ = simulated(JACKAL, "generated:40", limit=8)
    return replayed(JACKAL, drive)


@pytest.fixture(scope="module")
def bag(sound, tmp_path_factory):
    """Return the bag of the drive without a fault."""
    bag_path = tmp_path_factory.mktemp("why") / "drive.bag"
    return write(bag_path, sound.drive)


@pytest.fixture(scope="module")
def replay(spoilt):
    """Return a replay of the drive with the fault."""
    return replayed(*spoilt)


def replayed(robot, driven):
    """Return a replay that has run through a drive."""
    return replay_of(Recording.of(driven, robot))


def read_back(path, robot=JACKAL):
    """Return the drive that `./applr why` reads from a bag."""
    options = why.WhyOptions(bag=[str(path)], robot=robot)
    return why.recording_of(path, options, RerunPlanner(robot)).drive


def values_in(cycles, server, name):
    """Return all values that a parameter had in some cycles."""
    return {cycle.settings[server][name] for cycle in cycles}


def lethal_cells(cycle):
    """Return the number of lethal cells in the local costmap of a cycle."""
    _, cells, *_ = cycle.map
    return np.count_nonzero(cells == LETHAL)


def updates(*rows):
    """Return changes of parameters (time, server, values)."""
    times, servers, values = zip(*rows)
    return Changes(np.array(times), list(servers), list(values))


def without_rows(plans, first, last):
    """Return plans without those from row `first` to before row `last`."""
    kept_rows = np.r_[0:first, last : len(plans)]
    kept_paths = [plans.path[row] for row in kept_rows]
    return Plans(plans.time[kept_rows], kept_paths)


def delayed(motion):
    """Return odometry whose messages have the content of the one before."""
    pose = np.concatenate([motion.pose[:1], motion.pose[:-1]])
    twist = np.concatenate([motion.twist[:1], motion.twist[:-1]])
    return replace(motion, pose=pose, twist=twist)


def test_every_command_is_reproduced_with_the_parameters_that_drove_and_few_with_others(
    replay, spoilt
):
    # Twelve seconds at 20 Hz.
    assert len(replay.cycles) > 200
    assert replay.share == 1.0
    # The same drive with a sound Jackal's parameters, which command more than the slowest speed.
    _, driven = spoilt
    sound_replay = replayed(JACKAL, until(driven, 2.0))
    assert sound_replay.share < 0.5


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
        replay = why.with_range_of_method(replayed(robot, drive))
        assert replay.reproduced == len(replay.cycles)
        sources = laser_sources(replay.robot.parameters())
        assert {source.obstacle_range for source in sources} == {expected_range}
        assert replay.drive.notes == notes


def test_a_dwa_drive_is_reproduced_and_a_new_plan_clears_its_flags():
    driven, _ = simulated(WAFFLE, "generated:3", limit=8)
    replay = replayed(WAFFLE, driven)
    assert replay.share == 1.0

    # The first twelve fields of DWA's state are flags of its oscillation critic. C++ clears them
    # with each new plan.
    field_count = len(replay.cycles[0].memory.flags)
    all_flags_set = Memory([1] * 12 + [0.0] * (field_count - 12))
    no_flag_set = Memory([0.0] * field_count)
    cycle = replace(replay.cycles[20], memory=all_flags_set)
    assert replay.planner.clears_flags(cycle)
    assert not replay.planner.clears_flags(replace(cycle, memory=no_flag_set))

    # So a new plan says what a planner without flags says, and the same plan something else.
    without_flags = replay.planner.run(replace(cycle, memory=no_flag_set))
    assert replay.planner.run(replace(cycle, is_new=True)) == without_flags
    assert replay.planner.run(cycle) != without_flags


def test_the_replay_goes_on_after_messages_that_are_missing(spoilt):
    """Four of five scans and odometry messages are missing."""
    robot, driven = spoilt
    every_fifth = slice(0, 100, 5)
    sparse_drive = replace(
        until(driven, 5.0),
        odometry=driven.odometry.part(every_fifth),
        scans=driven.scans.part(every_fifth),
    )

    replay = replayed(robot, sparse_drive)

    # Cycles with old messages differ, those right after a message do not.
    assert 0.2 < replay.share < 1.0
    assert all(cycle.error < np.inf for cycle in replay.cycles)


def test_a_drive_that_is_not_reproduced_soon_gets_the_likely_messages_alone_and_says_so(
    spoilt, monkeypatch
):
    """Otherwise each of its commands would cost hundreds of the planner's cycles."""
    _, driven = spoilt
    beginning = until(driven, 1.5)
    patient_replay = replayed(JACKAL, beginning)
    assert patient_replay.cut_short == 0

    monkeypatch.setattr(replay_module, "HEAD_START", 100)
    monkeypatch.setattr(replay_module, "PATIENCE", 5)
    answers = []
    answer = RerunPlanner.run
    monkeypatch.setattr(
        RerunPlanner, "run", lambda self, asked: answers.append(asked) or answer(self, asked)
    )
    hasty_replay = replayed(JACKAL, beginning)

    cycle_count = len(hasty_replay.cycles)
    assert cycle_count > 20
    # One command costs 8 updates of 30 states each. All others together have 30 states each.
    assert len(answers) < 240 + 30 * cycle_count
    assert hasty_replay.cut_short > 0.8 * cycle_count
    words = f"; {hasty_replay.cut_short} of them were compared with the likely messages alone"
    assert words in str(hasty_replay)


def test_a_choice_is_tried_once(spoilt, monkeypatch):
    """A robot that stands repeats its messages, and its map stays."""
    robot, driven = spoilt
    part = until(driven, 1.0)
    motion = part.odometry
    standing = replace(motion, pose=motion.pose[:1].repeat(len(motion), 0), twist=0 * motion.twist)
    asked_by_command = {}
    answer = RerunPlanner.run

    def counted(self, asked):
        choice = (asked.pose, asked.twist, asked.is_new, id(asked.plan))
        cells = b"".join(layer.tobytes() for layer in asked.map)
        asked_by_command.setdefault(asked.at, []).append((choice, cells))
        return answer(self, asked)

    monkeypatch.setattr(RerunPlanner, "run", counted)
    # No planner commands this.
    commands = replace(part.planned, twist=np.full_like(part.planned.twist, 9.0))
    replayed(robot, replace(part, odometry=standing, planned=commands))
    for asked in asked_by_command.values():
        assert len(asked) == len(set(asked))


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


def test_a_call_that_cleared_nothing_is_not_replayed():
    """As with a move_base that does not answer."""
    driven, _ = simulated(JACKAL, "generated:40", limit=8)
    decision = decided({}, 3.0)._replace(cleared=True)
    replay = replayed(JACKAL, replace(driven, decisions=[decision]))
    assert replay.share == 1.0


def test_a_bag_gives_the_drive_that_was_written(bag, sound):
    driven = sound.drive
    recorded = read_back(bag)
    # A read drive begins at 0 s. Stamps of ROS have whole nanoseconds.
    begin_time = driven.odometry.time[0]
    for column_name in ("odometry", "planned", "scans", "plans"):
        recorded_times = getattr(recorded, column_name).time
        driven_times = getattr(driven, column_name).time
        assert np.allclose(recorded_times, driven_times - begin_time, atol=1e-6)
    assert np.allclose(recorded.planned.twist, driven.planned.twist)
    assert np.allclose(recorded.odometry.pose, driven.odometry.pose)
    assert np.allclose(recorded.odometry.twist, driven.odometry.twist)
    assert np.allclose(recorded.scans.fan, driven.scans.fan)
    assert np.array_equal(recorded.scans.ranges[5], driven.scans.ranges[5])
    assert np.allclose(recorded.plans.path[5], driven.plans.path[5])


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
    robot, driven = spoilt
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


def test_a_scan_is_placed_between_two_headings_across_the_back(spoilt):
    robot, driven = spoilt
    two_messages = driven.odometry.part(slice(0, 4, 2))
    # From 3.1 to -3.1 rad the short way is 0.08 rad across the back. The mean of both numbers
    # would turn the laser to the front.
    two_poses = np.array([(0.0, 0.0, 3.1), (0.0, 0.0, -3.1)])
    drive = replace(driven, odometry=replace(two_messages, pose=two_poses))

    laser_x, _, laser_yaw = Recording.of(drive, robot).scan(1).sensor_pose

    assert abs(laser_yaw) == pytest.approx(3.1, abs=0.05)
    # The robot's heading is about pi, so that the laser, mounted ahead of its centre, is at -x.
    assert laser_x == pytest.approx(-robot.laser.pose[0], abs=0.01)


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


def test_scans_of_another_laser_are_refused(bag):
    other_laser = JACKAL.laser.model_copy(update={"frame": "other_laser"})
    problem = f"scans in {JACKAL.laser.frame}, jackal has other_laser: give --scan"
    with pytest.raises(BagError, match=problem):
        read_back(bag, replace(JACKAL, laser=other_laser))


def test_the_share_is_of_all_commands_and_says_what_was_left_out(spoilt):
    """move_base stops twice without a plan, and one command comes before the first scan."""
    robot, driven = spoilt
    driven = until(driven, 2.0)
    command_count = len(driven.planned)
    plans = without_rows(driven.plans, 10, 12)
    is_after_first_command = driven.scans.time > driven.planned.time[0]
    first_scan = int(np.argmax(is_after_first_command))
    scans = driven.scans.part(slice(first_scan, None))

    replay = replayed(robot, replace(driven, plans=plans, scans=scans))

    assert len(replay.cycles) == command_count - 3
    assert replay.share == pytest.approx(replay.reproduced / command_count)
    text = (
        f"of {command_count} commands reproduced ({replay.share:.1%}); "
        "left out: 1 before the first scan or odometry, "
        "2 without a plan (stops and recoveries of move_base)"
    )
    assert text in str(replay)
    assert replay.share_of_cycles == replay.reproduced / (command_count - 3)


def test_a_late_velocity_is_found(spoilt):
    robot, driven = spoilt
    late_drive = replace(until(driven, 3.0), odometry=delayed(driven.odometry))
    replay = replayed(robot, late_drive)
    # The replay knows that a planner may have had a velocity one message older.
    assert replay.share > 0.9


def test_an_empty_plan_stands_for_the_one_before(spoilt):
    robot, driven = spoilt
    driven = until(driven, 2.0)
    plan_paths = list(driven.plans.path)
    plan_paths[10] = np.zeros((0, 3))
    plans = replace(driven.plans, path=plan_paths)
    replay = replayed(robot, replace(driven, plans=plans))
    assert replay.cycles[10].plan is plan_paths[9]


def test_the_flags_after_a_command_that_is_not_reproduced_are_those_of_this_command(spoilt):
    robot, driven = spoilt
    driven = until(driven, 2.0)
    twist = driven.planned.twist.copy()
    twist[20] = -0.1, 0.0  # The planner backs out.
    commands = replace(driven.planned, twist=twist)

    replay = replayed(robot, replace(driven, planned=commands))

    # The replay's planner would drive on. Its memory must follow the robot, which backed out.
    backs_out = replay.cycles[20]
    assert not backs_out.reproduced
    memory = replay.planner.followed(backs_out, (-0.1, 0.0))
    assert replay.cycles[21].memory == memory != backs_out.memory

    # Backing out sets the flag of an escape. A drive ahead from the same state does not.
    escaping_field = TrajectoryPlanner.STATE.names.index("escaping")
    assert memory.flags[escaping_field] == 1
    assert replay.planner.followed(backs_out, (0.1, 0.0)).flags[escaping_field] == 0


def test_a_map_is_updated_from_any_other_as_if_it_had_been_shown_all_the_time(spoilt):
    robot, driven = spoilt
    replay = replayed(robot, driven)
    planner = replay.planner
    earlier_cycle = replay.cycles[10]
    last_cycle = replay.cycles[-1]
    assert tuple(earlier_cycle.map[0]) != tuple(last_cycle.map[0])
    pose, _ = replay.recording.measured(12)
    cloud = replay.cloud(12)
    settings = earlier_cycle.settings

    updated_map = planner.updated(earlier_cycle.map, settings, pose, cloud)
    # In between the planner has another map, and inflates this one anew by other parameters.
    planner.run(last_cycle)
    layer = "local_costmap/inflater_layer"
    wider = Change(layer, "inflation_radius", 0.3, 1.0)
    planner.ahead(earlier_cycle, settings.with_(wider), 3)
    updated_again = planner.updated(earlier_cycle.map, settings, pose, cloud)

    for cells, cells_again in zip(updated_map, updated_again, strict=True):
        assert np.array_equal(cells, cells_again)


@pytest.mark.parametrize("robot", [JACKAL, WAFFLE], ids=lambda robot: robot.name)
def test_what_the_planner_said_is_the_same_in_any_order(robot):
    # Given: cycles from the begin to the turn at the goal, with parameters that change on the way
    driven, _ = simulated(robot, "generated:3", limit=40)
    replay = replayed(robot, driven)
    assert replay.share > 0.99
    cycles = replay.cycles[::40] + replay.cycles[-3:]
    assert all(cycle.reproduced for cycle in cycles)
    for row in range(0, len(cycles), 2):
        shorter = Change(robot.local_planner, "sim_time", 1.7, 1.0)
        cycles[row] = replace(cycles[row], settings=cycles[row].settings.with_(shorter))

    def said(cycle):
        """Return what the planner said in a cycle, as plain values."""
        moment = replay.at(cycle)
        numbers = [moment.samples.costs, *moment.samples.parts.values()]
        numbers += [moment.trajectory_points.ravel(), moment.map.cells.ravel()]
        return [*moment.command, *np.concatenate(numbers)]

    in_order = [said(cycle) for cycle in cycles]

    # When: they are asked for backwards, and the planner drives on with other values in between
    backwards = []
    for cycle in cycles[::-1]:
        longer = Change(robot.local_planner, "sim_time", 1.0, 2.5)
        replay.ahead(cycles[0], cycle.settings.with_(longer), 5)
        backwards.append(said(cycle))

    # Then: it says the same, and with its own parameters it commands what was recorded
    for once, again in zip(in_order, backwards[::-1], strict=True):
        assert np.array_equal(once, again, equal_nan=True)
    for cycle, values in zip(cycles[1::2], in_order[1::2], strict=True):
        assert values[:2] == pytest.approx(cycle.command)


# -- explanations and alternatives -----------------------------------------------------------------
def driven_with_post(ahead, left, since=0.0):
    """Return a replay of a drive in which the laser sees a post at a place relative to the robot
    [m] from a time [s] on.

    The post moves with the robot, as a part of the robot would.
    """
    laser = JACKAL.laser
    ahead_of_laser = ahead - laser.pose[0]
    post_distance = np.hypot(ahead_of_laser, left)
    angle = np.arctan2(left, ahead_of_laser)
    beam = round((angle - laser.first_angle) / laser.increment)

    class Simulator(KinematicSimulator):
        def scan(self):
            ranges = np.array(super().scan())
            if self.state.time >= since:
                ranges[beam - 15 : beam + 15] = post_distance
            return ranges

    replay = replayed(JACKAL, simulated(JACKAL, "generated:40", limit=6, simulator=Simulator)[0])
    assert replay.share == 1.0
    return replay


def test_the_obstacle_in_the_way_is_named():
    replay = driven_with_post(0.5, 0.15, since=3.0)
    cycle = replay.cycles[66]  # 0.3 s after the post appeared
    explanation = explain(replay, cycle)
    # "28 of 30 faster samples ..."
    obstacle_line = explanation.lines[-1]
    numbers = obstacle_line.split(" faster samples")[0]
    blocked_count, faster_count = map(int, numbers.split(" of "))
    assert faster_count > 20
    assert blocked_count > 0.9 * faster_count
    obstacle_from_robot = transform_point(inverse(cycle.pose), *explanation.obstacle)
    # A cell has 0.05 m, and the robot moved a little since the scan.
    assert obstacle_from_robot == pytest.approx((0.5, 0.15), abs=0.1)
    assert "m to the left, from the latest scan" in obstacle_line

    # If the latest scan does not have the post, the costmap knows it from those before.
    ranges = replay.drive.scans.ranges
    before_the_post = ranges[40]
    ranges[cycle.scan] = before_the_post
    assert "from earlier scans" in explain(replay, cycle).lines[-1]


def test_a_part_of_the_robot_in_the_scans_is_in_the_answer():
    diagnosed = diagnose(driven_with_post(0.5, 0.0))
    first_line, *_ = lines_of(Answer(diagnosed))
    position = r"0.5 m ahead and 0.0 m to the (left|right) of its centre."
    assert re.match(rf"The laser sees a part of the robot, {position}", first_line)
    # Nothing about the planner is guessed from scans that show the robot itself.
    assert guesses_of(diagnosed) == []


def test_a_point_beside_a_robot_that_stands_is_no_part_of_it():
    replay = driven_with_post(0.5, 0.0)
    assert part_of_robot(replay) is not None
    # At one place, a post of the world and a part of the robot look the same.
    replay = replace(replay, cycles=[replay.cycles[0]] * 300)
    assert part_of_robot(replay) is None


def test_a_point_beside_a_robot_that_drives_straight_on_is_no_part_of_it():
    """A wall along its way stays beside it, however far it drives."""
    replay = driven_with_post(0.5, 0.0)
    first_yaw = replay.cycles[0].pose[2]
    straight_cycles = []
    for cycle in replay.cycles:
        if abs(cycle.pose[2] - first_yaw) < 0.3:
            straight_cycles.append(cycle)
    assert len(straight_cycles) > 30
    assert part_of_robot(replace(replay, cycles=straight_cycles)) is None


def test_a_point_beside_a_robot_that_turns_to_and_fro_is_no_part_of_it():
    """It comes back to two headings, at which the same wall is seen each time."""
    replay = driven_with_post(0.5, 0.0)
    first_cycle = replay.cycles[0]
    x, y, yaw = first_cycle.pose
    turned_cycle = replace(first_cycle, pose=(x, y, yaw + 0.3))
    to_and_fro = replace(replay, cycles=[first_cycle, turned_cycle] * 50)
    assert part_of_robot(to_and_fro) is None


def test_a_point_that_is_far_from_the_outline_is_no_part_of_the_robot():
    assert part_of_robot(driven_with_post(0.8, 0.0)) is None


def test_the_costs_of_an_outbid_sample_are_those_of_the_planner():
    robot = changed(JACKAL, {PLANNER: {"occdist_scale": 0.8}})
    driven, _ = simulated(robot, "generated:7", limit=8)
    replay = replayed(robot, driven)
    assert part_of_robot(replay) is None
    cycle = replay.cycles[-20]
    explanation = explain(replay, cycle)

    # The planner's own costs: their parts add up, and the command, in the last row, is cheapest.
    moment = replay.at(cycle)
    command = moment.command
    velocities, costs, parts = moment.samples
    legal = costs >= 0
    assert np.allclose(sum(parts.values())[legal], costs[legal])
    assert all((part[~legal] == 0.0).all() for part in parts.values())
    assert velocities[-1].tolist() == list(command)
    assert costs[-1] == pytest.approx(costs[legal].min())

    # The table begins with the command.
    weights = ["path_distance_bias", "goal_distance_bias", "occdist_scale"]
    assert explanation.table[0] == ["v", "w", "cost", *weights]
    assert explanation.table[1][2] == pytest.approx(costs[-1], abs=0.01)
    assert explanation.points

    # The sentence compares it with the cheapest sample that is not slow.
    is_fast = legal & (velocities[:, 0] >= SLOW * 0.5)
    fast_samples = np.flatnonzero(is_fast)
    outbid_sample = fast_samples[costs[is_fast].argmin()]
    command_text = "({:.2f} m/s, {:.2f} rad/s)".format(*command)
    costs_text = f"costs {costs[outbid_sample]:.1f}, the command {command_text} {costs[-1]:.1f}: "
    occdist = parts["occdist_scale"]
    (first_line, *_) = explanation.lines
    assert costs_text in first_line
    assert ": occdist_scale 0.8 " in first_line
    assert f"counts {occdist[outbid_sample]:.1f} against {occdist[-1]:.1f}" in first_line


def test_a_cheaper_sample_that_the_escaping_planner_did_not_try_is_said(sound):
    cycle = sound.cycles[40]
    planner_state = dict(zip(TrajectoryPlanner.STATE.names, cycle.memory.flags, strict=True))
    x, y, yaw = cycle.pose
    # The planner began to escape here, and escapes until it is some way off.
    planner_state.update(
        escaping=1,
        escape_x=x,
        escape_y=y,
        escape_theta=yaw,
    )
    escaping_cycle = replace(cycle, memory=Memory(list(planner_state.values())))

    line_if_escaping = explain(sound, escaping_cycle).lines[0]
    line_otherwise = explain(sound, cycle).lines[0]

    assert "was not sampled, because the planner is escaping" in line_if_escaping
    assert line_otherwise.startswith("The planner drives on (")


def test_a_plan_that_leads_back_is_the_whole_reason(sound):
    cycle = sound.cycles[40]
    x, y, yaw = cycle.pose
    turned_round = replace(cycle, pose=(x, y, yaw + np.pi))
    words_if_turned = explain(sound, turned_round).words
    assert words_if_turned == "the plan leads back, behind the robot"
    assert "leads back" not in explain(sound, cycle).words


def test_samples_that_dwa_refuses_are_explained():
    """The speed of a waffle_pi that backs out slowly is below min_vel_trans, and it turns slower
    than min_vel_theta.
    """
    driven, _ = simulated(WAFFLE, "generated:3", limit=3)
    replay = replayed(WAFFLE, driven)
    # With this velocity, the samples reach from backing out to a slow turn.
    backs_out = replace(replay.cycles[10], twist=(-0.2, 0.0))
    last_line = explain(replay, backs_out).lines[-1]
    assert "0.00 rad/s) is below min_vel_trans (0.13) and min_vel_theta (0.9)" in last_line

    # Nothing straight lies between both limits of the speed.
    lowered = Change(replay.planner.name, "max_vel_trans", 0.26, 0.08)
    crossed = replace(backs_out, settings=backs_out.settings.with_(lowered))
    assert explain(replay, crossed).words == (
        "every straight way is refused, as max_vel_trans (0.08) is below min_vel_trans (0.13): "
        "no straight command is allowed"
    )

    # So it is when the plan leads back, too.
    x, y, yaw = crossed.pose
    turned_round = replace(crossed, pose=(x, y, yaw + np.pi))
    assert "max_vel_trans (0.08) is below" in explain(replay, turned_round).words

    # At full speed, the planner would have to brake.
    lowered = Change(replay.planner.name, "max_vel_trans", 0.26, 0.15)
    at_speed = replace(replay.cycles[10], twist=(0.26, 0.0))
    too_fast = replace(at_speed, settings=at_speed.settings.with_(lowered))
    assert "is above max_vel_trans (0.15)" in explain(replay, too_fast).lines[-1]

    # All flags of the oscillation critic set: no direction is left.
    last_cycle = replay.cycles[-1]
    all_flags_set = Memory([1.0] * len(last_cycle.memory.flags))
    oscillates = replace(last_cycle, memory=all_flags_set)
    last_line = explain(replay, oscillates).lines[-1]
    assert "is refused by the critic oscillation" in last_line


def test_the_spoilt_parameter_is_the_first_guess_and_every_guess_gains_speed(replay, monkeypatch):
    # Fewer cycles than people get, because each takes the time of a drive.
    monkeypatch.setattr(alternatives, "CYCLES", 4)
    guesses = guesses_of(diagnose(replay))
    assert guesses[0].change.name == "vx_samples"
    for guess in guesses:
        assert guess.gain > 0.0


def test_reproduced_cycles_are_preferred(replay):
    reproduced = replay.cycles[0]
    not_reproduced = replace(replay.cycles[1], error=1.0)
    mixed_cycles = [reproduced] * 20 + [not_reproduced] * 10
    chosen_cycles = some(mixed_cycles, 30)
    assert len(chosen_cycles) == 20
    for cycle in chosen_cycles:
        assert cycle is reproduced
    # If no cycle is reproduced, others must do.
    assert some([not_reproduced], 3) == [not_reproduced]
    assert some([], 3) == []


def test_alternatives_begin_on_the_way_into_an_event(sound, monkeypatch):
    begin_times = []

    def best_changes(replay, changes, cycles, others):
        for cycle in cycles:
            begin_times.append(cycle.at)
        return []

    monkeypatch.setattr(alternatives, "best_changes", best_changes)
    guesses_of(diagnose(sound, at=5.0))
    # The event of a moment is half a second around it. The way into it counts from 2 s before.
    assert min(begin_times) == pytest.approx(2.5, abs=0.1)
    assert max(begin_times) == pytest.approx(5.5, abs=0.1)


def test_driving_on_follows_the_commands(replay):
    cycle = replay.cycles[100]
    ((speed, distance),) = alternatives.drive_on(replay, [cycle])
    assert speed == pytest.approx(0.1, abs=0.03)  # the only speed
    assert 0.2 < distance < 3.0

    more_samples = Change(PLANNER, "vx_samples", 1, 20)
    ((higher_speed, _),) = alternatives.drive_on(replay, [cycle], more_samples)
    assert higher_speed > 0.2

    # Symmetric limits stay so.
    slower_turns = Change(PLANNER, "max_vel_theta", 1.57, 1.0)
    changed_settings = cycle.settings.with_(*alternatives.together(cycle.settings, slower_turns))
    assert changed_settings[PLANNER]["min_vel_theta"] == -1.0

    # Others stay as they are.
    slower_right_turns = Change(PLANNER, "min_vel_theta", -1.57, -0.5)
    skewed_settings = cycle.settings.with_(slower_right_turns)
    assert alternatives.together(skewed_settings, slower_turns) == (slower_turns,)


def test_nearly_equal_alternatives_are_ordered_by_departure_from_the_default(replay):
    declared = by_name(replay.planner.parameters(PLANNER))

    def alternative(name, before, after, gain):
        change = Change(PLANNER, name, before, after)
        default = declared[name].default
        stands = Result(0.0, 0.0)
        gains = Result(gain, 0.0)
        return Alternative((change,), default, stands, gains)

    # The first four gain about as much (at least WITHIN of the best), so that small changes are
    # preferred. vx_samples gains too little for that.
    tried = [
        alternative("sim_time", 2.0, 8.0, 1.0),
        alternative("sim_time", 2.0, 1.7, 0.92),
        alternative("occdist_scale", 0.1, 0.01, 0.95),
        alternative("occdist_scale", 0.1, 0.05, 0.93),
        alternative("vx_samples", 1, 20, 0.5),
    ]
    values_in_order = [each.change.after for each in alternatives.ranked(tried)]
    assert values_in_order == [0.05, 0.01, 1.7, 8.0, 20]


def test_changes_that_pass_obstacles_too_closely_are_left_out(replay, monkeypatch):
    fast_but_close = Change(PLANNER, "sim_time", 2.0, 1.0)
    slower = Change(PLANNER, "sim_time", 2.0, 4.0)
    # Speed [m/s] and smallest distance of obstacles [m]
    results = {
        None: (0.1, 0.5),
        fast_but_close: (0.5, 0.05),
        slower: (0.3, 0.5),
    }

    def drive_on(replay, cycles, change=None):
        return np.array([results[change]] * len(cycles))

    monkeypatch.setattr(alternatives, "drive_on", drive_on)
    (alternative,) = alternatives.best_changes(
        replay,
        [fast_but_close, slower],
        replay.cycles[:4],
        replay.cycles[4:6],
    )
    assert alternative.change == slower
    assert alternative.gain == pytest.approx(0.2)
    assert alternative.elsewhere == pytest.approx(0.2)


def test_another_inflation_applies_to_the_recorded_map(replay):
    """With a wide one, the planner passes obstacles at another distance."""
    layer = "local_costmap/inflater_layer"
    cycle = replay.cycles[100]
    tracks = []
    for radius in (0.1, 1.0):
        wider = cycle.settings.with_(Change(layer, "inflation_radius", 0.3, radius))
        tracks.append(replay.ahead(cycle, wider, 40).track)
    assert not np.array_equal(*tracks)
    # The recorded map itself keeps its own inflation.
    assert replay.at(cycle).command == pytest.approx(cycle.command)


# -- the command -----------------------------------------------------------------------------------
def ran(capsys, *arguments):
    """Run the command; return its exit status, output and errors."""
    status = why.main([str(argument) for argument in arguments])
    output, errors = capsys.readouterr()
    return status, output, errors


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder, and let the command try little, so that it is fast."""
    monkeypatch.setattr(alternatives, "CYCLES", 2)
    monkeypatch.setattr(alternatives, "FACTORS", ())
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
    assert "no parameter_updates" not in comparison


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        ({"scans": None}, "no messages on /front/scan"),
        ({"odometry": None}, "no messages on /odometry/filtered"),
        ({"planned": None, "commands": None}, "no messages on /cmd_vel"),
        (
            {"plans": None, "routes": None},
            "no messages on /move_base/TrajectoryPlannerROS/global_plan",
        ),
        (
            {"planners": ["TebLocalPlannerROS"]},
            "only drives of TrajectoryPlannerROS and DWAPlannerROS are replayed",
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


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["none.bag"], "none.bag: there is no such file"),
        (["BAG", "--at", "500"], "--at 500: outside the drive, give "),
        (["BAG", "--robot", "nobody"], "nobody"),
    ],
)
def test_mistakes_on_the_command_line_are_one_line(bag, folder, capsys, arguments, problem):
    named = [str(bag) if word == "BAG" else word for word in arguments]
    status, output, errors = ran(capsys, *named)
    assert status == 1
    assert output == ""
    assert problem in errors.splitlines()[-1]


def test_half_a_drive_is_replayed_as_far_as_it_goes(spoilt, folder):
    robot, driven = spoilt
    fifty_commands = driven.planned.part(slice(100, 150))
    part = replace(driven, planned=fifty_commands)
    replay = replayed(robot, part)
    assert len(replay.cycles) == 50
    # The first cycles lack the costmap that the robot had built up before.
    assert replay.share > 0.5

    # A command without a plan of its time is no cycle of the local planner.
    fewer_plans = replace(part, plans=without_rows(driven.plans, 110, 120))
    replay_with_gap = replayed(robot, fewer_plans)
    assert len(replay_with_gap.cycles) == 40
    assert replay_with_gap.cycles[15].reproduced
