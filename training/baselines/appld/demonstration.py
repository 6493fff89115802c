"""A demonstration: the commands that somebody gave, with the poses and scans that went with them.

APPLD (appld.py) reads it from a bag, which the teleoperation node recorded on a robot or the scripted demonstrator
(demonstrate.py) wrote.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Tuple

import numpy as np

from applr_ros1.common.angles import yaw_of
from applr_ros1.policy.observation import ObservationError, layout_of
from applr_ros1.robots import JACKAL, Robot
from training.bags.reader import SECOND, BagError, TopicNames, open_bag, stamp
from training.env.episode import CONTROL_PERIOD

DRIVING_SPEED = 0.02  # m/s and rad/s; less is no driving
HELD = 0.5  # s for which a command counts after it was given
SHORTEST = 5.0  # s of driving that a demonstration must have
MAX_INSTANTS = 36_000  # half an hour


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


def read(path, topics: TopicNames = TopicNames(), robot: Robot = JACKAL) -> Demonstration:
    """A ROS 1 or ROS 2 bag with scans, odometry and commands. Raises BagError with one line.

    The goal is the newest one sent to move_base, in the odometry's frame; without one, where the demonstration ends.
    Where no command was recorded, the odometry's twist one cycle later stands for it.
    """
    path = Path(path)
    heard: Dict[str, Any] = {"scan": [], "odometry": [], "command": [], "goal": [], "source": {}, "robot": robot}
    try:
        with open_bag(path) as reader:
            _hear(reader, topics, heard)
    except (BagError, ObservationError) as error:
        raise BagError("%s: %s" % (path, str(error).replace("%s: " % path, ""))) from None
    except Exception as error:  # rosbags raises many kinds for damaged files
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise BagError("%s: damaged or not a bag (%s)" % (path, line)) from None
    for what, topic in (("scan", topics.scan), ("odometry", topics.odometry)):
        if len(heard[what]) < 2:
            raise BagError("%s: no %s on %s" % (path, what, topic))
    return _instants(path, heard)


def _hear(reader, topics: TopicNames, heard) -> None:
    hearers = {
        topics.scan: _scan,
        topics.odometry: _odometry,
        topics.command: _command,
        topics.move_base + "/current_goal": _goal,
        topics.demonstration: _source,
    }
    connections = [c for c in reader.connections if c.topic in hearers]
    for connection, at, raw in reader.messages(connections) if connections else ():
        hearers[connection.topic](heard, at, reader.deserialize(raw, connection.msgtype))


def _scan(heard, at, message):
    when = stamp(message)
    # one for each planner cycle is enough; laser and planner do not beat alike, so the nearest to the beat
    period = int(CONTROL_PERIOD * SECOND)
    due = heard.get("due", when)
    if when < due - period // 5:
        return
    heard["due"] = max(due + period, when + period // 2)
    ranges = np.asarray(message.ranges, np.float32)
    geometry = message.angle_min, message.angle_increment, message.range_min, message.range_max
    if heard.setdefault("geometry", (len(ranges), geometry)) != (len(ranges), geometry):
        raise BagError("its scans have different beams; a demonstration needs one scanner with fixed settings")
    robot = heard["robot"]
    seen = layout_of(robot).resample(ranges, message.angle_min + robot.laser.pose[2], message.angle_increment)
    if len(heard["scan"]) >= MAX_INSTANTS:
        raise BagError("longer than %d minutes of scans; cut it (rosbag filter)" % (MAX_INSTANTS / 1200))
    heard["scan"].append((when, ranges, seen))


def _odometry(heard, at, message):
    p, t = message.pose.pose, message.twist.twist
    heard["frame"] = message.header.frame_id.lstrip("/")
    yaw = yaw_of(p.orientation)
    heard["odometry"].append((stamp(message), p.position.x, p.position.y, yaw, t.linear.x, t.angular.z))


def _command(heard, at, message):
    message = getattr(message, "twist", message)  # TwistStamped too
    heard["command"].append((at, message.linear.x, message.angular.z))


def _goal(heard, at, message):
    position = message.pose.position
    pose = position.x, position.y, yaw_of(message.pose.orientation)
    heard["goal"].append((message.header.frame_id.lstrip("/"), pose))


def _source(heard, at, message):
    try:
        said = json.loads(message.data)
    except (ValueError, RecursionError):
        return
    if isinstance(said, dict):
        heard["source"] = {str(k)[:40]: v if isinstance(v, (int, float)) else str(v)[:200] for k, v in said.items()}


def _instants(path, heard) -> Demonstration:
    when = np.array([row[0] for row in heard["scan"]], dtype=np.int64)
    stamps = np.array([row[0] for row in heard["odometry"]], dtype=np.int64)
    states = np.array([row[1:] for row in heard["odometry"]], dtype=np.float64)
    if np.any(np.diff(when) <= 0) or not np.isfinite(states).all():
        raise BagError("%s: its clock jumps back, or its odometry is not finite; record it anew" % path)
    nearest = np.clip(np.searchsorted(stamps, when), 1, len(stamps) - 1)
    nearest -= np.abs(stamps[nearest - 1] - when) <= np.abs(stamps[nearest] - when)
    command = _commands(heard["command"], when) if heard["command"] else _next(states[nearest, 3:])
    used = np.abs(stamps[nearest] - when) < 0.1 * SECOND
    moving = np.flatnonzero((np.abs(command).max(axis=1) > DRIVING_SPEED) & used)
    if len(moving) * CONTROL_PERIOD < SHORTEST:
        raise BagError(
            "%s: %.1f s of driving; a demonstration needs %g s and more"
            % (path, len(moving) * CONTROL_PERIOD, SHORTEST)
        )
    span = np.arange(moving[0], moving[-1] + 1)
    span = span[used[span]]
    pose = states[nearest[span], :3]
    goals = [goal for frame, goal in heard["goal"] if frame == heard["frame"]]
    goal = goals[-1] if goals else tuple(pose[-1].tolist())
    if not all(math.isfinite(v) for v in goal):
        raise BagError("%s: its goal is not finite" % path)
    source = heard["source"] or {"demonstrator": "not stated"}
    return Demonstration(
        path.name,
        (when[span] - when[span[0]]) / SECOND,
        heard["geometry"][1],
        np.array([heard["scan"][i][1] for i in span]),
        np.array([heard["scan"][i][2] for i in span]),
        pose,
        states[nearest[span], 3:],
        command[span],
        goal,
        source,
        heard["robot"],
    )


def _commands(given, when) -> np.ndarray:
    """(n, 2): the newest command given by the end of each instant; 0 where it is older than HELD."""
    at = np.array([row[0] for row in given], dtype=np.int64)
    values = np.array([row[1:] for row in given], dtype=np.float64)
    last = np.searchsorted(at, when + int(0.9 * CONTROL_PERIOD * SECOND), side="right") - 1
    fresh = (last >= 0) & (when - at[last] < HELD * SECOND)
    return np.where(fresh[:, None] & np.isfinite(values[last]), values[last], 0.0)


def _next(twist) -> np.ndarray:
    return np.vstack([twist[1:], twist[-1:]])
