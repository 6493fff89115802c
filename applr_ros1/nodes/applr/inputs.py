"""The applr node's inputs: scan, pose, twist, global plan, goal and what moves.

As in move_base, the pose comes from tf and only the twist from the odometry. Callbacks only keep the latest message.
"""

import math
import threading
from typing import NamedTuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1.common.angles import transform_point
from applr_ros1.msg import Movers
from applr_ros1.nodes import conversions
from applr_ros1.nodes.transforms import MAX_AGE_S, LaserMount, Transforms, check_age
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.observation import ObservationError
from applr_ros1.robots import JACKAL

STATUS_AGE_S = 2.0  # without a status for so long, move_base counts as gone
_RUNNING = (GoalStatus.ACTIVE, GoalStatus.PREEMPTING)


class Snapshot(NamedTuple):
    """What the robot sees at a decision, in `frame`, the plan's; the stamps of the messages that this was made from.

    The goal is as move_base has stated it, or the plan's end if the node was started later. There are no movers if no
    recent message has some.
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
        robot: Description of the robot; its laser's yaw counts until tf has the laser's frame.
        move_base: Namespace of move_base, whose status says which goal is pursued.
        prefix: Prefix of the names of the robot's frames.
    """

    def __init__(self, robot=JACKAL, move_base="/move_base", prefix=""):
        self._transforms, self._base = Transforms(), prefix + robot.frames.base
        self._transforms.listen()
        laser = robot.laser
        self._mount = LaserMount(self._transforms, laser.pose[2], laser.no_return)
        names = {"scan": robot.topics.scan, "odometry": robot.topics.odometry, "plan": move_base + "/NavfnROS/plan"}
        self._names = {what: rospy.resolve_name(name) for what, name in names.items()}
        self._lock = threading.Lock()
        self.clear()
        big = {"queue_size": 1, "buff_size": 2**24}  # a small buffer would deliver old messages
        rospy.Subscriber(names["scan"], LaserScan, self._on_scan, **big)
        rospy.Subscriber(names["plan"], conversions.PackedPath, self._on_plan, **big)
        rospy.Subscriber(names["odometry"], Odometry, self._on_odometry, queue_size=1, buff_size=2**20)
        rospy.Subscriber(move_base + "/status", GoalStatusArray, self._on_status, queue_size=1)
        rospy.Subscriber(move_base + "/current_goal", PoseStamped, self._on_current_goal, queue_size=1)
        rospy.Subscriber("applr/tracked", Movers, self._on_movers, queue_size=1)

    def clear(self):
        """Forget everything: the clock jumped back."""
        self._transforms.buffer.clear()
        with self._lock:
            self._scan = self._plan = self._planned = self._movers = self._odometry = None
            self._goal, self._goal_heard, self._goal_since = None, None, None
            self._current_goal = self._former_goal = None  # as move_base stated them

    def goal(self, now):
        """Return the id of the goal that move_base pursues; None when there is none or move_base is gone."""
        with self._lock:
            if self._goal is None or abs((now - self._goal_heard).to_sec()) > STATUS_AGE_S:
                return None
            return self._goal

    def has_lost_move_base(self, now):
        """Return whether move_base, which has published its status before, has not done so for STATUS_AGE_S seconds."""
        with self._lock:
            return self._goal_heard is not None and (now - self._goal_heard).to_sec() > STATUS_AGE_S

    def snapshot(self, now, began):
        """Return a Snapshot at ROS time `now` of a course that began at another.

        Raises ObservationError with one line about what is missing or odd.
        """
        with self._lock:
            scan, plan, planned = self._scan, self._plan, self._planned
            since, goal = self._goal_since, self._current_goal
            former, movers, odometry = self._former_goal, self._movers, self._odometry
        if scan is None:
            raise ObservationError(f"no scan on {self._names['scan']} yet")
        check_age(f"scan on {self._names['scan']}", scan.header.stamp, now)
        if odometry is None:
            raise ObservationError(f"no odometry on {self._names['odometry']} yet")
        check_age(f"odometry on {self._names['odometry']}", odometry.header.stamp, now)
        beams = self._mount.beams(scan, self._base)
        plan = None if plan is None else plan.unpacked()
        early = 0.0 if plan is None or since is None else (since - planned).to_sec()
        if plan is None or early > 0.5 or early > -0.5 and _nearer(plan.poses[-1].pose, former, goal):
            raise ObservationError(f"no global plan for this goal on {self._names['plan']} yet")
        points = np.array([(p.pose.position.x, p.pose.position.y) for p in plan.poses])
        frame = plan.header.frame_id or plan.poses[0].header.frame_id
        goal = conversions.pose_of(plan.poses[-1].pose if goal is None else goal)
        pose, twist = self._pose(frame, scan.header.stamp), odometry.twist.twist
        moving, movers_stamp = self._moving(movers, frame, now)
        time, twist = (now - began).to_sec(), (twist.linear.x, twist.angular.z)
        seen = Seen(beams, time, pose, twist, goal, points, moving)
        return Snapshot(seen, frame, scan.header.stamp, odometry.header.stamp, plan.header.stamp, movers_stamp)

    def _pose(self, frame, stamp):
        """Return the robot's (x, y, yaw) in `frame` at a time, or its latest pose if tf does not reach that time."""
        if self._transforms.has(frame, self._base, stamp):
            return conversions.pose_of(self._transforms.at(frame, self._base, stamp).transform)
        return conversions.pose_of(self._transforms.newest(frame, self._base, MAX_AGE_S))

    def _moving(self, msg, frame, now):
        """Return the tracked movers (k, 4) x, y, vx, vy in `frame` and their stamp; empty if the message is stale."""
        if msg is None or abs((now - msg.header.stamp).to_sec()) > MAX_AGE_S:
            return np.zeros((0, 4)), rospy.Time()
        x, y, vx, vy = np.array(list(zip(msg.x, msg.y, msg.vx, msg.vy)), dtype=float).reshape(-1, 4).T
        if frame.lstrip("/") != msg.header.frame_id.lstrip("/"):
            place = conversions.pose_of(self._transforms.newest(frame, msg.header.frame_id, MAX_AGE_S))
            x, y = transform_point(place, x, y)
            vx, vy = transform_point((0.0, 0.0, place[2]), vx, vy)
        return np.column_stack([x, y, vx, vy]), msg.header.stamp

    def _on_movers(self, msg):
        with self._lock:
            self._movers = msg

    def _on_scan(self, msg):
        msg.header.stamp = msg.header.stamp or rospy.Time.now()  # 0: the driver gives none
        with self._lock:
            self._scan = msg

    def _on_odometry(self, msg):
        with self._lock:
            self._odometry = msg

    def _on_plan(self, msg):
        if msg.straight is not None:  # a failed plan is published empty: the old one stands
            with self._lock:
                self._plan, self._planned = msg, rospy.Time.now()

    def _on_current_goal(self, msg):
        with self._lock:
            self._former_goal, self._current_goal = self._current_goal, msg.pose

    def _on_status(self, msg):
        running = [s.goal_id.id for s in msg.status_list if s.status in _RUNNING]
        with self._lock:
            self._goal_heard = rospy.Time.now()
            if running and running[-1] != self._goal:
                self._goal_since = self._goal_heard
            self._goal = running[-1] if running else None


def _nearer(pose, former, goal):
    """Return whether a geometry_msgs/Pose lies nearer to the former goal than to the present one, if there are two."""
    if former is None or goal is None:
        return False
    away = [math.hypot(pose.position.x - g.position.x, pose.position.y - g.position.y) for g in (former, goal)]
    return away[0] < away[1]
