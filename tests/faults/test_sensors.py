"""Tests of failing scan, odometry, tf and clock: the robot stops, reports the reason, and drives on
afterwards.
"""

import math

import pytest
import rospy

from tests.support.nodes import ABORTED, SUCCEEDED, finish
from tests.support.ros import wait_for

pytestmark = pytest.mark.ros


def beams(change):
    """Return a fault that replaces the ranges (720,) [m] by change(ranges)."""

    def fault(scan):
        scan.ranges = change(list(scan.ranges))
        return scan

    return fault


def all_nan(ranges):
    """Return as many ranges, none of which is a number."""
    return [math.nan] * len(ranges)


def some_invalid(ranges):
    """Return ranges of which the first 30 are no distances."""
    return [math.nan, math.inf, -math.inf, 0.0, 1e30, -1.0] * 5 + ranges[30:]


def stamped(seconds):
    """Return a fault that moves the stamps by some seconds."""

    def fault(message):
        message.header.stamp += rospy.Duration.from_sec(seconds)
        return message

    return fault


def renamed(scan):
    """Give a scan a frame that tf does not know."""
    scan.header.frame_id = "front_lazer"
    return scan


def silent(message):
    """Drop a message: return nothing to pass on."""


@pytest.mark.parametrize(
    ("stream", "fault", "problem"),
    [
        # tests/nodes/test_conversions.py has further unusable scans.
        pytest.param(
            "scan", silent, "no usable scan on /front/scan", marks=pytest.mark.fault("10")
        ),
        pytest.param("scan", beams(all_nan), "is all NaN", marks=pytest.mark.fault("11")),
        pytest.param("scan", stamped(-5.0), "no usable scan", marks=pytest.mark.fault("12")),
        pytest.param("scan", stamped(5.0), "no usable scan", marks=pytest.mark.fault("12")),
        pytest.param("scan", renamed, "front_lazer", marks=pytest.mark.fault("12")),
        pytest.param("tf", silent, "transform odom <- base_link is", marks=pytest.mark.fault("12")),
        pytest.param("clock", silent, "/clock has not moved", marks=pytest.mark.fault("13")),
    ],
    ids=[
        "no scan",
        "all NaN",
        "old scans",
        "scans ahead",
        "unknown frame",
        "no transform",
        "stopped clock",
    ],
)
def test_the_robot_stops_reports_the_reason_and_goes_on(stack, measured, stream, fault, problem):
    stack.under_way()
    earlier_output = len(stack.output("move_base"))
    earlier_actions = len(stack.actions)

    def break_it():
        stack.relay.faults[stream] = fault

    # Without a clock nobody brakes: the bridge stops the base as one without commands.
    measured("stands after", stack.stands_after(break_it, locks=stream == "clock"), "s")
    wait_for(lambda: problem in stack.output("move_base")[earlier_output:], problem)
    # The monitor alone would stop the base, too: move_base must not rely on it.
    wait_for(
        lambda: stack.relay.planned[-1].velocity == (0.0, 0.0),
        "zero velocity from move_base itself",
    )
    # The monitor needs the transform as well, and gives the same reason.
    if stream == "tf":
        new_actions = stack.actions[earlier_actions:]
        assert any("transform odom <- base_link" in action for action in new_actions)
    stack.relay.clear_faults()
    stack.drives_again()


@pytest.mark.fault("11")
def test_single_invalid_beams_do_not_stop_the_robot(stack):
    stack.under_way()
    stack.relay.faults["scan"] = beams(some_invalid)
    earlier_decisions = len(stack.decisions)
    broken_at = stack.relay.now

    def has_decided():
        # Longer than a decision period, so that a decision sees only scans with such beams.
        is_long_ago = stack.relay.now > broken_at + 1.2
        return is_long_ago and len(stack.decisions) > earlier_decisions

    wait_for(has_decided, "decisions")
    stack.drives_again()
    # One NaN in an observation would make the whole action NaN.
    assert all(map(math.isfinite, stack.decisions[-1]["theta"].values()))


@pytest.mark.fault("12a")
def test_a_transform_stamped_far_ahead_stops_the_robot_only_briefly(stack, measured):
    """A message stamped 1000 s ahead is ignored, with a line in the log."""
    stack.under_way()

    def ahead(message):
        """Shift the transforms of one message by 1000 s, and leave later ones alone."""
        for transform in message.transforms:
            transform.header.stamp += rospy.Duration(1000.0)
        stack.relay.clear_faults()
        return message

    # tf's buffer would reject all transforms older than this one.
    broken_at = stack.relay.now
    stack.relay.faults["tf"] = ahead
    wait_for(lambda: stack.relay.now > broken_at + 1.0, "time")
    stack.drives_again()
    duration = stack.relay.now - broken_at
    measured("drives again within", duration, "s")
    assert duration < 15.0
    # The clock of the node may be a cycle before or behind that of the message.
    problem = "ignored: it is stamped"
    wait_for(lambda: problem in stack.output("move_base"), "a line about the transform")
    assert "TF_OLD_DATA" not in stack.output("move_base")


@pytest.mark.fault("10a")
def test_the_robot_stops_without_odometry(stack, measured):
    """Transforms are still published, but the velocity is no longer measured."""
    stack.under_way()

    def break_it():
        stack.relay.faults["odometry"] = silent

    measured("stands after", stack.stands_after(break_it), "s")
    problem = "no usable odometry on /odometry/filtered"
    assert any(problem in action for action in stack.actions)
    stack.relay.clear_faults()
    stack.drives_again()


@pytest.mark.fault("13")
def test_a_clock_jump_back_stops_the_robot_and_aborts_the_goal(stack, measured):
    stack.under_way()
    earlier_decisions = len(stack.decisions)

    def set_clock_back():
        stack.relay.shift -= 50.0

    measured("stands after", stack.stands_after(set_clock_back), "s")
    assert finish(stack.client) == (ABORTED, "Aborting because the clock jumped back.")
    wait_for(lambda: "jumped back" in stack.output("applr"), "the applr node's line")
    # All nodes live on with the earlier time: a goal is driven, and the policy decides.
    stack.back_to_the_start()
    stack.send(1.5)
    assert finish(stack.client).state == SUCCEEDED
    assert len(stack.decisions) > earlier_decisions
