"""Events and reasons that are seen from outside the local planner, and so of every one."""

from __future__ import annotations

from dataclasses import replace
from typing import Mapping, Optional

import numpy as np

from applr_ros1.drives.drive import Drive, Motion
from applr_ros1.drives.names import topics_of
from applr_ros1.robots import Robot
from applr_ros1.why import events
from applr_ros1.why.black_box.description import DescribedRobot
from applr_ros1.why.costmap_sources import sources_in
from applr_ros1.why.diagnosis import Diagnosis, find_stop, give_outside_reason
from applr_ros1.why.fitting import with_velocities
from applr_ros1.why.limits import REPLAYED, limits_of, planner_of, start_values
from applr_ros1.why.reasons import DRIVES_SPEED

# Why a drive is not replayed
OTHER_PLANNER = f"the planner's own reasons are known for {' and '.join(REPLAYED)} only"
SIDEWAYS = "commands to drive sideways are not replayed"
NO_PLAN = "without a plan there is nothing to replay"
NO_SCAN = "without a laser scan the planner is not replayed"
NO_LASER = "the local costmap has no laser, so the planner is not replayed"


def unknown_to_replay(drive: Drive, robot: Robot, types: Mapping[str, str]) -> str:
    """Return why a drive is not replayed, whatever its bag has, or "".

    Args:
        drive: The drive.
        robot: Robot that drove.
        types: {topic: type} of all topics that were recorded.
    """
    if planner_of(drive, robot) not in REPLAYED:
        return OTHER_PLANNER
    # A base that ignores them slips sideways in its turns at most, of which no planner is told.
    if drive.planned is not None and (np.abs(drive.planned.sideways) >= DRIVES_SPEED).any():
        return SIDEWAYS
    # Scans on another topic are an option, which whoever asks may give.
    if not drive.scans and not topics_of("scans", types):
        return NO_SCAN
    if not sources_in(robot).lasers:
        return NO_LASER
    return ""


def seen_from_outside(
    drive: Drive,
    odometry: Motion,
    robot: Robot,
    note: str = "",
    box: Optional[DescribedRobot] = None,
) -> Diagnosis:
    """Return what is known of a drive without a replay, so that it is known of every planner.

    Args:
        drive: The drive.
        odometry: Its odometry.
        robot: Robot that drove.
        note: Why it is not replayed.
        box: Description of a black box's bag, or None.
    """
    motion = with_velocities(odometry).motion
    drive = replace(drive, odometry=motion)
    limits = limits_of(drive, motion, robot, start_values(robot))
    found_events = events.find(drive, motion, limits)
    asked = find_stop(found_events, drive, box)
    for event in found_events:
        give_outside_reason(event, drive, limits)
    top_speed = float(limits.speed.mean())
    return Diagnosis(drive, robot, motion, top_speed, found_events, asked=asked, note=note)
