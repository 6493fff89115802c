"""Tests of the words for a goal that move_base ended before the robot had arrived."""

import numpy as np
import pytest

from applr_ros1.drives.drive import ABORTED, Drive, DriveError, Goal, Motion
from applr_ros1.drives.end_reasons import ODOMETRY_ARRIVED, TOO_EARLY, ended_early, in_full


@pytest.mark.parametrize(
    ("has_succeeded", "left_by_odometry", "left_in_truth", "words"),
    [
        (True, 0.2, 0.8, ODOMETRY_ARRIVED),
        # With an occupied goal, the planner stops before it.
        (True, 0.6, 0.6, TOO_EARLY),
        # The course may ask for more than the planner's tolerance.
        (True, 0.2, 0.2, TOO_EARLY),
        (False, 0.2, 0.8, "move_base gave up: no way"),
    ],
)
def test_an_early_end_is_told_by_both_distances(
    has_succeeded, left_by_odometry, left_in_truth, words
):
    text = "Goal reached." if has_succeeded else "no way"
    assert ended_early(has_succeeded, text, left_by_odometry, left_in_truth, 0.25) == words


def motion(*poses):
    """Return a motion through some poses."""
    times = np.arange(len(poses), dtype=float)
    return Motion(times, times, np.array(poses, float), np.zeros((len(poses), 2)))


def test_wheels_slip_by_the_distance_between_odometry_and_truth():
    """Both begin at the same place, which the world and the odometry call by other poses."""
    drive = Drive(
        odometry=motion((0, 0, 0), (2, 0, 0), (2, 3, 0)),
        truth=motion((5, 5, np.pi / 2), (5, 6.8, 1.5), (2.4, 6.9, 1.5)),
        goals=[Goal("one", 0.0, 2.0, ABORTED, ODOMETRY_ARRIVED)],
    )
    # To the world, the odometry's end (2, 3) lies at (5 - 3, 5 + 2), 0.41 m from the true one.
    assert in_full(drive) == f"{ODOMETRY_ARRIVED}: its wheels slipped by 0.41 m over 5.0 m"
    drive.odometry = None
    with pytest.raises(DriveError):
        in_full(drive)


def test_other_reasons_stay_as_they_are():
    assert in_full(Drive(goals=[Goal("one", 0.0, 2.0, ABORTED, TOO_EARLY)])) == TOO_EARLY
