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
from actionlib_msgs.msg import GoalStatusArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from applr_ros1.common.angles import Pose, transform_motions
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.messages import pose_of
from applr_ros1.common.ros_node import LARGE_BUFFER
from applr_ros1.common.scan import LEAST_LEVEL_COS, from_above
from applr_ros1.msg import Movers
from applr_ros1.nodes import conversions
from applr_ros1.nodes.sensors import Sensors
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.layout import ObservationError
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.senses.standing import PURSUED, STATUS_LOST_S, USABLE_AGE_S

SIMULTANEOUS_S = 0.5  # largest time between a plan and the first status of its goal [s]


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
        self._base = prefix + robot.frames.base
        self._scan_topic = robot.topics.scan
        self._sensors = Sensors.of_lasers(robot, prefix, self._base)
        self._transforms = self._sensors.transforms
        plan_topic = move_base + "/NavfnROS/plan"
        goal_topic = move_base + "/current_goal"
        self._plan_topic = rospy.resolve_name(plan_topic)
        self._lock = threading.Lock()  # guards the messages
        self.drop_messages()
        rospy.Subscriber(plan_topic, Path, self._on_plan, queue_size=1, buff_size=LARGE_BUFFER)
        rospy.Subscriber(move_base + "/status", GoalStatusArray, self._on_status, queue_size=1)
        rospy.Subscriber(goal_topic, PoseStamped, self._on_current_goal, queue_size=1)
        rospy.Subscriber("applr/tracked", Movers, self._on_movers, queue_size=1)

    def drop_messages(self) -> None:
        """Drop all data after the clock jumped back."""
        self._sensors.forget()
        with self._lock:
            self._scan: Any = None
            self._plan: Any = None
            self._plan_time: Any = None  # arrival of the plan
            self._movers: Any = None
            self._goal: Any = None  # id of the goal
            self._status_time: Any = None  # arrival of the latest status
            self._goal_since: Any = None  # arrival of the first status of the goal
            # Poses that move_base has published
            self._current_goal: Any = None
            self._former_goal: Any = None

    def goal(self, now: rospy.Time) -> Any:
        """Return the id of move_base's goal, or None if there is none or move_base is gone."""
        with self._lock:
            if self._goal is None or abs((now - self._status_time).to_sec()) > STATUS_LOST_S:
                return None
            return self._goal

    def has_lost_move_base(self, now: rospy.Time) -> bool:
        """Return whether move_base has published its status, but not for STATUS_LOST_S seconds."""
        with self._lock:
            if self._status_time is None:
                return False
            return bool((now - self._status_time).to_sec() > STATUS_LOST_S)

    def snapshot(self, now: rospy.Time, began: float) -> Snapshot:
        """Return a Snapshot at ROS time `now` of a course that began at ROS time `began` [s].

        Raises:
            ObservationError: An input is missing or invalid; one line says which.
        """
        # The inputs of one decision belong together: callbacks may replace them from here on.
        with self._lock:
            plan = self._plan
            movers_message = self._movers
            goal_pose = self._current_goal
            is_for_goal = self._plan_is_for_goal()
        beams = self._beams(now)
        if not is_for_goal:
            raise ObservationError(f"no global plan for this goal on {self._plan_topic} yet")
        stamps = self._sensors.stamps()
        frame = plan.header.frame_id or plan.poses[0].header.frame_id
        if goal_pose is None:
            goal_pose = plan.poses[-1].pose
        moving_obstacles, movers_stamp = self._moving(movers_message, frame, now)
        seen = Seen(
            beams,
            now.to_sec() - began,
            self._pose(frame, stamps["scan"], now),
            self._sensors.twist,
            pose_of(goal_pose),
            conversions.path_points(plan.poses),
            moving_obstacles,
        )
        return Snapshot(
            seen, frame, stamps["scan"], stamps["twist"], plan.header.stamp, movers_stamp
        )

    def _plan_is_for_goal(self) -> bool:
        """Return whether the latest plan belongs to the present goal, not to the one before.

        Plan and status come on topics of their own, within half a second of each other. Within this
        time the end of the plan decides.
        """
        if self._plan is None:
            return False
        if self._goal_since is None:
            plan_lead = 0.0
        else:
            plan_lead = (self._goal_since - self._plan_time).to_sec()
        if plan_lead > SIMULTANEOUS_S:
            return False
        end_pose = self._plan.poses[-1].pose
        is_simultaneous = plan_lead > -SIMULTANEOUS_S
        is_for_former = _is_nearer(end_pose, self._former_goal, self._current_goal)
        return not (is_simultaneous and is_for_former)

    def _beams(self, now: rospy.Time) -> Tuple[Array32, float, float]:
        """Return (ranges [m], first angle, increment [rad]) of the latest scan for the robot."""
        scan = self._sensors.observations().get(self._scan_topic, self._scan)
        self._scan = scan
        if scan is None or (now - self._sensors.stamps()["scan"]).to_sec() > USABLE_AGE_S:
            latest = self._sensors.describe_latest(self._scan_topic)
            problem = f"no usable scan on {rospy.resolve_name(self._scan_topic)}"
            raise ObservationError(f"{problem}: {latest}")
        trouble = self._sensors.odometry_trouble(now, USABLE_AGE_S)
        if trouble:
            raise ObservationError(trouble)

        # A level scan has no rotation. A laser may hang upside down, or tilt with the robot.
        ranges = scan.distances
        first_angle = scan.angle_min
        if scan.rotation is not None:
            tilt_cosine = conversions.cos_tilt(scan.rotation)
            if abs(tilt_cosine) < LEAST_LEVEL_COS:
                problem = f"the laser in {scan.frame} is tilted"
                raise ObservationError(f"{problem}: the policy needs a level laser")
            if tilt_cosine < 0.0:
                ranges, first_angle = from_above(ranges, first_angle, scan.angle_increment)
        return ranges, scan.sensor_pose[2] + first_angle, scan.angle_increment

    def _pose(self, frame: str, stamp: rospy.Time, now: rospy.Time) -> Pose:
        """Return the robot's pose (x, y, yaw) in `frame` at `stamp`, or else its latest pose."""
        # A scan may be older than tf remembers, or newer than localisation.
        try:
            transform = self._transforms.at(frame, self._base, stamp)
        except ObservationError:
            transform = self._transforms.latest(frame, self._base, now, USABLE_AGE_S)
        return pose_of(transform.transform)

    def _moving(
        self, message: Optional[Movers], frame: str, now: rospy.Time
    ) -> Tuple[Array, rospy.Time]:
        """Return moving obstacles (k, 4) x, y, vx, vy in `frame`, and their stamp.

        There are none if the message is stale.
        """
        if message is None or abs((now - message.header.stamp).to_sec()) > USABLE_AGE_S:
            return np.zeros((0, 4)), rospy.Time()
        columns = [message.x, message.y, message.vx, message.vy]
        motions = np.column_stack(columns).astype(float)
        if frame.lstrip("/") != message.header.frame_id.lstrip("/"):
            transform = self._transforms.latest(frame, message.header.frame_id, now, USABLE_AGE_S)
            motions = transform_motions(pose_of(transform.transform), motions)
        return motions, message.header.stamp

    def _on_movers(self, message: Movers) -> None:
        with self._lock:
            self._movers = message

    def _on_plan(self, message: Path) -> None:
        # move_base publishes an empty plan if planning fails, but keeps the old plan.
        if message.poses:
            with self._lock:
                self._plan = message
                self._plan_time = rospy.Time.now()

    def _on_current_goal(self, message: PoseStamped) -> None:
        with self._lock:
            self._former_goal = self._current_goal
            self._current_goal = message.pose

    def _on_status(self, message: GoalStatusArray) -> None:
        goal_id = conversions.goal_in(message, PURSUED)
        with self._lock:
            self._status_time = rospy.Time.now()
            if goal_id not in (None, self._goal):
                self._goal_since = self._status_time
            self._goal = goal_id


def _is_nearer(pose: Any, former: Any, goal: Any) -> bool:
    """Return whether a geometry_msgs/Pose is nearer to the former goal than to the current one.

    False unless both goals exist.
    """
    if former is None or goal is None:
        return False
    position = (pose.position.x, pose.position.y)
    from_former = math.dist(position, (former.position.x, former.position.y))
    from_goal = math.dist(position, (goal.position.x, goal.position.y))
    return from_former < from_goal
