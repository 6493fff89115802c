"""Reads the recorded drive of a bag for the replay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Mapping

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Drive
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from applr_ros1.robots import Robot
from applr_ros1.why.fitting import fitted, other_robot
from applr_ros1.why.recording import Recording
from applr_ros1.why.rerun import RerunPlanner
from training.bags.names import missing, missing_plans, names_in
from training.bags.options import BagOptions
from training.bags.read import opened
from training.common.options import option

CHANNELS = (
    "scans",
    "odometry",
    "transforms",
    "commands",
    "planned",
    "changes",
    "plans",
    "routes",
    "recoveries",
    "decisions",
    "goals",
    "sent",
)


class RecordedOptions(BagOptions):
    """Options of a recorded drive."""

    move_base: str = option("", "Namespace of move_base in the bag. Default: that of its plans.")


def recording_of(path: Path, options: RecordedOptions, planner: RerunPlanner) -> Recording:
    """Read the drive in a bag, with columns that fit on each other.

    Args:
        path: The bag.
        options: Robot and names of topics.
        planner: Planner of the robot, which cuts the global planner's plans.

    Raises:
        BagError: The bag cannot be read, lacks odometry, scans, commands or plans, another robot or
            planner drove, or the frames of its messages do not fit.
    """
    robot = options.robot
    # Who gave the robot is not asked to give it.
    is_given = "robot" in options.model_fields_set
    with opened(path) as bag:
        # Topics that are options are not looked for.
        names = names_in(bag.types, options.topics(), options.given_topics())
        drive = bag.drive(robot, names, CHANNELS)
        if drive.planned is None:  # Without a monitor, the planner's commands reach the base.
            drive = replace(drive, planned=drive.commands)
        _check_planner(drive, robot, is_given)
        _check_columns(drive, robot, names, bag.types)
        return fitted(drive, planner, robot, is_given)


def _check_planner(drive: Drive, robot: Robot, is_given: bool) -> None:
    """Raise ApplrError if another local planner drove."""
    if not drive.planners:
        return
    # A robot with a planner that nothing here replays need not be given.
    replayed_planners = list(map(namespace, LOCAL_PLANNERS))
    known_planners = [planner for planner in drive.planners if planner in replayed_planners]
    if not known_planners:
        drives_in_words = f"only drives of {' and '.join(replayed_planners)} are replayed"
        raise ApplrError(f"{drive.planners[0]} drove: {drives_in_words}")
    if robot.local_planner not in known_planners:
        planners_in_words = f"{known_planners[0]} drove, {robot.name} has {robot.local_planner}"
        raise other_robot(planners_in_words, "its base_local_planner is another", is_given)


def _check_columns(drive: Drive, robot: Robot, names: TopicNames, types: Mapping[str, str]) -> None:
    """Raise ApplrError if a column is missing that the replay needs."""
    channels = {"odometry": "odometry", "scans": "scans", "planned": "commands"}
    for column, channel in channels.items():
        if not getattr(drive, column):
            raise ApplrError(missing(channel, names, types))
    if not drive.plans and not drive.routes:
        raise ApplrError(missing_plans(robot.local_planner, names, types))
