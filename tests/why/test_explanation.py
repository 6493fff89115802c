"""Tests of explanations: what the planner weighed, and a part of the robot in its scans."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.planner.dwa.critics.registry import CRITICS
from applr_ros1.planner.parameters.settings import Change, Settings
from applr_ros1.planner.sampling_planner import OBSTACLE_TERM, PATH_TERM
from applr_ros1.planner.trajectory.planner import SCALES, TrajectoryPlanner
from applr_ros1.why import diagnosis
from applr_ros1.why.alternatives import guesses_of
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import diagnose, explain_event, usual_row
from applr_ros1.why.events import AT_GOAL, Event
from applr_ros1.why.explanation import Explanation, at_goal, beside, explain, part_of_robot
from applr_ros1.why.limits import start_values
from applr_ros1.why.moment import ComparedSamples, CycleMoment, LocalMap, Memory
from applr_ros1.why.replay import Replay, ReplayedCycle
from applr_ros1.why.stretch import SLOW
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.drives import changed, simulated
from tests.support.measured_drives import DRIVES, drive_of
from tests.support.replays import (
    JACKAL,
    PLANNER,
    WAFFLE,
    replayed,
)


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


def cycle_of(command=(0.5, 0.0), at=0.0, yaw=0.0):
    """Return a cycle of the Jackal's planner at (1, 1), whose plan leads to (4, 1)."""
    x = np.linspace(1.0, 4.0, 31)
    return ReplayedCycle(
        pose=(1.0, 1.0, yaw),
        twist=(0.0, 0.0),
        plan=np.column_stack([x, 1.0 + 0.0 * x, 0.0 * x]),
        map=(),
        memory=Memory([]),
        is_new=False,
        settings=Settings({PLANNER: start_values(JACKAL)}),
        at=at,
        command=command,
        scan=0,
    )


def moment_of(cycle, velocities=((0.5, 0.0),), costs=(1.0,), term=None):
    """Return what the planner says in a cycle with these samples, beside no obstacle."""
    velocities = np.array(velocities)
    costs = np.array(costs)
    parts = {term: costs} if term else {PATH_TERM: np.maximum(costs, 0.0)}
    free_cells = np.zeros((10, 10), np.uint8)
    return CycleMoment(
        asked=cycle,
        planner=PLANNER,
        lookahead=1.0,
        command=cycle.command,
        samples=ComparedSamples(velocities, costs, parts),
        trajectory_points=np.zeros((0, 3)),
        map=LocalMap(free_cells, np.zeros(2), resolution=0.05, footprint=np.zeros((4, 2))),
        scan_points=np.zeros((0, 2)),
    )


def explained(cycle, velocities, costs, term=None):
    """Return the explanation of a cycle with these samples."""
    return explain(moment_of(cycle, velocities, costs, term))


def explained_in(replay, cycle):
    """Return the explanation of a cycle of a replay."""
    return explain(replay.at(cycle))


def test_the_table_has_the_sample_that_drives_on_in_its_row_of_the_page():
    fast, slow = (0.5, 0.0), (0.1, 0.0)
    drives_on = explained(cycle_of(command=fast), [fast, slow], [1.0, 2.0])
    is_outbid = explained(cycle_of(command=slow), [fast, slow], [2.0, 1.0])
    is_refused = explained(cycle_of(command=slow), [fast, slow], [-1.0, 1.0])
    # Below the names comes the command. It drives on itself, or the sample in the next row does.
    for explanation, row in ((drives_on, 1), (is_outbid, 2)):
        assert explanation.driving == row
        assert explanation.table[row][:2] == list(fast)
    assert is_refused.driving is None


def test_a_sample_that_is_refused_beside_no_obstacle_leaves_the_map():
    fast, slow = (0.5, 0.0), (0.1, 0.0)
    refused = explained(cycle_of(command=slow), [fast, slow], [-1.0, 1.0])
    assert refused.words == "every faster command leaves the map or the reach of the plan"
    assert refused.is_blocked
    assert refused.obstacle is None


def test_the_obstacle_in_the_way_is_named():
    replay = driven_with_post(0.5, 0.15, since=3.0)
    cycle = replay.cycles[66]  # 0.3 s after the post appeared
    explanation = explained_in(replay, cycle)
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
    assert "from earlier scans" in explained_in(replay, cycle).lines[-1]


@pytest.fixture(scope="module")
def with_part():
    """Return a replay in which the laser sees a part of the robot."""
    return driven_with_post(0.5, 0.0)


def turned_by(cycle, yaw):
    """Return a cycle in which the robot has turned."""
    x, y, earlier_yaw = cycle.pose
    return replace(cycle, pose=(x, y, earlier_yaw + yaw))


@pytest.mark.parametrize(
    "driven",
    [
        # At one place, a post of the world and a part of the robot look the same.
        pytest.param(lambda cycles: [cycles[0]] * 300, id="stands"),
        # A wall along its way stays beside it, however far it drives.
        pytest.param(lambda cycles: turned_less(cycles, 0.3), id="drives straight on"),
        # In a narrow place something is beside it at each heading.
        pytest.param(lambda cycles: turned_less(cycles, 1.1), id="turns by a radian"),
        # It comes back to two headings, at which the same wall is seen each time.
        pytest.param(lambda cycles: [cycles[0], turned_by(cycles[0], 0.3)] * 50, id="to and fro"),
    ],
)
def test_a_point_beside_a_robot_that_turns_little_is_no_part_of_it(with_part, driven):
    assert part_of_robot(with_part) is not None
    cycles = driven(with_part.cycles)
    assert len(cycles) > 30
    assert part_of_robot(replace(with_part, cycles=cycles)) is None


def turned_less(cycles, yaw):
    """Return the cycles in which the robot has turned by less than an angle [rad]."""
    return [cycle for cycle in cycles if abs(cycle.pose[2] - cycles[0].pose[2]) < yaw]


def test_a_point_that_is_far_from_the_outline_is_no_part_of_the_robot():
    assert part_of_robot(driven_with_post(0.8, 0.0)) is None


def test_the_costs_of_an_outbid_sample_are_those_of_the_planner():
    robot = changed(JACKAL, {PLANNER: {"occdist_scale": 0.8}})
    driven, _ = simulated(robot, "generated:7", limit=8)
    replay = replayed(robot, driven)
    assert part_of_robot(replay) is None
    cycle = replay.cycles[-20]
    moment = replay.at(cycle)
    explanation = explain(moment)

    # The planner's own costs: their parts add up, and the command, in the last row, is cheapest.
    command = moment.command
    velocities, costs, parts = moment.samples
    legal = costs >= 0
    assert np.allclose(sum(parts.values())[legal], costs[legal])
    assert all((part[~legal] == 0.0).all() for part in parts.values())
    assert velocities[-1].tolist() == list(command)
    assert costs[-1] == pytest.approx(costs[legal].min())

    # The table begins with the command.
    assert explanation.table[0][5] == "nearness to obstacles (occdist_scale)"
    assert explanation.table[1][2] == pytest.approx(costs[-1], abs=0.01)
    assert explanation.points

    # The sentence compares it with the cheapest sample that is not slow.
    is_fast = legal & (velocities[:, 0] >= SLOW * 0.5)
    fast_samples = np.flatnonzero(is_fast)
    outbid_sample = fast_samples[costs[is_fast].argmin()]
    command_text = "({:.2f} m/s, {:.2f} rad/s)".format(*command)
    costs_text = f"costs {costs[outbid_sample]:.1f}, the command {command_text} {costs[-1]:.1f}: "
    occdist = parts[OBSTACLE_TERM]
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

    line_if_escaping = explained_in(sound, escaping_cycle).lines[0]
    line_otherwise = explained_in(sound, cycle).lines[0]

    assert "was not sampled, because the planner is escaping" in line_if_escaping
    assert line_otherwise.startswith("The planner drives on (")


def test_a_plan_that_leads_back_is_the_whole_reason(sound):
    cycle = sound.cycles[40]
    words_if_turned = explained_in(sound, turned_by(cycle, np.pi)).words
    assert words_if_turned == "the plan leads back, behind the robot"
    assert "leads back" not in explained_in(sound, cycle).words


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_plan_leads_back_from_a_right_angle_on(side):
    right_angle = np.pi / 2
    for yaw, leads_back in ((right_angle - 0.05, False), (right_angle + 0.05, True)):
        assert moment_of(cycle_of(yaw=side * yaw)).leads_back == leads_back


def test_the_end_of_a_plan_is_named_only_if_it_is_too_near_for_full_speed():
    slow = (0.1, 0.0)
    cycle = cycle_of(command=slow)
    # In the two seconds of sim_time, 0.2 m/s lead to the first end, and full speed to the second.
    for row_count, is_named in ((5, True), (11, False)):
        near_end = replace(cycle, plan=cycle.plan[:row_count])
        words = explained(near_end, [slow], [1.0]).words
        assert words.startswith("no command faster than 0.10 m/s is sampled (vx_samples 6, acc_")
        assert (", sim_time 2 before the end of the plan)" in words) == is_named


def test_samples_that_dwa_refuses_are_explained():
    """The speed of a waffle_pi that backs out slowly is below min_vel_trans, and it turns slower
    than min_vel_theta.
    """
    driven, _ = simulated(WAFFLE, "generated:3", limit=3)
    replay = replayed(WAFFLE, driven)
    # With this velocity, the samples reach from backing out to a slow turn.
    backs_out = replace(replay.cycles[10], twist=(-0.2, 0.0))
    explanation = explained_in(replay, backs_out)
    last_line = explanation.lines[-1]
    # Whatever its values, it brakes first.
    assert explanation.words == ""
    assert "0.00 rad/s) is below min_vel_trans (0.13) and min_vel_theta (0.9)" in last_line

    # From standing, any robot drives off but one that hardly accelerates.
    hardly = Change(replay.planner.name, "acc_lim_x", 2.5, 0.1)
    stands = replace(backs_out, twist=(0.0, 0.0), settings=backs_out.settings.with_(hardly))
    assert explained_in(replay, stands).words.startswith(
        "no command faster than 0.01 m/s is sampled"
    )

    # Nothing straight lies between both limits of the speed.
    lowered = Change(replay.planner.name, "max_vel_trans", 0.26, 0.08)
    crossed = replace(backs_out, settings=backs_out.settings.with_(lowered))
    assert explained_in(replay, crossed).words == (
        "every straight command is refused, as max_vel_trans (0.08) is below min_vel_trans (0.13): "
        "no straight command is allowed"
    )

    # So it is when the plan leads back, too.
    turned_round = turned_by(crossed, np.pi)
    assert "max_vel_trans (0.08) is below" in explained_in(replay, turned_round).words

    # At full speed, the planner would have to brake.
    lowered = Change(replay.planner.name, "max_vel_trans", 0.26, 0.15)
    at_speed = replace(replay.cycles[10], twist=(0.26, 0.0))
    too_fast = replace(at_speed, settings=at_speed.settings.with_(lowered))
    assert "is above max_vel_trans (0.15)" in explained_in(replay, too_fast).lines[-1]

    # All flags of the oscillation critic set: no direction is left.
    last_cycle = replay.cycles[-1]
    all_flags_set = Memory([1.0] * len(last_cycle.memory.flags))
    oscillates = replace(last_cycle, memory=all_flags_set)
    last_line = explained_in(replay, oscillates).lines[-1]
    assert last_line.endswith(
        "is barred after a change of direction, until the robot has moved by 0.05 m "
        "(oscillation_reset_dist) or turned by 0.2 rad (oscillation_reset_angle)."
    )


@pytest.mark.parametrize("term", [*(critic.term for critic in CRITICS), *SCALES])
def test_each_part_of_the_costs_has_a_sentence(term):
    values = {**start_values(JACKAL), **start_values(WAFFLE)}
    slow = (0.1, 0.0)
    cycle = replace(cycle_of(command=slow), settings=Settings({PLANNER: values}))
    velocities = [(0.5, 0.0), slow]
    outbid = explained(cycle, velocities, [2.0, 1.0], term).words
    refused = explained(cycle, velocities, [-1.0, 1.0], term).words

    weight = f"{term.parameter} {values[term.parameter]:g}"
    assert outbid == f"every faster command {term.objection}, which costs too much at {weight}"
    if term.refusal:
        assert refused == f"every faster command {term.refusal.format(**values)}"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        # At 0.4 rad/s, a cycle of 0.05 s turns by 0.02 rad: past 0.008 rad on both sides.
        (
            {"yaw_goal_tolerance": 0.008},
            "yaw_goal_tolerance 0.008 is smaller than the turn of one cycle at min_vel_theta 0.4",
        ),
        # Within 0.012 rad on both sides, one cycle ends.
        (
            {"yaw_goal_tolerance": 0.012},
            "it does not come within xy_goal_tolerance 0.1 and yaw_goal_tolerance 0.012 of the "
            "goal at once",
        ),
        # TrajectoryPlannerROS turns on the spot by a parameter of its own.
        (
            {"yaw_goal_tolerance": 0.02, "min_vel_theta": -0.4, "min_in_place_vel_theta": 1.0},
            "yaw_goal_tolerance 0.02 is smaller than the turn of one cycle "
            "at min_in_place_vel_theta 1",
        ),
    ],
)
def test_a_robot_that_does_not_end_its_goal_has_a_tolerance_that_it_cannot_meet(values, words):
    read_once = {"xy_goal_tolerance": 0.1, "yaw_goal_tolerance": 0.5, "min_vel_theta": 0.4}
    planner = SimpleNamespace(name=PLANNER, period=0.05, start_values=read_once)
    assert at_goal(planner, {PLANNER: values}) == words


def test_a_wait_at_the_goal_is_explained_by_the_tolerances_and_another_event_is_not(sound):
    waits = Event(AT_GOAL, 5.0, 5.5, (0.0, 0.0))
    creeps = Event("crept", 5.0, 5.5, (0.0, 0.0))
    for event in (waits, creeps):
        explain_event(sound, event)
    assert waits.reason.startswith("it does not come within xy_goal_tolerance 0.25 and ")
    assert "tolerance" not in creeps.reason


def test_the_slow_cycles_of_an_event_stand_for_it(monkeypatch):
    def explain_speed(cycle):
        return Explanation(cycle.at, cycle.pose, words=f"{cycle.command[0]} m/s were wanted")

    monkeypatch.setattr(diagnosis, "explain", explain_speed)
    monkeypatch.setattr(Replay, "at", lambda replay, cycle: cycle)
    # Every other command is fast.
    cycles = []
    for row in range(60):
        command = (0.1 if row % 2 else 0.5, 0.8)
        cycles.append(replace(cycle_of(command, at=row / 20), error=0.0))
    # The drive itself has no reason that is seen from outside the planner.
    recording = SimpleNamespace(drive=drive_of(DRIVES), robot=JACKAL)
    planner = SimpleNamespace(period=0.05)
    replay = Replay(recording, planner, history=None, cycles=cycles, left_out={})
    event = Event("swung from side to side", 0.0, 3.0, (0.0, 0.0))

    explain_event(replay, event)

    assert [cycle["words"] for cycle in event.cycles] == ["0.1 m/s were wanted"] * 5
    assert event.reason == "0.1 m/s were wanted"


@pytest.mark.parametrize(
    ("words", "row"),
    [
        # The plan leads back for a moment, in the middle of a wait before a gap.
        (["meets the obstacle 1 m off"] * 2 + ["back"] + ["meets the obstacle 2 m off"] * 2, 3),
        (["back", "back", "meets the obstacle 1 m off", "a", "b"], 1),
        # As many have each of them: the middle one counts.
        (["a", "b", "c"], 1),
        (["a", "a", "b", "c", "c"], 1),
    ],
)
def test_the_reason_that_most_cycles_have_stands_for_an_event(words, row):
    assert usual_row([{"words": entry} for entry in words]) == row


def test_a_place_beside_the_robot_is_said_in_positive_numbers():
    assert beside(0.5, 0.2) == "0.50 m ahead and 0.20 m to the left"
    assert beside(-0.5, -0.2) == "0.50 m behind and 0.20 m to the right"


def test_a_part_of_the_robot_in_the_scans_is_in_the_answer(with_part):
    diagnosed = diagnose(with_part)
    first_line = answer_of(diagnosed).first_line
    position = r"0.5 m ahead and 0.0 m to the (left|right) of its centre."
    assert re.search(rf", because the laser sees a part of the robot, {position}", first_line)
    # Nothing about the planner is guessed from scans that show the robot itself.
    assert guesses_of(diagnosed) == []
