"""Tests of timing and outputs of the move_base node's control cycles, without a ROS master."""

import math
import threading
import time

import pytest
import rospy

from applr_ros1.common.angles import within_speed
from applr_ros1.nodes.move_base.control_loop import ControlLoop
from applr_ros1.nodes.move_base.reports import MoveBaseReports, off_the_map
from applr_ros1.planner.state_machine import Cycle
from tests.support.move_base_node import lone_node
from tests.support.scenes import laser_costmap

NOW = rospy.Time(100)


@pytest.mark.parametrize(
    ("command", "sent"),
    [
        ((2.0, 1.0), (0.4, 0.2)),
        ((-0.5, 0.0), (-0.4, 0.0)),
        ((-0.5, -0.5), (-0.4, -0.4)),
        ((0.3, 1.5), (0.3, 1.5)),
        ((0.0, 1.5), (0.0, 1.5)),
    ],
)
def test_max_speed_bounds_commands_ahead_and_back_and_keeps_their_arcs(command, sent):
    assert within_speed(command, 0.4) == pytest.approx(sent)
    assert within_speed(command, math.inf) == command


@pytest.mark.parametrize("pose", [None, (1.0, 2.0, 0.5)])
def test_feedback_has_the_pose_if_it_is_known(pose, monkeypatch):
    node, _ = lone_node(monkeypatch, robot="jackal")
    node.sensors.pose.return_value = pose
    node.cycle(NOW)
    feedback_positions = []
    for feedback_call in node.goals.publish_feedback.mock_calls:
        position = feedback_call.args[0].base_position.pose.position
        feedback_positions.append((position.x, position.y))
    assert feedback_positions == ([] if pose is None else [(1.0, 2.0)])


def test_refusals_of_the_first_blocked_cycle_are_kept_until_they_are_reported(monkeypatch):
    node, ros = lone_node(monkeypatch, robot="jackal")
    node.move_base.step.return_value = Cycle(controlled=True)
    node.move_base.local_planner.refusals.side_effect = [{}, {"samples": 3}, {"samples": 4}]
    # Four cycles, of which the second is followed by no report
    is_due = iter([True, False, True, True])
    monkeypatch.setattr(node.reports, "is_due", lambda now: next(is_due))
    for _ in range(4):
        node.cycle(NOW)
    problems = []
    for message in ros.published["/diagnostics"]:
        (status,) = message.status
        if status.name.endswith(": samples that critics refused"):
            values = {value.key: value.value for value in status.values}
            problems.append((status.message, values))
    line = "no legal command"
    assert problems == [("", {}), (line, {"samples": "3"}), (line, {"samples": "4"})]


def test_a_report_is_due_each_second():
    reports = MoveBaseReports(10.0)
    due = [now for now in (10.0, 10.5, 10.99, 11.0, 11.5, 12.5) if reports.is_due(now)]
    assert due == [10.0, 11.0, 12.5]


def test_diagnostics_count_the_skipped_cycles_since_the_start():
    reports = MoveBaseReports(0.0)
    told = []
    for skipped in (0, 26, 0, 3):
        *_, loop = reports.statuses({}, "", skipped, frequency=20.0)
        told.append((loop.problem, loop.values["skipped_cycles"]))
    line = "control loop missed its rate of 20 Hz: {} cycles skipped".format
    assert told == [("", 0), (line(26), 26), ("", 26), (line(3), 29)]


@pytest.mark.parametrize(
    ("silent_topics", "pose_trouble", "expected"),
    [
        ([], "", ""),
        (["/scan", "/odom"], "", "no message has arrived on /scan, /odom"),
        ([], "odom is unknown to tf", "odom is unknown to tf"),
        (["/scan"], "no tf", "no message has arrived on /scan; no tf"),
    ],
)
def test_missing_inputs_are_named_once_some_seconds_after_the_start(
    silent_topics, pose_trouble, expected
):
    reports = MoveBaseReports(100.0)
    named = [reports.missing_inputs(now, silent_topics, pose_trouble) for now in (104, 105, 106)]
    assert named == ["", expected, ""]


@pytest.mark.parametrize(("x", "is_warned_of"), [(3.0, False), (6.0, True)])
def test_a_goal_off_the_global_costmap_is_warned_of(x, is_warned_of):
    # A rolling costmap of 10 x 10 m around the robot
    costmap = laser_costmap(10.0, 10.0, 0.1, (-5.0, -5.0), rolling=True)
    warning = off_the_map(costmap, (x, 0.0, 0.0))
    expected = (
        "the goal is off the global costmap of 10 x 10 m: send a nearer goal, or enlarge the "
        "costmap"
    )
    assert warning == (expected if is_warned_of else "")


def test_diagnostics_report_odometry_that_contradicts_the_pose():
    inputs, *_ = MoveBaseReports(0.0).statuses({"scan": 0.1}, "its velocity is 0", 0, 20.0)
    assert (inputs.problem, inputs.values) == ("its velocity is 0", {"scan": 0.1})


def test_cycles_that_were_missed_are_counted():
    # When a cycle is due depends on none of its collaborators.
    loop = ControlLoop(*[None] * 5)
    due_time = rospy.Time.from_sec(100.0)
    # A cycle that is later than its period of 0.05 s begins a new phase, and the others are lost.
    for delay, missed_cycles, seconds_to_next in (
        (0.0, 0, 0.05),
        (0.04, 0, 0.05),
        (0.06, 1, 0.11),
        (0.46, 9, 0.51),
    ):
        loop.missed = 0
        cycle_time = due_time + rospy.Duration.from_sec(delay)
        next_due_time = loop.next_due(due_time, cycle_time, 0.05)
        assert loop.missed == missed_cycles
        assert (next_due_time - due_time).to_sec() == pytest.approx(seconds_to_next)


def test_cycles_wait_for_the_lock_and_go_on_after_one_that_failed(monkeypatch):
    cycles = []
    failures = []

    def cycle(*arguments):
        cycles.append(arguments)
        raise KeyError("three")

    node_has_ended = threading.Event()
    rospy.rostime.set_rostime_initialized(True)
    monkeypatch.setattr(rospy, "is_shutdown", node_has_ended.is_set)
    loop = ControlLoop(cycle, lambda: 200.0, went_back=None, stalled=None, failed=failures.append)
    loop_thread = threading.Thread(target=loop.run, daemon=True)
    with loop.lock:
        loop_thread.start()
        time.sleep(0.1)
        assert not cycles
    # A second failure shows that the loop went on after the first.
    while len(failures) < 2:
        time.sleep(0.001)
    node_has_ended.set()
    loop_thread.join(5.0)
    assert not loop_thread.is_alive()
