"""A demonstration: the commands that somebody gave, with the poses and scans that went with them.

APPLD (appld.py) reads it from a bag, recorded while a person drove the robot or by the scripted demonstrator
(demonstrate.py) wrote.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Tuple

import numpy as np

from applr_ros1.policy.observation import layout_of
from applr_ros1.robots import JACKAL, Robot
from training.bags import SECOND
from training.bags.bag import Bag, BagError, read, refused
from training.bags.topics import TopicNames
from training.env.episode import CONTROL_PERIOD

DRIVING_SPEED = 0.02  # m/s and rad/s; less is no driving
HELD = 0.5  # s for which a command counts after it was given
SHORTEST = 5.0  # s of driving that a demonstration must have


@dataclass
class Demonstration:
    """The instants of a demonstration, one for each control cycle of the planner, from the first command to the last.

    Instants follow the scans and are about 50 ms apart.

    Attributes:
        time: (n,) [s].
        scan: the geometry of the scans: angle of the first range and between ranges [rad], smallest and largest range
            [m].
        ranges: (n, m) float32 [m], as the laser gave them.
        seen: (n, 720) float32 [m], as a policy sees them; other numbers of beams for other robots.
        pose: (n, 3) x, y [m], yaw [rad] of the odometry.
        twist: (n, 2) v [m/s], w [rad/s] of the odometry.
        command: (n, 2) v [m/s], w [rad/s].
        goal: (x, y, yaw) in the frame of the odometry.
        source: who demonstrated, and where.
        robot: which robot drove.
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
        """(n,) bool: where the demonstrator does not stand."""
        return np.abs(self.command).max(axis=1) > DRIVING_SPEED


def read_demonstration(path, topics: TopicNames = TopicNames(), robot: Robot = JACKAL) -> Demonstration:
    """A ROS 1 or ROS 2 bag with scans, odometry and commands. Raises BagError with one line.

    The goal is the newest one sent to move_base, in the odometry's frame; without one, where the demonstration ends.
    """
    with refused(path):
        bag = read(path, topics)
        for what, topic, found in (
            ("scan", topics.scan, bag.scans.stamp),
            ("odometry", topics.odometry, bag.odometry.stamp),
            ("commands", topics.command, bag.commands[0]),
        ):
            if len(found) < 2:
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
        raise BagError(f"{driven:.1f} s of driving; a demonstration needs {SHORTEST:g} s and more")
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


def _beats(stamps) -> np.ndarray:
    """The scans that are used: one for each planner cycle, the nearest to its beat, as the laser has another one."""
    period, due, chosen = int(CONTROL_PERIOD * SECOND), int(stamps[0]), []
    for i, when in enumerate(stamps.tolist()):
        if when >= due - period // 5:
            due = max(due + period, when + period // 2)
            chosen.append(i)
    return np.array(chosen)


def _commands(at, values, when) -> np.ndarray:
    """(n, 2): the newest command given by the end of each instant; 0 where it is older than HELD."""
    last = np.searchsorted(at, when + int(0.9 * CONTROL_PERIOD * SECOND), side="right") - 1
    fresh = (last >= 0) & (when - at[last] < HELD * SECOND)
    return np.where(fresh[:, None] & np.isfinite(values[last]), values[last], 0.0)
