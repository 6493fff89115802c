"""Recorded drive of move_base as a replay needs it: scans, odometry, commands, plans and changes of parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan
from applr_ros1.robots import Robot
from training.bags import SECOND
from training.bags.bag import TopicNames, command_of, messages, nanoseconds_of, odometry_of, pose_of, refused


class Odometry(NamedTuple):
    """Odometry message."""

    at: float  # time of recording [s]
    pose: Pose
    twist: Tuple[float, float]  # v [m/s], w [rad/s]


@dataclass
class Recording:
    """Messages of one drive in order of recording, as rows that begin with the time since the first message [s]."""

    path: Path = Path()
    odometry: List[Odometry] = field(default_factory=list)
    scans: List[Tuple[float, LaserScan]] = field(default_factory=list)  # in the odometry frame
    commands: List[Tuple[float, float, float]] = field(default_factory=list)  # v, w, before a collision monitor
    followed: List[Tuple[float, np.ndarray]] = field(default_factory=list)  # part (n, 3) of the plan that was followed
    updates: List[Tuple[float, str, Dict[str, Any]]] = field(default_factory=list)  # server, {name: value}
    recoveries: List[Tuple[float]] = field(default_factory=list)  # begins of recovery behaviours


def read(path: Path, robot: Robot, topics: TopicNames) -> Recording:
    """Read the drive of a robot from a bag of ROS 1 or ROS 2.

    Raises:
        BagError: The bag cannot be read, lacks odometry, scans, commands or plans, or another robot or planner drove.
    """
    base, laser, updates = topics.move_base, robot.laser, "/parameter_updates"
    followed, raw_command = f"{base}/{robot.local_planner}/global_plan", base + "/cmd_vel"
    unpackers = {
        topics.odometry: odometry_of,
        topics.scan: lambda m: (m,),
        **dict.fromkeys((topics.command, raw_command), command_of),
        f"{base}/*/global_plan": lambda m: (np.array([pose_of(one.pose) for one in m.poses]).reshape(-1, 3),),
        f"{base}/*{updates}": lambda m: ({v.name: v.value for v in (*m.bools, *m.ints, *m.strs, *m.doubles)},),
        f"{base}/recovery_status": lambda m: (),
        topics.decision: lambda m: (dict(zip(m.after.names, m.after.values.tolist())),),
    }
    with refused(path):
        rows = messages(path, unpackers)
        drove = {topic.split("/")[-2] for topic in rows if topic.endswith("/global_plan")}
        if drove and robot.local_planner not in drove:
            raise ApplrError(f"{drove.pop()} drove, {robot.name} has {robot.local_planner}: give the robot as --robot")
        for topic in (topics.odometry, topics.scan, raw_command if rows[raw_command] else topics.command, followed):
            if not rows[topic]:
                raise ApplrError(f"no messages on {topic}: record it, or give the robot as --robot")
        frame = rows[topics.scan][0][1].header.frame_id.lstrip("/")
        if frame != laser.frame:
            raise ApplrError(f"scans in {frame}, {robot.name} has {laser.frame}: give the robot as --robot")
    begin = min(row[0][0] for row in rows.values() if row)

    def timed(topic: str) -> List[Any]:
        """Return the rows of a topic with times in seconds."""
        return [((at - begin) / SECOND, *row) for at, *row in rows[topic]]

    stamps, track = [row[1] for row in rows[topics.odometry]], np.array([row[3:6] for row in rows[topics.odometry]])
    track[:, 2] = np.unwrap(track[:, 2])

    def scan_of(m: Any) -> LaserScan:
        """Return a sensor_msgs/LaserScan in the odometry frame."""
        x, y, yaw = (float(np.interp(nanoseconds_of(m.header.stamp), stamps, axis)) for axis in track.T)
        fan = float(m.angle_min), float(m.angle_increment), float(m.range_min), float(m.range_max)
        return LaserScan(0.0, *fan, np.asarray(m.ranges, np.float32), compose((x, y, yaw), laser.pose), laser.height)

    servers = {topic[len(base) + 1 : -len(updates)]: topic for topic in rows if topic.endswith(updates)}
    given = [(at, server, values) for server, topic in servers.items() for at, values in timed(topic)]
    for at, decided in timed(topics.decision):  # Of servers without recorded updates, the policy's values are taken.
        targets = [(one, decided[p.name]) for p in robot.space if p.name in decided for one in p.sets]
        given += [(at, one.server, {one.name: value}) for one, value in targets if one.server not in servers]
    return Recording(
        path,
        [Odometry(at, (x, y, yaw), (v, w)) for at, _, _, x, y, yaw, v, w in timed(topics.odometry)],
        [(at, scan_of(m)) for at, m in timed(topics.scan)],
        timed(raw_command) or timed(topics.command),
        timed(followed),
        sorted(given, key=itemgetter(0)),
        timed(base + "/recovery_status"),
    )
