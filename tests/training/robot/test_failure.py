"""Tests of the reasons why simulated drives on open floor failed."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.drives.drive import (
    ABORTED,
    REACHED,
    TIMED_OUT,
    Goal,
    Plans,
    Refusals,
    Verdicts,
)
from applr_ros1.drives.end_reasons import ODOMETRY_ARRIVED
from applr_ros1.monitor.monitor import REVERSING
from tests.support.measured_drives import stopped_drive
from training.robot.failure import STANDS, failure_of


@pytest.fixture
def stopped():
    """Return a drive that stands from 3 to 6 s, although 0.5 m/s are commanded."""
    return stopped_drive()


def failed(drive, status=TIMED_OUT, reason="time limit", **columns):
    """Return in words why a drive failed whose goal ended like this, with these other columns."""
    goal = Goal("one", begin=0.0, end=9.0, status=status, reason=reason)
    return failure_of(replace(drive, goals=[goal], **columns))


def test_a_drive_that_arrives_has_not_failed_unless_it_touches_something(stopped):
    assert failed(stopped, REACHED) == ""
    assert failed(stopped, REACHED, contacts=np.array([4.0])) == "it touches something"


def test_failures_are_worded_by_their_causes_first(stopped):
    times = stopped.planned.time
    late = failed(stopped)
    assert late.startswith(f"{STANDS}, and has not arrived after 9 s")
    aborted = failed(stopped, ABORTED, "move_base gave up: no way")
    assert aborted == "move_base gave up: no way"

    # 30 of 180 cycles are 17 %. 10 of them are 6 %, less than the tenth that counts as a reason.
    rejecting_cycle = {
        "samples": 90,
        "obstacle": 80,
        "path": 1,
    }
    many_refusals = Refusals(times, [rejecting_cycle] * 30 + [{}] * 150)
    rejects = "the planner rejects every velocity in 17 % of its cycles, mostly because of the "
    rejects += "critic obstacle"
    assert failed(stopped, refusals=many_refusals) == rejects
    few_refusals = Refusals(times, [{}] * 170 + [rejecting_cycle] * 10)
    assert failed(stopped, refusals=few_refusals).startswith(STANDS)

    # In the last three of nine seconds
    verdicts = Verdicts(
        times,
        action=["pass"] * 120 + ["stop"] * 60,
        reason=["a wall"] * 180,
    )
    blocks = "the collision monitor blocks 33 % of the commanded motion: a wall"
    assert failed(stopped, verdicts=verdicts) == blocks
    # A reversal that the monitor delays counts, too.
    delays = replace(verdicts, reason=[REVERSING] * 180, action=["brake"] * 180)
    delayed = failed(stopped, verdicts=delays)
    assert delayed == f"the collision monitor blocks 100 % of the commanded motion: {REVERSING}"
    # What the planner rejects never reaches the monitor.
    both = failed(stopped, verdicts=verdicts, refusals=many_refusals)
    assert both.startswith("the planner rejects")

    # The wheels turn three times as far as the robot moves.
    far_odometry = replace(stopped.odometry, pose=3.0 * stopped.odometry.pose)
    assert failed(stopped, odometry=far_odometry) == "its wheels slip by 6.0 m over 8.9 m"

    # A robot whose odometry arrived was not kept from driving. It begins 25 mm from the origin.
    short_motion = replace(stopped.truth, pose=0.8 * stopped.truth.pose)
    arrived = failed(stopped, ABORTED, ODOMETRY_ARRIVED, truth=short_motion, refusals=many_refusals)
    assert arrived == f"{ODOMETRY_ARRIVED}: its wheels slipped by 0.59 m over 3.0 m"

    # A missing path and a contact are named before the planner's refusals.
    no_routes = Plans(np.empty(0), [])
    lost = failed(stopped, routes=no_routes, plans=None, planned=None, refusals=many_refusals)
    assert lost == "the global planner finds no path"
    touches = failed(stopped, contacts=np.array([1.0]), refusals=many_refusals)
    assert touches.startswith("it touches something, and the planner")
