"""Reasons why a simulated drive on open floor failed, read from its columns."""

from __future__ import annotations

from collections import Counter

from applr_ros1.drives.drive import ABORTED, REACHED, Drive, DrivenToGoal
from applr_ros1.drives.end_reasons import ODOMETRY_ARRIVED, in_full, wheel_slip
from applr_ros1.planner.dwa.planner import VELOCITY_LIMITS
from applr_ros1.why.reasons import blocked, no_plan
from applr_ros1.why.stretch import Stretch, first_of

STANDS = "it turns or stands"  # beginning of the reason if no column shows another one
DRIVE_SHARE = 0.1  # share of a drive from which on an observation is the reason of its failure
SLIP_SHARE = 0.5  # share of the odometry's way from which on wheels slip


def failure_of(drive: Drive) -> str:
    """Return in words why the last goal of a drive was not reached without a contact.

    The result is "" if it was. The drive needs goals, truth, routes, refusals and commands.
    """
    goal = drive.require(DrivenToGoal).goals[-1]
    touches = "it touches something" if len(drive.contacts) else ""
    if goal.status == REACHED:
        return touches
    stretch = Stretch(drive, goal.begin, goal.end, DRIVE_SHARE)
    reason = ""
    # A planner that has arrived by its odometry was not kept from driving.
    if goal.reason != ODOMETRY_ARRIVED:
        reason = first_of((no_plan, refused, blocked, slipping), stretch)
    if not reason and goal.status == ABORTED:
        reason = in_full(drive)
    if not reason:
        reason = f"{STANDS}, and has not arrived after {stretch.seconds:.0f} s"
    if touches:
        return f"{touches}, and {reason}"
    return reason


def refused(stretch: Stretch) -> str:
    """Return that the local planner rejected every velocity, and by which critic, or ""."""
    cycles = stretch.part(stretch.drive.refusals)
    if cycles is None:
        return ""
    # Of cycles with a valid velocity, no critics are recorded.
    rejecting = [critics for critics in cycles.critics if critics]
    share = len(rejecting) / len(cycles)
    if share <= stretch.share:
        return ""
    rejected: Counter[str] = Counter()
    for critics in rejecting:
        rejected.update(critics)
    del rejected["samples"]  # It counts the velocities themselves.
    critic = rejected.most_common(1)[0][0]
    cause = f"the critic {critic}"
    if critic == VELOCITY_LIMITS:
        cause = "its velocity limits (min_vel_trans, min_vel_theta, max_vel_trans)"
    return (
        f"the planner rejects every velocity in {100 * share:.0f} % of its cycles, "
        f"mostly because of {cause}"
    )


def slipping(stretch: Stretch) -> str:
    """Return that the wheels turned without moving the robot, or ""."""
    odometry = stretch.part(stretch.drive.odometry)
    truth = stretch.part(stretch.drive.truth)
    if odometry is None or truth is None:
        return ""
    slip = wheel_slip(odometry, truth)
    if slip <= SLIP_SHARE * odometry.length:
        return ""
    return f"its wheels slip by {slip:.1f} m over {odometry.length:.1f} m"
