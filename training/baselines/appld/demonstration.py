"""Demonstration: commands of a demonstrator, and the poses and scans recorded at the same times.

APPLD (appld.py) reads demonstrations from bags. A bag is recorded while a person drives the robot, or by demonstrate.py
with the scripted demonstrator.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Dict, Tuple

import numpy as np

from applr_ros1.policy.observation import layout_of
from applr_ros1.robots import JACKAL, Robot
from training.bags import SECOND
from training.bags.bag import Bag, BagError, TopicNames, read, refused
from training.env.episode import CONTROL_PERIOD

DRIVING_SPEED = 0.02  # larger of |v| and |w| above which the robot is driving [m/s, rad/s]
HELD = 0.5  # duration for which a command remains valid [s]
SHORTEST = 5.0  # minimum driving time of a demonstration [s]


@dataclass
class Demonstration:
    """Demonstration at instants of about 50 ms, one per control cycle, from the first to the last command.

    Attributes:
        name: File name of the bag.
        time: (n,) time [s].
        scan: Angle of the first range, angle between ranges [rad], minimum and maximum range [m].
        ranges: (n, m) float32 [m], unprocessed ranges of the laser.
        seen: (n, 720) float32 [m], ranges resampled for a policy; other robots have other numbers of beams.
        pose: (n, 3) x, y [m], yaw [rad] by odometry.
        twist: (n, 2) v [m/s], w [rad/s] by odometry.
        command: (n, 2) v [m/s], w [rad/s].
        goal: (x, y, yaw) [m, m, rad] in the frame of the odometry.
        source: Demonstrator and place.
        robot: Robot that drove.
    """

    name: str
    time: np.ndarray
    scan: Tuple[float, float, float, float]
    ranges: np.ndarray
    seen: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    command: np.ndarray
    goal: Tuple[float, float, float]
    source: Dict[str, Any]
    robot: Robot = JACKAL

    @property
    def driving(self) -> np.ndarray:
        """Mask (n,) of the instants at which the demonstrator drives."""
        return np.asarray(np.abs(self.command).max(axis=1) > DRIVING_SPEED)


def read_demonstration(
    path: os.PathLike[str] | str, topics: TopicNames = TopicNames(), robot: Robot = JACKAL
) -> Demonstration:
    """Read a demonstration from a ROS 1 or ROS 2 bag with scans, odometry and commands.

    The goal is the last goal sent to move_base in the odometry's frame. Without a goal, it is the last pose.

    Raises:
        BagError: The bag cannot be read, lacks a topic or has too little driving.
    """
    with refused(path):
        bag = read(path, topics)
        for what, topic, rows in (
            ("scan", topics.scan, bag.scans.stamp),
            ("odometry", topics.odometry, bag.odometry.stamp),
            ("commands", topics.command, bag.commands[0]),
        ):
            if len(rows) < 2:
                raise BagError(f"no {what} on {topic}")
        return _instants(bag, robot)


def _instants(bag: Bag, robot: Robot) -> Demonstration:
    scans, odometry = bag.scans, bag.odometry
    chosen, layout = _beats(scans.stamp), layout_of(robot)
    when, stamps = scans.stamp[chosen], odometry.stamp
    nearest = np.clip(np.searchsorted(stamps, when), 1, len(stamps) - 1)
    nearest -= np.abs(stamps[nearest - 1] - when) <= np.abs(stamps[nearest] - when)
    command = _commands(*bag.commands, when)
    used = np.abs(stamps[nearest] - when) < 0.1 * SECOND
    moving = np.flatnonzero((np.abs(command).max(axis=1) > DRIVING_SPEED) & used)
    if len(moving) * CONTROL_PERIOD < SHORTEST:
        driven = len(moving) * CONTROL_PERIOD
        raise BagError(f"{driven:.1f} s of driving are too little: record {SHORTEST:g} s or more")
    span = np.arange(moving[0], moving[-1] + 1)
    span = span[used[span]]
    pose = odometry.pose[nearest[span]]
    goals = [pose for frame, *pose in bag.goals if frame == odometry.frame]
    goal = tuple(goals[-1] if goals else pose[-1].tolist())
    first, increment, low, high = scans.geometry[chosen[0]].tolist()
    ranges = np.array([scans.ranges[i] for i in chosen[span].tolist()])
    return Demonstration(
        bag.path.name,
        (when[span] - when[span[0]]) / SECOND,
        (first, increment, low, high),
        ranges,
        np.array([layout.resample(row, first + robot.laser.pose[2], increment) for row in ranges]),
        pose,
        odometry.twist[nearest[span]],
        command[span],
        goal,
        bag.source or {"demonstrator": "not stated"},
        robot,
    )


def _beats(stamps: np.ndarray) -> np.ndarray:
    """Return the indices of the scans to use: all, or one per planner cycle if the laser is faster than the planner."""
    period, due, chosen = int(CONTROL_PERIOD * SECOND), int(stamps[0]), []
    for i, when in enumerate(stamps.tolist()):
        if when >= due - period // 5:
            due = max(due + period, when + period // 2)
            chosen.append(i)
    return np.array(chosen)


def _commands(at: np.ndarray, values: np.ndarray, when: np.ndarray) -> np.ndarray:
    """Return the latest command (n, 2) at the end of each instant, or zeros if that command is older than HELD."""
    last = np.searchsorted(at, when + int(0.9 * CONTROL_PERIOD * SECOND), side="right") - 1
    fresh = (last >= 0) & (when - at[last] < HELD * SECOND)
    return np.where(fresh[:, None] & np.isfinite(values[last]), values[last], 0.0)
