"""Scan, odometry, tf and clock fail while the robot drives: it stands, says why, and goes on when they are back."""

import math

import numpy as np
import pytest
import rospy

from tests.support.move_base_stack import ABORTED, SUCCEEDED, finish
from tests.support.ros_harness import wait_for

pytestmark = pytest.mark.ros


def stands_and_goes_on(stack, stream, fault, words, within=2.0):
    """Breaks a stream; the robot stands, move_base says why, and it drives again. Returns the time until it stands."""
    stack.under_way()
    said = len(stack.said("move_base"))
    took = stack.stands_after(lambda: stack.relay.bend.__setitem__(stream, fault), within)
    wait_for(lambda: words in stack.said("move_base")[said:], words)
    wait_for(lambda: stack.relay.planned[-1][1:] == (0.0, 0.0), "zero velocity from move_base itself")
    stack.relay.mend()
    stack.drives_again()
    return took


@pytest.mark.fault("10")
def test_no_scan(stack, measured):
    took = stands_and_goes_on(stack, "scan", lambda scan: None, "no usable scan on /front/scan")
    measured("stands after", took, "s")


def beams(change):
    def bend(scan):
        scan.ranges = change(list(scan.ranges))
        return scan

    return bend


@pytest.mark.fault("11")
def test_scans_that_cannot_be_used(stack, measured):
    """tests/nodes/test_conversions.py has which these are."""
    fault = beams(lambda ranges: [math.nan] * 720)
    measured("stands after", stands_and_goes_on(stack, "scan", fault, "is all NaN"), "s")


@pytest.mark.fault("11")
def test_odd_beams_are_ordinary(stack):
    stack.under_way()
    stack.relay.bend["scan"] = beams(lambda r: [math.nan, math.inf, -math.inf, 0.0, 1e30, -1.0] * 5 + r[30:])
    count, since = len(stack.decisions), stack.relay.now
    wait_for(lambda: stack.relay.now > since + 1.2 and len(stack.decisions) > count, "decisions")
    stack.drives_again()
    assert all(math.isfinite(value) for value in stack.decisions[-1]["theta"].values())


@pytest.mark.fault("11a")
def test_another_scanner_is_taken(stack, measured):
    """It comes up late, with another number of beams than the one before: a complete scan counts by itself."""
    stack.under_way()
    since = stack.relay.now
    stack.relay.bend["scan"] = beams(lambda ranges: ranges[:400])
    stack.drives_again()
    measured("drives after", stack.relay.now - since, "s")
    stack.relay.mend()
    stack.drives_again()  # the right one is another one, too


def stamped(seconds):
    def bend(message):
        message.header.stamp += rospy.Duration.from_sec(seconds)
        return message

    return bend


@pytest.mark.fault("12")
@pytest.mark.parametrize("seconds", [-5.0, 5.0], ids=["old", "ahead"])
def test_stamps_of_scans_that_are_old_or_ahead(stack, measured, seconds):
    measured("stands after", stands_and_goes_on(stack, "scan", stamped(seconds), "no usable scan"), "s")


@pytest.mark.fault("12")
def test_scans_out_of_order_change_nothing(stack):
    stack.under_way()
    held = []

    def swap(scan):
        held.append(scan)
        return held.pop(0) if len(held) > 2 and len(held) % 2 else (held.pop() if len(held) > 1 else None)

    stack.relay.bend["scan"] = swap
    since, speeds = stack.relay.now, []
    wait_for(lambda: speeds.append(stack.relay.speed) or stack.relay.now > since + 1.0, "time")
    assert np.median(speeds) > 0.3


@pytest.mark.fault("12")
def test_no_transform(stack, measured):
    took = stands_and_goes_on(stack, "tf", lambda tf: None, "transform odom <- base_link is")
    assert any("transform odom <- base_link" in action for action in stack.actions)
    measured("stands after", took, "s")


@pytest.mark.fault("12a")
def test_a_transform_far_ahead(stack, measured):
    """One message stamped half a minute ahead does not hold the robot up for half a minute."""
    stack.under_way()

    def ahead(message):
        for transform in message.transforms:
            transform.header.stamp += rospy.Duration(30.0)
        stack.relay.mend()
        return message

    since = stack.relay.now
    stack.relay.bend["tf"] = ahead
    wait_for(lambda: stack.relay.now > since + 1.0, "time")
    stack.drives_again()
    took = stack.relay.now - since
    measured("drives again within", took, "s")
    assert took < 15.0


@pytest.mark.fault("12")
def test_a_frame_that_nobody_knows(stack):
    def renamed(scan):
        scan.header.frame_id = "front_lazer"
        return scan

    stands_and_goes_on(stack, "scan", renamed, "front_lazer")


@pytest.mark.fault("10a")
def test_no_odometry(stack, measured):
    """The transforms are still there; the velocity is not measured any more."""
    stack.under_way()
    took = stack.stands_after(lambda: stack.relay.bend.__setitem__("odometry", lambda odometry: None))
    assert any("no usable odometry on /odometry/filtered" in action for action in stack.actions)
    measured("stands after", took, "s")
    stack.relay.mend()
    stack.drives_again()


@pytest.mark.fault("13")
def test_the_clock_stands_still(stack, measured):
    took = stands_and_goes_on(stack, "clock", lambda clock: None, "/clock has not moved")
    measured("stands after", took, "s")


@pytest.mark.fault("13")
def test_the_clock_jumps_back(stack, measured):
    stack.under_way()
    count = len(stack.decisions)
    took = stack.stands_after(lambda: setattr(stack.relay, "shift", stack.relay.shift - 50.0))
    assert finish(stack.client) == (ABORTED, "Aborting because the clock jumped back.")
    wait_for(lambda: "jumped back" in stack.said("applr"), "the applr node's line")
    stack.back_to_the_start()
    stack.send(1.5)
    assert finish(stack.client)[0] == SUCCEEDED
    assert len(stack.decisions) > count
    measured("stands after", took, "s")
