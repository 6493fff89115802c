"""The applr node's inputs: scan, pose, twist, global plan, goal and moving obstacles.

As in move_base, the pose comes from tf and only the twist from odometry. Callbacks only store the
latest message.
"""

from __future__ import annotations

import math
import threading
from typing import Any, NamedTuple, Optional, Tuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from applr_ros1.common.angles import Pose, transform_point
from applr_ros1.msg import Movers
from applr_ros1.nodes import conversions
from applr_ros1.nodes.sensors import Sensors
from applr_ros1.nodes.transforms import MAX_AGE_S
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.layout import ObservationError
from applr_ros1.robots import JACKAL, Robot

LEAST_LEVEL_COS = 0.95  # smallest cosine of the tilt of a level laser; 18 degrees
STATUS_AGE_S = 2.0  # time without a status after which move_base counts as gone [s]
_RUNNING = (GoalStatus.ACTIVE, GoalStatus.PREEMPTING)


class Snapshot(NamedTuple):
    """Inputs of one decision in the plan's `frame`, and the stamps of their messages.

    The goal is move_base's current goal, or the end of the plan if the node started after that goal
    was published. There are no moving obstacles if the last message about them is stale.
    """

    seen: Seen
    frame: str
    scan_stamp: rospy.Time
    odom_stamp: rospy.Time
    plan_stamp: rospy.Time
    movers_stamp: rospy.Time


class RobotInputs:
    """Subscriptions to tf, to a robot's scan and odometry, and to move_base's plan and status.

    Args:
        robot: Description of the robot.
        move_base: Namespace of move_base.
        prefix: Prefix of the robot's frames.
    """

    def __init__(self, robot: Robot = JACKAL, move_base: str = "/move_base", prefix: str = ""):
        self._base, self._scan_topic = prefix + robot.frames.base, robot.topics.scan
        self._sensors = Sensors.of_lasers(robot, prefix, self._base)
        self._transforms = self._sensors.transforms
        plan = move_base + "/NavfnROS/plan"
        self._plan_topic, self._lock = rospy.resolve_name(plan), threading.Lock()
        self.clear()
        rospy.Subscriber(
            plan, Path, self._on_plan, queue_size=1, buff_size=2**24
        )  # A small buffer delays plans.
        rospy.Subscriber(move_base + "/status", GoalStatusArray, self._on_status, queue_size=1)
        rospy.Subscriber(
            move_base + "/current_goal", PoseStamped, self._on_current_goal, queue_size=1
        )
        rospy.Subscriber("applr/tracked", Movers, self._on_movers, queue_size=1)

    def clear(self) -> None:
        """Drop all data after the clock jumped back."""
        self._sensors.forget()
        with self._lock:
            self._scan: Any = None
            self._plan = self._planned = self._movers = None
            self._goal, self._goal_heard, self._goal_since = None, None, None
            self._current_goal = self._former_goal = None  # poses that move_base has published

    def goal(self, now: rospy.Time) -> Any:
        """Return the id of move_base's goal, or None if there is none or move_base is gone."""
        with self._lock:
            gone = self._goal is not None and abs((now - self._goal_heard).to_sec()) > STATUS_AGE_S
            return None if gone else self._goal

    def has_lost_move_base(self, now: rospy.Time) -> bool:
        """Return whether move_base has published its status, but not for STATUS_AGE_S seconds."""
        with self._lock:
            return self._goal_heard is not None and (now - self._goal_heard).to_sec() > STATUS_AGE_S

    def snapshot(self, now: rospy.Time, began: Any) -> Snapshot:
        """Return a Snapshot at ROS time `now` of a course that began at ROS time `began`.

        Raises ObservationError with one line about the missing or invalid input.
        """
        with self._lock:
            plan, planned = self._plan, self._planned
            since, goal = self._goal_since, self._current_goal
            former, movers = self._former_goal, self._movers
        beams = self._beams(now)
        stamps = self._sensors.stamps()
        early = 0.0 if plan is None or since is None else (since - planned).to_sec()
        if (
            plan is None
            or early > 0.5
            or early > -0.5
            and _nearer(plan.poses[-1].pose, former, goal)
        ):
            raise ObservationError(f"no global plan for this goal on {self._plan_topic} yet")
        points = np.array([(p.pose.position.x, p.pose.position.y) for p in plan.poses])
        frame = plan.header.frame_id or plan.poses[0].header.frame_id
        goal = conversions.pose_of(plan.poses[-1].pose if goal is None else goal)
        moving, movers_stamp = self._moving(movers, frame, now)
        pose, time = self._pose(frame, stamps["scan"], now), (now - began).to_sec()
        seen = Seen(beams, time, pose, self._sensors.twist, goal, points, moving)
        return Snapshot(
            seen, frame, stamps["scan"], stamps["twist"], plan.header.stamp, movers_stamp
        )

    def _beams(self, now: rospy.Time) -> Tuple[np.ndarray, float, float]:
        """Return (ranges [m], first angle, increment [rad]) of the latest scan for the robot."""
        self._scan = scan = self._sensors.observations().get(self._scan_topic, self._scan)
        if scan is None or (now - self._sensors.stamps()["scan"]).to_sec() > MAX_AGE_S:
            latest = self._sensors.describe_latest(self._scan_topic)
            raise ObservationError(
                f"no usable scan on {rospy.resolve_name(self._scan_topic)}: {latest}"
            )
        trouble = self._sensors.odometry_trouble(now, MAX_AGE_S)
        if trouble:
            raise ObservationError(trouble)
        ranges, first, upright = scan.ranges, scan.angle_min, 1.0
        if scan.rotation is not None:
            upright = conversions.cos_tilt(scan.rotation)
            ranges, first = conversions.from_above(scan, ranges, upright < 0.0)
        if abs(upright) < LEAST_LEVEL_COS:
            raise ObservationError(
                f"the laser in {scan.frame} is tilted: the policy needs a level laser"
            )
        return ranges, scan.sensor_pose[2] + first, scan.angle_increment

    def _pose(self, frame: str, stamp: rospy.Time, now: rospy.Time) -> Pose:
        """Return the robot's pose (x, y, yaw) in `frame` at `stamp`, or else its latest pose."""
        try:
            transform = self._transforms.at(frame, self._base, stamp)
        except ObservationError:
            transform = self._transforms.latest(frame, self._base, now, MAX_AGE_S)
        return conversions.pose_of(transform.transform)

    def _moving(
        self, msg: Optional[Movers], frame: str, now: rospy.Time
    ) -> Tuple[np.ndarray, rospy.Time]:
        """Return moving obstacles (k, 4) x, y, vx, vy in `frame`, and their stamp.

        There are none if the message is stale.
        """
        if msg is None or abs((now - msg.header.stamp).to_sec()) > MAX_AGE_S:
            return np.zeros((0, 4)), rospy.Time()
        x, y, vx, vy = (
            np.array(list(zip(msg.x, msg.y, msg.vx, msg.vy)), dtype=float).reshape(-1, 4).T
        )
        if frame.lstrip("/") != msg.header.frame_id.lstrip("/"):
            place = self._transforms.latest(frame, msg.header.frame_id, now, MAX_AGE_S)
            place = conversions.pose_of(place.transform)
            x, y = transform_point(place, x, y)
            vx, vy = transform_point((0.0, 0.0, place[2]), vx, vy)
        return np.column_stack([x, y, vx, vy]), msg.header.stamp

    def _on_movers(self, msg: Movers) -> None:
        with self._lock:
            self._movers = msg

    def _on_plan(self, msg: Path) -> None:
        if (
            msg.poses
        ):  # move_base publishes an empty plan if planning fails, but keeps the old plan.
            with self._lock:
                self._plan, self._planned = msg, rospy.Time.now()

    def _on_current_goal(self, msg: PoseStamped) -> None:
        with self._lock:
            self._former_goal, self._current_goal = self._current_goal, msg.pose

    def _on_status(self, msg: GoalStatusArray) -> None:
        running = [s.goal_id.id for s in msg.status_list if s.status in _RUNNING]
        with self._lock:
            self._goal_heard = rospy.Time.now()
            if running and running[-1] != self._goal:
                self._goal_since = self._goal_heard
            self._goal = running[-1] if running else None


def _nearer(pose: Any, former: Any, goal: Any) -> bool:
    """Return whether a geometry_msgs/Pose is nearer to the former goal than to the current one.

    False unless both goals exist.
    """
    if former is None or goal is None:
        return False
    away = [
        math.hypot(pose.position.x - g.position.x, pose.position.y - g.position.y)
        for g in (former, goal)
    ]
    return away[0] < away[1]
