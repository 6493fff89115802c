"""Demonstrations: recorded drives whose scans, motion and commands are brought to the same instants.

APPLD (appld.py) reads demonstrations from bags. A bag is recorded while a person drives the robot, or by demonstrate.py
with the scripted demonstrator.
"""

from __future__ import annotations

import os

import numpy as np

from applr_ros1.drives.drive import Commands, Drive, Motion, Scans, SentGoal
from applr_ros1.policy.observation import layout_of
from applr_ros1.robots import JACKAL, Robot
from training.bags.read import BagError, read, refused
from training.bags.topics import TopicNames, topic_of
from training.env.episode import CONTROL_PERIOD

CHANNELS = ("scans", "odometry", "commands", "sent", "source")  # channels of a demonstration
DRIVING_SPEED = 0.02  # larger of |v| and |w| above which the robot is driving [m/s, rad/s]
HELD_S = 0.5  # duration for which a command remains valid [s]
NEAR_S = 0.1  # largest time between an instant and its odometry [s]
SHORTEST_S = 5.0  # minimum driving time of a demonstration [s]


def read_demonstration(
    path: os.PathLike[str] | str, topics: TopicNames = TopicNames(), robot: Robot = JACKAL
) -> Drive:
    """Read a demonstration from a ROS 1 or ROS 2 bag with scans, odometry and commands.

    Returns:
        A drive whose scans, odometry and commands have a row at each instant: about every 50 ms, one per control cycle,
        from the first to the last command. Its sent goal is the last one in the odometry's frame, or its last pose.

    Raises:
        BagError: The bag cannot be read, lacks a topic or has too little driving.
    """
    with refused(path):
        drive = read(path, robot, topics, CHANNELS)
        for column in ("scans", "odometry", "commands"):
            rows = getattr(drive, column)
            if rows is None or len(rows) < 2:
                raise BagError(f"no {column} on {topic_of(column, topics)}")
        return instants(drive)


def instants(drive: Drive) -> Drive:
    """Return a drive with scans, odometry and commands at the same instants, see read_demonstration."""
    assert drive.scans is not None
    assert drive.odometry is not None
    assert drive.commands is not None
    chosen = _beats(drive.scans.stamp)
    times = drive.scans.stamp[chosen]
    rows = _nearest_rows(drive.odometry.stamp, times)
    is_located = np.abs(drive.odometry.stamp[rows] - times) < NEAR_S
    commands = _commands(drive.commands, times)

    # The demonstration begins and ends with driving.
    is_driving = np.abs(commands).max(axis=1) > DRIVING_SPEED
    moving = np.flatnonzero(is_driving & is_located)
    driven_s = len(moving) * CONTROL_PERIOD
    if driven_s < SHORTEST_S:
        raise BagError(
            f"{driven_s:.1f} s of driving are too little: record {SHORTEST_S:g} s or more"
        )
    span = np.arange(moving[0], moving[-1] + 1)
    span = span[is_located[span]]

    time = times[span] - times[span[0]]
    scans = [drive.scans.ranges[index] for index in chosen[span].tolist()]
    motion = drive.odometry
    pose = motion.pose[rows[span]]
    sent = [goal.pose for goal in drive.sent if goal.frame == drive.frame]
    goal = sent[-1] if sent else tuple(pose[-1].tolist())
    return Drive(
        name=drive.name,
        frame=drive.frame,
        odometry=Motion(time, time, pose, motion.twist[rows[span]]),
        scans=Scans(time, time, drive.scans.fan[chosen[span]], scans),
        commands=Commands(time, commands[span]),
        sent=[SentGoal(0.0, goal, drive.frame)],
        source=drive.source or {"demonstrator": "not stated"},
    )


def is_driving(drive: Drive) -> np.ndarray:
    """Return the mask (n,) of the instants at which the demonstrator drives."""
    assert drive.commands is not None
    return np.asarray(np.abs(drive.commands.twist).max(axis=1) > DRIVING_SPEED)


def policy_scans(drive: Drive, robot: Robot) -> np.ndarray:
    """Return the scans (n, 720) float32 [m] resampled for a policy; other robots have other numbers of beams."""
    assert drive.scans is not None
    layout = layout_of(robot)
    first_angle, increment = drive.scans.fan[0, :2].tolist()
    direction = first_angle + robot.laser.pose[2]
    return np.array(
        [layout.resample(ranges, direction, increment) for ranges in drive.scans.ranges]
    )


def _nearest_rows(stamps: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the indices of the stamps nearest to some times; of two equally near ones, the earlier."""
    rows = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    is_earlier = np.abs(stamps[rows - 1] - times) <= np.abs(stamps[rows] - times)
    return np.asarray(rows - is_earlier)


def _beats(stamps: np.ndarray) -> np.ndarray:
    """Return the indices of the scans to use: all, or one per planner cycle if the laser is faster than the planner."""
    due = stamps[0]
    chosen = []
    for index, stamp in enumerate(stamps.tolist()):
        if stamp >= due - CONTROL_PERIOD / 5:
            due = max(due + CONTROL_PERIOD, stamp + CONTROL_PERIOD / 2)
            chosen.append(index)
    return np.array(chosen)


def _commands(commands: Commands, times: np.ndarray) -> np.ndarray:
    """Return the latest command (n, 2) at the end of each instant, or zeros if that command is older than HELD_S."""
    last = np.searchsorted(commands.time, times + 0.9 * CONTROL_PERIOD, side="right") - 1
    is_fresh = (last >= 0) & (times - commands.time[last] < HELD_S)
    latest = commands.twist[last]
    return np.where(is_fresh[:, None] & np.isfinite(latest), latest, 0.0)
