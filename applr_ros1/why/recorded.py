"""Recording of a drive that was received as messages, in a bag or on the robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Mapping, Optional

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Commands, Drive, with_full_speed
from applr_ros1.drives.names import missing, missing_plans
from applr_ros1.robots import Robot
from applr_ros1.why.fitting import GIVE_ROBOT, fitted
from applr_ros1.why.limits import planner_of
from applr_ros1.why.recording import Recording
from applr_ros1.why.rerun import RerunPlanner

CHANNELS = (
    "scans",
    "odometry",
    "transforms",
    "commands",
    "planned",
    "verdicts",
    "changes",
    "plans",
    "routes",
    "recoveries",
    "decisions",
    "goals",
    "sent",
)
# Parameter of TebLocalPlannerROS with which angular.z of its commands is a steering angle
COMMANDS_ANGLE = "cmd_angle_instead_rotvel"


def with_planned(drive: Drive, robot: Robot) -> Drive:
    """Return a drive with the planner's commands: without a monitor, they reach the base.

    Their v is the speed to all sides, and their w a turn rate.
    """
    commands = drive.commands and _as_motion(drive.commands, drive, robot)
    planned = drive.planned and _as_motion(drive.planned, drive, robot)
    return replace(drive, commands=commands, planned=planned or commands)


def _as_motion(commands: Commands, drive: Drive, robot: Robot) -> Commands:
    """Return commands as the motion that they ask for."""
    start_values = robot.parameters().get(planner_of(drive, robot)) or {}
    has_angles = bool(start_values.get(COMMANDS_ANGLE))
    for values in drive.changes.values if drive.changes is not None else ():
        has_angles = bool(values.get(COMMANDS_ANGLE, has_angles))
    if has_angles:
        # A steering angle turns nothing by itself.
        commands = replace(commands, twist=commands.twist * (1.0, 0.0))
    return with_full_speed(commands)


def recording_from(
    drive: Drive,
    names: TopicNames,
    types: Mapping[str, str],
    planner: Optional[RerunPlanner],
    robot: Robot,
) -> Recording:
    """Return a drive with columns that fit on each other.

    Args:
        drive: The drive with its CHANNELS, and with_planned.
        names: Names of its topics.
        types: {topic: type} of all topics that were recorded.
        planner: Planner of the robot, which cuts the global planner's plans; None if it is not
            replayed.
        robot: Robot that drove.

    Raises:
        ApplrError: The drive lacks odometry, scans, commands or plans, another robot or planner
            drove, or the frames of its messages do not fit.
    """
    drove = planner_of(drive, robot)
    if planner is None or drove != robot.local_planner:
        has = f"{robot.name} has {robot.local_planner}"
        raise ApplrError(f"{drove} drove, {has}: {GIVE_ROBOT}")
    _check_columns(drive, robot, names, types)
    return fitted(drive, planner, robot)


def _check_columns(drive: Drive, robot: Robot, names: TopicNames, types: Mapping[str, str]) -> None:
    """Raise ApplrError if a column is missing that the replay needs."""
    channels = {"odometry": "odometry", "scans": "scans", "planned": "commands"}
    for column, channel in channels.items():
        if not getattr(drive, column):
            raise ApplrError(missing(channel, names, types))
    if not drive.plans and not drive.routes:
        raise ApplrError(missing_plans(robot.local_planner, names, types))
