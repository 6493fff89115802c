"""Simulated drives with a C++-like planner, optionally with parameters changed, as recordings and as ROS 1 bags."""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Dict, Tuple

import numpy as np

import worlds
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.decision import Seen
from applr_ros1.robots import Robot
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.recording import StackWriter
from training.bags.bag import TopicNames
from training.bags.recording import Odometry, Recording
from training.env.episode import Episode, counting_cells
from training.env.outcome import Outcome

EARLIER = 0.001  # time by which the messages of a cycle precede its command [s]


class RecordedMoveBase(MoveBase):
    """MoveBase that keeps the messages of its cycles in `recording`."""

    recording: Recording

    def step(self, now, pose, twist, scan=None, local_origin=None):
        kept = self.recording
        kept.odometry.append(Odometry(now - EARLIER, tuple(pose), tuple(twist)))
        if scan is not None:
            kept.scans.append((now - EARLIER, scan))
        cycle = super().step(now, pose, twist, scan, local_origin)
        if cycle.command is not None and cycle.controlled:
            kept.commands.append((now, *cycle.command))
            kept.followed.append((now, np.array(self.local_planner.cropped_plan)))
        return cycle


def changed(robot: Robot, change: Dict[str, Dict[str, Any]]) -> Robot:
    """Return the robot with {server: {name: value}} changed in its files."""
    tree: Dict[str, Any] = {}
    for server, values in change.items():
        node = tree
        for part in server.split("/"):
            node = node.setdefault(part, {})
        node.update(values)
    return robot.with_parameters(tree, robot.name)


def drive(robot: Robot, world: Any, limit: float = 60.0, seed: int = 0) -> Tuple[Recording, Outcome]:
    """Drive a robot through a world, or the world of a name in its scale, with the parameters of its files."""
    move_base = RecordedMoveBase(counting_cells(robot.parameters()), planner=CPP_LIKE, seed=seed)
    move_base.recording = Recording(Path(str(getattr(world, "name", world))))
    fixed = replace(robot, space=())  # The parameters of the files stay, even out of the ranges of robot.yaml.
    episode = Episode(KinematicSimulator(robot), move_base, fixed, period=1.0, time_limit=limit, escapes=False)
    world = worlds.scaled(worlds.load(world), robot.world_scale) if isinstance(world, str) else world
    outcome = episode.reset(world, seed)
    while not outcome.over:
        outcome = episode.decide(np.zeros(0))
    return move_base.recording, outcome


def write(recording, robot, path, without=(), planner="", decided=None, limited=False) -> Path:
    """Write a recording as a ROS 1 bag, without some of scan, odometry, command and plan; return its path.

    With `decided`, {name: value}, it begins with a decision of the applr node. With `limited`, a collision monitor
    stops the robot.
    """
    planner = planner or robot.local_planner
    with StackWriter(path, TopicNames.of(robot), robot) as writer:
        if decided is not None:
            nothing = np.zeros((0, 2)), np.zeros((0, 4))
            seen = Seen((np.zeros(3, np.float32), 0.0, 1.0), 0.0, (0.0,) * 3, (0.0,) * 2, (0.0,) * 3, *nothing)
            writer.decision(1.0, 0, "", seen, {}, decided)
        rows = [(one.at, "odometry", one) for one in recording.odometry]
        rows += [(at, "scan", scan) for at, scan in recording.scans]
        rows += [(at, "update", (server, values)) for at, server, values in recording.updates]
        rows += [(at - EARLIER / 2, "plan", plan) for at, plan in recording.followed]
        rows += [(at, "command", (v, w)) for at, v, w in recording.commands]
        for at, what, value in sorted((row for row in rows if row[1] not in without), key=itemgetter(0)):
            at += 1.0
            if what == "odometry":
                writer.odometry(at, value.pose, value.twist)
            elif what == "scan":
                writer.scan(at, value.ranges)
            elif what == "plan":
                header = writer._header(at, robot.frames.odom)
                poses = [writer._make("geometry_msgs/msg/PoseStamped", header, writer._pose(pose)) for pose in value]
                writer._put(f"/move_base/{planner}/global_plan", "nav_msgs/msg/Path", at, header, poses)
            elif what == "update":
                kind = "dynamic_reconfigure/msg/"
                doubles = [writer._make(kind + "DoubleParameter", *one) for one in value[1].items()]
                writer._put(f"/move_base/{value[0]}/parameter_updates", kind + "Config", at, [], [], [], doubles, [])
            else:
                writer.command(at, *((0.0, 0.0) if limited else value))
                if limited:
                    v, w = (writer._vector(*numbers) for numbers in (value[:1], (0.0, 0.0, *value[1:])))
                    writer._put("/move_base/cmd_vel", "geometry_msgs/msg/Twist", at, v, w)
    return path
