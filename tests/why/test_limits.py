"""Tests of the limits by which a drive is measured, whichever local planner drove."""

from dataclasses import replace

import pytest

from applr_ros1.robots import JACKAL
from applr_ros1.why.limits import limits_of, planner_of, start_values
from tests.support.measured_drives import drive_of
from tests.support.replays import PLANNER, updates

TEB = "TebLocalPlannerROS"
# Two seconds back at 0.3 m/s, and one second ahead at 0.2 m/s
MEASURED = [(-0.3, 0.0)] * 40 + [(0.2, 0.0)] * 20


def limits(*changes, planner=TEB):
    """Return the limits of a drive of the Jackal by a planner, after changes of parameters."""
    drive = replace(drive_of(MEASURED), planners=[planner])
    if changes:
        drive = replace(drive, changes=updates(*changes))
    return limits_of(drive, drive.odometry, JACKAL, start_values(JACKAL))


@pytest.mark.parametrize(
    ("planners", "planner"),
    [
        ([], PLANNER),
        (["DWAPlannerROS", PLANNER, TEB], PLANNER),
        ([TEB], TEB),
        (["AnotherPlannerROS", "DWAPlannerROS", TEB], "DWAPlannerROS"),
        (["AnotherPlannerROS", TEB], "AnotherPlannerROS"),
    ],
)
def test_the_robots_planner_drove_if_it_has_shown_plans_else_one_that_is_replayed(
    planners, planner
):
    drive = replace(drive_of(MEASURED), planners=planners)
    assert planner_of(drive, JACKAL) == planner


def test_without_limits_of_its_planner_a_drive_is_measured_by_its_fastest_speed():
    by_its_files = limits(planner=PLANNER)
    assert (by_its_files.speed == 0.5).all()
    assert (by_its_files.turn == 1.57).all()
    assert by_its_files.period_at(0.0) == 0.05
    # The values in the Jackal's files are those of another planner.
    unknown = limits()
    assert (unknown.speed == 0.3).all()
    assert (unknown.turn == 1.0).all()
    assert unknown.period_at(0.0) == 0.0


def test_limits_hold_from_their_change_on_under_any_of_their_names():
    # The Jackal's own planner does not drive. A limit of 0 is none.
    first = (1.0, TEB, {"max_vel_x": 0.0, "max_vel_trans": 0.4, "max_rot_vel": 0.8})
    of_another = (1.5, PLANNER, {"max_vel_x": 0.9})
    tolerances = {"xy_goal_tolerance": 0.1, "yaw_goal_tolerance": 0.3}
    second = (2.0, TEB, {"max_vel_x": 0.6, **tolerances})
    changed = limits(first, of_another, second)
    assert changed.speed[[0, 19, 20, 39, 40, 59]].tolist() == [0.3, 0.3, 0.4, 0.4, 0.6, 0.6]
    assert changed.turn[[0, 19, 20, 59]].tolist() == [1.0, 1.0, 0.8, 0.8]
    assert (changed.tolerance, changed.yaw_tolerance) == (0.1, 0.3)
