"""Writes simulated drives as ROS 1 bags with the topics of the real stack, so that both kinds of experience mix.

`RecordingEpisode` drives as Episode does and writes what a robot's recorder would have heard; bags_to_dataset.py and
every ROS tool read the result. No ROS is needed to write it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, Mapping, Optional

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.rosbag1.writer import WriterError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from applr_ros1.common.angles import quaternion_of
from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError
from applr_ros1.robots import JACKAL, Robot
from training.bags.reader import SECOND, TopicNames
from training.env.episode import Episode
from training.env.outcome import Outcome

MESSAGES = Path(__file__).resolve().parents[2] / "msg"  # of the catkin package
PLOTTED = 8  # fields of Parameters.msg beside its lists
PAUSE = 5.0  # s of time between two courses of a bag
ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = 1, 2, 3, 4
_RESULT = {
    "move_base_msgs/msg/MoveBaseActionResult": "std_msgs/Header header\nactionlib_msgs/GoalStatus status\n"
    "move_base_msgs/MoveBaseResult result\n",
    "move_base_msgs/msg/MoveBaseResult": "",
}


class BagWriter:
    """A ROS 1 bag with the topics of a robot's stack; times in seconds from 0; a context manager.

    Args:
        path: Of the bag, which must not exist.
        topics: Names of the topics.
        robot: Whose laser and frames they are.

    Raises:
        StorageError: The bag is there already, or cannot be written.
    """

    def __init__(self, path, topics: TopicNames = TopicNames(), robot: Robot = JACKAL):
        self.path, self.topics, self.robot = Path(path), topics, robot
        self.store = get_typestore(Stores.ROS1_NOETIC)
        for name, text in _RESULT.items():
            self.store.register(get_types_from_msg(text, name))
        self._connections: Dict[str, Any] = {}
        if self.path.exists():
            raise StorageError("%s: is there already; give another name" % path)
        try:
            self._writer = Writer(self.path)
            self._writer.open()
        except (OSError, WriterError) as error:
            why = reason(error) if isinstance(error, OSError) else error
            raise StorageError("%s: cannot be written (%s)" % (path, why)) from None

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()

    # -- the topics --------------------------------------------------------------------------------
    def scan(self, time: float, ranges) -> None:
        """Write a scan: ranges (beams,) [m] of the robot's laser."""
        empty = np.empty(0, np.float32)
        laser = self.robot.laser
        self._put(
            self.topics.scan,
            "sensor_msgs/msg/LaserScan",
            time,
            self._header(time, laser.frame),
            laser.first_angle,
            laser.first_angle + laser.increment * (len(ranges) - 1),
            laser.increment,
            0.0,
            1.0 / laser.rate,
            laser.range_min,
            laser.range_max,
            np.ascontiguousarray(ranges, np.float32),
            empty,
        )

    def odometry(self, time: float, pose, twist) -> None:
        """Write the odometry: pose (x, y, yaw) [m, rad] in the robot's odometry frame, twist (v, w) [m/s, rad/s]."""
        make, zeros = self._make, np.zeros(36)
        self._put(
            self.topics.odometry,
            "nav_msgs/msg/Odometry",
            time,
            self._header(time, self.robot.frames.odom),
            self.robot.frames.base,
            make("geometry_msgs/msg/PoseWithCovariance", self._pose(pose), zeros),
            make(
                "geometry_msgs/msg/TwistWithCovariance",
                make("geometry_msgs/msg/Twist", self._vector(twist[0]), self._vector(0.0, 0.0, twist[1])),
                zeros,
            ),
        )

    def command(self, time: float, v: float, w: float) -> None:
        """What the base is told to drive [m/s, rad/s]."""
        self._put(self.topics.command, "geometry_msgs/msg/Twist", time, self._vector(v), self._vector(0.0, 0.0, w))

    def told(self, time: float, **what) -> None:
        """Who demonstrates and where, as JSON; the teleoperation node says the same."""
        self._put(self.topics.demonstration, "std_msgs/msg/String", time, json.dumps(what))

    def plan(self, time: float, plan) -> None:
        """Write a global plan: (n, 3) x, y [m], yaw [rad] in the robot's odometry frame."""
        header = self._header(time, self.robot.frames.odom)
        poses = [self._make("geometry_msgs/msg/PoseStamped", header, self._pose(p)) for p in np.asarray(plan).tolist()]
        self._put(self.topics.plan, "nav_msgs/msg/Path", time, header, poses)

    def parameters(self, time: float, server: str, values: dict) -> None:
        """{name: value} that a server below move_base announces."""
        lists: Dict[type, list] = {bool: [], int: [], str: [], float: []}
        kinds = {bool: "Bool", int: "Int", str: "Str", float: "Double"}
        for name, value in values.items():
            kind = next(k for k in lists if isinstance(value, k))
            lists[kind].append(self._make("dynamic_reconfigure/msg/%sParameter" % kinds[kind], name, value))
        self._put(
            "%s/%s/parameter_updates" % (self.topics.move_base, server),
            "dynamic_reconfigure/msg/Config",
            time,
            lists[bool],
            lists[int],
            lists[str],
            lists[float],
            [],
        )

    def goal(self, time: float, goal) -> None:
        """(x, y, yaw) in the robot's odometry frame, as move_base announces the goal that it has accepted."""
        self._put(
            self.topics.move_base + "/current_goal",
            "geometry_msgs/msg/PoseStamped",
            time,
            self._header(time, self.robot.frames.odom),
            self._pose(goal),
        )

    def status(self, time: float, goal_id: str, running: bool = True) -> None:
        """Write the status topic of the action move_base."""
        entries = [self._status(goal_id, ACTIVE)] if running else []
        self._put(
            self.topics.move_base + "/status",
            "actionlib_msgs/msg/GoalStatusArray",
            time,
            self._header(time, ""),
            entries,
        )

    def result(self, time: float, goal_id: str, status: int) -> None:
        """Write the result of a goal with an actionlib status."""
        self._put(
            self.topics.move_base + "/result",
            "move_base_msgs/msg/MoveBaseActionResult",
            time,
            self._header(time, ""),
            self._status(goal_id, status),
            self._make("move_base_msgs/msg/MoveBaseResult", 0),
        )

    def contact(self, time: float) -> None:
        """Write that the robot touches something."""
        self._put(self.topics.collision, "std_msgs/msg/Bool", time, True)

    def decision(
        self, time: float, number: int, goal: str, observation, seen: Mapping[str, float], before, after
    ) -> None:
        """As the applr node tells of a decision (msg/Decision.msg).

        Args:
            time: When it was made.
            number: Which one it is.
            goal: Its goal's id.
            observation: (729,).
            seen: The times [s] of the scan, odometry and plan that it was made from.
            before: {name: value} that the planner had.
            after: {name: value} that was chosen; {} where it was refused.
        """
        kinds = "applr_ros1/msg/Parameters", "applr_ros1/msg/Decision"
        if kinds[1] not in self.store.types:
            for kind in kinds:
                text = (MESSAGES / (kind.rpartition("/")[2] + ".msg")).read_text(encoding="utf-8")
                self.store.register(get_types_from_msg(text, kind))
        header = self._header(time, self.robot.frames.odom)
        times = [self._time(seen[name]) for name in ("scan", "odometry", "plan")]
        sets = [
            self._make(kinds[0], header, list(of), np.array(list(of.values())), np.ones(len(of)), *[np.nan] * PLOTTED)
            for of in (before, after)
        ]
        place = [np.nan] * 5  # pose and local goal, which no reader needs
        observation = np.asarray(observation, np.float32)
        fields = header, number, goal, *times, *place, observation, *sets, ""
        self._put(self.topics.applr + "/decision", kinds[1], time, *fields)

    # -- how they are written ----------------------------------------------------------------------
    def _put(self, topic, kind, time, *fields) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        message = self.store.serialize_ros1(self._make(kind, *fields), kind)
        try:
            self._writer.write(self._connections[topic], nanoseconds(time), message)
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self.path, reason(error))) from None

    def _make(self, kind, *fields):
        return self.store.types[kind](*fields)

    def _time(self, time):
        return self._make("builtin_interfaces/msg/Time", *divmod(nanoseconds(time), SECOND))

    def _header(self, time, frame):
        return self._make("std_msgs/msg/Header", 0, self._time(time), frame)

    def _vector(self, x, y=0.0, z=0.0, kind="Vector3"):
        return self._make("geometry_msgs/msg/" + kind, float(x), float(y), float(z))

    def _pose(self, pose):
        x, y, yaw = pose
        turn = self._make("geometry_msgs/msg/Quaternion", *quaternion_of(yaw))
        return self._make("geometry_msgs/msg/Pose", self._vector(x, y, kind="Point"), turn)

    def _status(self, goal_id, status):
        return self._make(
            "actionlib_msgs/msg/GoalStatus",
            self._make("actionlib_msgs/msg/GoalID", self._time(0.0), goal_id),
            status,
            "",
        )


class RecordingEpisode(Episode):
    """An Episode that writes all that it drives into a BagWriter, course after course."""

    def __init__(self, simulator, move_base, writer: BagWriter, **options):
        super().__init__(simulator, move_base, writer.robot, **options)
        self.writer = writer
        self.courses = self._number = 0
        self._ahead = 1.0  # what is added to the simulator's time, which begins anew with each course
        self._scanned: Optional[float] = None  # time of the newest scan in the bag

    def reset(self, world, seed: int, start=None, theta=None) -> Outcome:
        """Begin a course; a goal is sent on the recorded action topic."""
        if self.courses:
            self._ahead += self.simulator.state.time + PAUSE
        self._goal_id = ""  # nothing is written before the goal is sent
        outcome = super().reset(world, seed, start, theta)
        self.courses += 1
        self._goal_id = "course %d in %s" % (self.courses, world.name)
        self._parameters()
        self.writer.goal(self._now, self.goal)
        self._look(outcome, self.move_base.make_plan(self.simulator.state.odom_pose, self.goal, 0.0))
        return outcome

    def decide(self, theta) -> Outcome:
        """Drive one decision period and write what the nodes would have published in it."""
        self._decision()
        outcome = super().decide(theta)
        self._look(outcome, self.move_base.global_plan)
        if outcome.over:
            status = SUCCEEDED if outcome.success else ABORTED if outcome.aborted else PREEMPTED
            self.writer.result(self._now, self._goal_id, status)
            self.writer.status(self._now, self._goal_id, running=False)
        return outcome

    def apply(self, theta) -> np.ndarray:
        """Set the parameters and write the parameter updates that follow."""
        result = super().apply(theta)
        if getattr(self, "_goal_id", ""):
            self._parameters(1e-3)  # after the decision that it came from
        return result

    @property
    def _now(self) -> float:
        return self._ahead + self.simulator.state.time

    def _cycle(self):
        before, now, ranges = self.simulator.state, self._now, self._ranges
        cycle, state = super()._cycle()
        if self._goal_id:
            if self._scanned != now:  # a decision's scan was taken at the same moment, with other noise
                self.writer.odometry(now, before.odom_pose, before.odom_twist)
                if self._ranges is not ranges:
                    self.writer.scan(now, self._ranges)
            if state.contact:
                self.writer.contact(self._ahead + state.time)
        return cycle, state

    def _look(self, outcome, plan) -> None:
        """What the coming decision sees."""
        now, state = self._now, self.simulator.state
        self.writer.status(now, self._goal_id)
        self.writer.odometry(now, state.odom_pose, state.odom_twist)
        self.writer.scan(now, self._seen)
        self._scanned = now
        if plan is not None and len(plan):
            self.writer.plan(now, plan)

    def _decision(self) -> None:
        now, outcome = self._now, self.outcome
        assert outcome is not None  # decide() has checked it
        self._number += 1
        seen, before = dict.fromkeys(("scan", "odometry", "plan"), now), self.space.as_dict(outcome.theta)
        self.writer.decision(now, self._number, self._goal_id, self.observation(outcome), seen, before, {})

    def _parameters(self, later: float = 0.0) -> None:
        for server in self.space.servers:
            self.writer.parameters(self._now + later, server, self.move_base.configuration(server))


def nanoseconds(time: float) -> int:
    """Seconds in whole nanoseconds."""
    return int(round(time * SECOND))
