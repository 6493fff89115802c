"""Words for a goal that move_base ended before the robot had arrived.

move_base knows the place of a robot by its odometry. In simulation the true place is known, too.
"""

import math
from typing import NamedTuple, Tuple

from applr_ros1.common.angles import compose, inverse
from applr_ros1.drives.drive import Drive, Motion

ODOMETRY_ARRIVED = "the odometry arrived, the robot did not"
TOO_EARLY = "move_base reported the goal as reached before the robot was there"


class MeasuredSlip(NamedTuple):
    """Columns of a drive whose motion is known by odometry and in truth."""

    odometry: Motion
    truth: Motion


def ended_early(
    has_succeeded: bool, text: str, left_by_odometry: float, left_in_truth: float, tolerance: float
) -> str:
    """Return in words why a goal ended, without figures, so that drives with one reason count.

    Args:
        has_succeeded: Whether move_base reported the goal as reached.
        text: What move_base said of it.
        left_by_odometry: Distance from the goal by the odometry [m].
        left_in_truth: True distance from the goal [m].
        tolerance: Goal tolerance of the planner [m].
    """
    if not has_succeeded:
        return f"move_base gave up: {text}"
    if left_by_odometry <= tolerance < left_in_truth:
        return ODOMETRY_ARRIVED
    return TOO_EARLY


def in_full(drive: Drive) -> str:
    """Return why the last goal of a drive ended, with the slip if the odometry alone arrived.

    Raises:
        DriveError: The odometry arrived, but was not recorded.
    """
    reason = drive.goals[-1].reason
    if reason != ODOMETRY_ARRIVED:
        return reason
    odometry, truth = drive.require(MeasuredSlip)
    slip = wheel_slip(odometry, truth)
    return f"{reason}: its wheels slipped by {slip:.2f} m over {odometry.length:.1f} m"


def wheel_slip(odometry: Motion, truth: Motion) -> float:
    """Return how far a simulated robot is from where its odometry takes it to be [m].

    The true motion is known here. On a robot the scans tell (monitor/scan_matching.py).
    """
    return math.dist(_displacement(odometry), _displacement(truth))


def _displacement(motion: Motion) -> Tuple[float, float]:
    """Return the last position (x, y) [m] in the frame of the first pose."""
    first_x, first_y, first_yaw = motion.pose[0].tolist()
    last_x, last_y, last_yaw = motion.pose[-1].tolist()
    x, y, _ = compose(inverse((first_x, first_y, first_yaw)), (last_x, last_y, last_yaw))
    return x, y
