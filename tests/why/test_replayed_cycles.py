"""Tests of the replay of recorded drives."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.drives.drive import Plans
from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from applr_ros1.why import replay as replay_module
from applr_ros1.why.moment import Memory
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import some
from applr_ros1.why.rerun import RerunPlanner
from tests.support.drives import decided, simulated, until
from tests.support.replays import (
    JACKAL,
    WAFFLE,
    replayed,
    spoilt_drive,
    updates,
)


@pytest.fixture(scope="module")
def spoilt():
    """Return a Jackal with a fault, and a recording of its drive."""
    return spoilt_drive()


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


@pytest.mark.heavy
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


def test_a_drive_that_is_not_reproduced_soon_gets_the_likely_messages_alone(spoilt, monkeypatch):
    """Otherwise each of its commands would cost hundreds of the planner's cycles."""
    _, driven = spoilt
    beginning = until(driven, 1.5)

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


def test_a_call_that_cleared_nothing_is_not_replayed():
    """As with a move_base that does not answer."""
    driven, _ = simulated(JACKAL, "generated:40", limit=8)
    decision = decided({}, 3.0)._replace(cleared=True)
    replay = replayed(JACKAL, replace(driven, decisions=[decision]))
    assert replay.share == 1.0


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


def test_the_share_is_of_the_planners_commands_and_says_what_was_left_out(spoilt):
    """move_base stops twice without a plan, and one command comes before the first scan."""
    robot, driven = spoilt
    driven = until(driven, 2.0)
    command_count = len(driven.planned)
    plans = without_rows(driven.plans, 10, 12)
    is_after_first_command = driven.scans.time > driven.planned.time[0]
    first_scan = int(np.argmax(is_after_first_command))
    scans = driven.scans.part(slice(first_scan, None))

    replay = replayed(robot, replace(driven, plans=plans, scans=scans))

    planner_count = command_count - 3
    assert len(replay.cycles) == planner_count
    assert replay.share == pytest.approx(replay.reproduced / planner_count)
    text = (
        f"of {planner_count} commands reproduced ({replay.share:.1%}); "
        "left out: 1 before the first scan or odometry, "
        "2 without a plan (stops and recoveries of move_base)"
    )
    assert text in str(replay)


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


@pytest.mark.heavy
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


def test_half_a_drive_is_replayed_as_far_as_it_goes(spoilt):
    robot, driven = spoilt
    fifty_commands = driven.planned.part(slice(100, 150))
    part = replace(driven, planned=fifty_commands)
    replay = replayed(robot, part)
    assert len(replay.cycles) == 50
    # The first cycles lack the costmap that the robot had built up before.
    assert replay.share > 0.5


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


def test_chosen_cycles_are_evenly_spread_and_with_a_power_early_ones_are_preferred():
    cycles = [SimpleNamespace(at=row, reproduced=True) for row in range(101)]
    assert [cycle.at for cycle in some(cycles, 5)] == [0, 25, 50, 75, 100]
    # The squares of 0, 1/4, 1/2, 3/4 and 1
    assert [cycle.at for cycle in some(cycles, 5, power=2.0)] == [0, 6, 25, 56, 100]


def test_a_cycle_keeps_its_map_whatever_the_planner_had_before(replay):
    cycle = replay.cycles[100]
    # An obstacle that no layer knows: a map that is inflated anew loses it.
    origin, cells, *layers = cycle.map
    marked_cells = cells.copy()
    marked_cells[0, 0] = LETHAL
    marked = replace(cycle, map=(origin, marked_cells, *layers))
    # Another padding clears the costmap of a MoveBase.
    padding = Change("local_costmap", "footprint_padding", 0.1, 0.14)
    padded = replace(marked, settings=marked.settings.with_(padding))

    assert np.array_equal(replay.at(marked).map.cells, marked_cells)
    assert np.array_equal(replay.at(padded).map.cells, marked_cells)
    replay.ahead(padded, padded.settings, 2)
    assert np.array_equal(replay.at(padded).map.cells, marked_cells)


@pytest.mark.parametrize("robot", [JACKAL, WAFFLE], ids=lambda robot: robot.name)
def test_a_planner_that_turns_at_its_goal_turns_on_and_one_that_stops_stops_first(robot):
    driven, _ = simulated(robot, "generated:3", limit=3)
    replay = replayed(robot, driven)
    cycle = replay.cycles[-1]
    x, y, yaw = cycle.pose
    # The plan ends where the robot is, with another heading.
    at_goal = replace(cycle, plan=np.array([(x, y, yaw + 1.5)]), twist=(0.2, 0.0))
    turns = replace(at_goal, memory=cycle.memory._replace(is_turning=True))
    for _ in range(2):
        stopping = replay.planner.run(at_goal)
        turning = replay.planner.run(turns)
        assert stopping.command[1] == 0.0
        assert turning.command[1] > 0.0
        assert (stopping.memory.is_turning, turning.memory.is_turning) == (False, True)


def test_a_change_of_a_costmaps_parameters_clears_it():
    """As in C++, what the laser no longer sees is gone."""
    driven, _ = simulated(JACKAL, "generated:40", limit=8)
    padding = updates((7.0, "local_costmap", {"footprint_padding": 0.14}))
    changed_replay = replayed(JACKAL, replace(driven, changes=padding))
    unchanged_replay = replayed(JACKAL, driven)
    assert lethal_cells(changed_replay.cycles[-1]) < lethal_cells(unchanged_replay.cycles[-1])


def lethal_cells(cycle):
    """Return the number of lethal cells in the local costmap of a cycle."""
    _, cells, *_ = cycle.map
    return np.count_nonzero(cells == LETHAL)
