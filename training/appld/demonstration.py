"""Demonstrations: recorded drives with scans, motion and commands at the same instants.

APPLD (appld.py) reads demonstrations from bags. A bag is recorded while a person drives the robot,
or by demonstrate.py with the scripted demonstrator.
"""

from __future__ import annotations

import os
from typing import Any, Dict, NamedTuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import nearest_rows
from applr_ros1.drives.clocks import scans_apart
from applr_ros1.drives.columns import TopicNames, topic_of
from applr_ros1.drives.drive import Commands, Drive, Motion, Scans
from applr_ros1.policy.observation import layout_of
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.stack.simulated import CONTROL_PERIOD
from training.bags.read import BagError, opened

COLUMNS = ("scans", "odometry", "commands", "sent", "source")  # columns of a demonstration
DRIVING_SPEED = 0.02  # larger of |v| and |w| above which the robot is driving [m/s, rad/s]
HELD_S = 0.5  # duration for which a command remains valid [s]
NEAR_S = 0.1  # largest time between an instant and its odometry [s]
SHORTEST_S = 5.0  # minimum driving time of a demonstration [s]


class Commanded(NamedTuple):
    """Columns of a drive whose commands can be demonstrated."""

    scans: Scans
    odometry: Motion
    commands: Commands


class Demonstration(NamedTuple):
    """Recorded driving in rows at the same instants, about every 50 ms: one per control cycle.

    Attributes:
        name: Name of the drive for people.
        scans: Scan of each instant.
        odometry: Pose and velocity of each instant.
        commands: The demonstrator's command at each instant.
        goal_pose: Pose (x, y, yaw) [m, m, rad] to which the demonstrator drove, in the odometry's
            frame.
        source: Who drove, and where, as told by the recorder.
    """

    name: str
    scans: Scans
    odometry: Motion
    commands: Commands
    goal_pose: Pose
    source: Dict[str, Any]


def read_demonstration(
    path: os.PathLike[str] | str, topics: TopicNames = TopicNames(), robot: Robot = JACKAL
) -> Demonstration:
    """Read a demonstration from a ROS 1 or ROS 2 bag with scans, odometry and commands.

    It lasts from the first to the last command. Its goal is the last one that was sent in the
    odometry's frame, or its last pose.

    Raises:
        BagError: The bag cannot be read, lacks a topic or has too little driving.
    """
    with opened(path) as bag:
        drive = bag.drive(robot, topics, COLUMNS)
        for column in ("scans", "odometry", "commands"):
            rows = getattr(drive, column)
            if rows is None or len(rows) < 2:
                raise BagError(f"no {column} on {topic_of(column, topics)}")
        return instants(drive)


def instants(drive: Drive) -> Demonstration:
    """Return a drive with rows at the same instants, as read_demonstration does.

    Raises:
        BagError: Scans and odometry have different clocks, or there is too little driving.
        DriveError: The drive lacks scans, odometry or commands.
    """
    scans, motion, all_commands = drive.require(Commanded)
    apart = scans_apart(scans, motion)
    if apart:
        raise BagError(apart)
    # The instants are those of scans: odometry and commands are more frequent.
    scan_rows = _beats(scans.stamp)
    times = scans.stamp[scan_rows]
    motion_rows = nearest_rows(motion.stamp, times)
    is_located = np.abs(motion.stamp[motion_rows] - times) < NEAR_S
    # A policy gets no scan without a valid beam, either.
    ranges_of_instants = [scans.ranges[scan_row] for scan_row in scan_rows.tolist()]
    sees = [bool(np.nan_to_num(ranges, nan=0.0).any()) for ranges in ranges_of_instants]
    is_usable = is_located & np.array(sees)
    commands = _commands(all_commands, times)

    # The demonstration begins and ends with driving.
    has_motion = np.abs(commands).max(axis=1) > DRIVING_SPEED
    moving_rows = np.flatnonzero(has_motion & is_usable)
    driven_s = len(moving_rows) * CONTROL_PERIOD
    if driven_s < SHORTEST_S:
        raise BagError(
            f"{driven_s:.1f} s of driving are too little: record {SHORTEST_S:g} s or more"
        )
    chosen_rows = np.arange(moving_rows[0], moving_rows[-1] + 1)
    chosen_rows = chosen_rows[is_usable[chosen_rows]]

    elapsed_times = times[chosen_rows] - times[chosen_rows[0]]
    scan_rows = scan_rows[chosen_rows]
    ranges = [ranges_of_instants[row] for row in chosen_rows.tolist()]
    motion_rows = motion_rows[chosen_rows]
    poses = motion.pose[motion_rows]
    # Without a goal, the planner of the fit drives to where the demonstration ended.
    last_x, last_y, last_yaw = poses[-1].tolist()
    goal_pose = last_x, last_y, last_yaw
    for sent in drive.sent:
        if sent.frame == drive.frame:
            goal_pose = sent.pose
    return Demonstration(
        name=drive.name,
        scans=Scans(elapsed_times, elapsed_times, scans.fan[scan_rows], ranges),
        odometry=Motion(elapsed_times, elapsed_times, poses, motion.twist[motion_rows]),
        commands=Commands(elapsed_times, commands[chosen_rows]),
        goal_pose=goal_pose,
        source=drive.source or {"demonstrator": "not stated"},
    )


def is_driving(demonstration: Demonstration) -> np.ndarray:
    """Return the mask (n,) of the instants at which the demonstrator drives."""
    return np.asarray(np.abs(demonstration.commands.twist).max(axis=1) > DRIVING_SPEED)


def policy_scans(demonstration: Demonstration, robot: Robot) -> np.ndarray:
    """Return the scans (n, beams) float32 [m] resampled for a policy: 720 beams for the Jackal."""
    layout = layout_of(robot)
    recorded_scans = demonstration.scans
    first_angle, increment = recorded_scans.fan[0, :2].tolist()
    direction = first_angle + robot.laser.pose[2]
    scans = []
    for scan_row in range(len(recorded_scans)):
        scans.append(layout.resample(recorded_scans.distances(scan_row), direction, increment))
    return np.array(scans)


def _beats(stamps: np.ndarray) -> np.ndarray:
    """Return the indices of the scans to use.

    They are all scans, or one per planner cycle if the laser is faster than the planner.
    """
    due_time = stamps[0]
    used_rows = []
    for row, stamp in enumerate(stamps.tolist()):
        # A scan may come a little early. After a gap, the next one is due half a period later.
        if stamp >= due_time - CONTROL_PERIOD / 5:
            due_time = max(due_time + CONTROL_PERIOD, stamp + CONTROL_PERIOD / 2)
            used_rows.append(row)
    return np.array(used_rows)


def _commands(commands: Commands, times: np.ndarray) -> np.ndarray:
    """Return the latest command (n, 2) at the end of each instant, or zeros if it is too old.

    A base stops when its last command is older than HELD_S.
    """
    # The planner's command at an instant is that for the cycle after its scan.
    last_rows = np.searchsorted(commands.time, times + 0.9 * CONTROL_PERIOD, side="right") - 1
    is_fresh = (last_rows >= 0) & (times - commands.time[last_rows] < HELD_S)
    latest_twists = commands.twist[last_rows]
    return np.where(is_fresh[:, None] & np.isfinite(latest_twists), latest_twists, 0.0)
