"""Topics that the applr node publishes: heartbeat, decisions and parameters, diagnostics.

Called by node.py.
"""

from math import atan2, nan

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Time

from applr_ros1.common.angles import transform_point
from applr_ros1.msg import Decision, Parameters
from applr_ros1.nodes import conversions
from applr_ros1.policy.parameter_space import SPACE, Space


class ApplrTopics:
    """Publishers below applr in the node's namespace, and /diagnostics, which all robots share."""

    def __init__(self, space: Space = SPACE):
        self._space = space
        self._name = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self._heartbeat = rospy.Publisher("applr/heartbeat", Time, queue_size=1)
        self._decision = rospy.Publisher("applr/decision", Decision, queue_size=5)
        self._local_goal = rospy.Publisher("applr/local_goal", PoseStamped, queue_size=1)
        self._parameters = rospy.Publisher("applr/parameters", Parameters, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)

    def heartbeat(self, now):
        """Publish that the node lives, at least every 2 s; without it our move_base restores its start-up values."""
        self._heartbeat.publish(Time(now))

    def decision(self, number, now, goal, snapshot, target, obs, theta_prev, theta, refused):
        """Publish one decision: the observation in the paper's form, and which messages it came from."""
        message = Decision(number=number, goal=goal, observation=obs, refused=refused)
        message.header.stamp, message.header.frame_id = now, snapshot.frame
        message.scan, message.odometry, message.plan = snapshot.scan_stamp, snapshot.odom_stamp, snapshot.plan_stamp
        message.movers = snapshot.movers_stamp
        message.x, message.y, message.yaw = snapshot.pose
        message.local_goal_x, message.local_goal_y = target
        message.before, message.after = (parameters_message(t, now, self._space) for t in (theta_prev, theta))
        self._decision.publish(message)
        pose = *transform_point(snapshot.pose, *target), snapshot.pose[2] + atan2(target[1], target[0])
        self._local_goal.publish(conversions.pose_stamped(pose, snapshot.frame, snapshot.odom_stamp))

    def parameters(self, theta, now, multipliers=None):
        """Publish theta (n,), the parameters in force at ROS time `now`.

        multipliers: (n,), by which the planner gets them multiplied; None for ones.
        """
        self._parameters.publish(parameters_message(theta, now, self._space, multipliers))

    def diagnostics(self, now, trouble, lost, doing, values):
        """Publish the node's state.

        Args:
            now: ROS time.
            trouble: One line, or "" for none.
            lost: Whether the method does not drive, but theta_0 does.
            doing: What the node does when there is no trouble, such as "idle: no goal".
            values: {key: value} to show.
        """
        level = DiagnosticStatus.ERROR if lost else DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK
        self._diagnostics.publish(conversions.diagnostics(self._name, level, trouble or doing, values, now))


def parameters_message(theta, stamp, space=SPACE, multipliers=None):
    """Return an applr_ros1/Parameters of theta (n,); without names and values for None."""
    message = Parameters()
    message.header.stamp = stamp
    fields = [name for name in message.__slots__ if name not in ("header", "names", "values", "multipliers")]
    for name in fields:
        setattr(message, name, nan)
    if theta is not None:
        message.names, message.values = list(space.names), [float(value) for value in theta]
        message.multipliers = [1.0] * len(space) if multipliers is None else [float(factor) for factor in multipliers]
        for name, value in zip(message.names, message.values):
            aliases = (name,) + space.targets[name][0].names
            for alias in [alias for alias in aliases if alias in fields][:1]:
                setattr(message, alias, value)
    return message
