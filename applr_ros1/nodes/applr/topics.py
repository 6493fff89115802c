"""Topics that the applr node publishes: heartbeat, decisions and parameters, diagnostics.

Called by node.py.
"""

from math import atan2, nan

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header, Time

from applr_ros1.common.angles import transform_point
from applr_ros1.msg import Decision, Movers, Parameters
from applr_ros1.nodes import conversions
from applr_ros1.policy.observation import FARTHEST_M, beginning, local_goal
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.robots import JACKAL, Robot


class ApplrTopics:
    """Publishers below applr in the node's namespace, and /diagnostics, which all robots share."""

    def __init__(self, robot: Robot = JACKAL):
        self._space, self._farthest = space_of(robot), FARTHEST_M * robot.world_scale
        self._name = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self._heartbeat = rospy.Publisher("applr/heartbeat", Time, queue_size=1)
        self._decision = rospy.Publisher("applr/decision", Decision, queue_size=5)
        self._course_end = rospy.Publisher("applr/course_end", Decision, queue_size=5)
        self._local_goal = rospy.Publisher("applr/local_goal", PoseStamped, queue_size=1)
        self._parameters = rospy.Publisher("applr/parameters", Parameters, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)

    def heartbeat(self, now):
        """Publish that the node lives, at least every 2 s; without it our move_base restores its start-up values."""
        self._heartbeat.publish(Time(now))

    def decision(self, number, now, goal, snapshot, context, theta, refused):
        """Publish one decision: the Context that it was made in, and which messages that came from."""
        self._decision.publish(self._message(number, now, goal, snapshot, context, theta, refused))
        target = local_goal(context.plan, context.pose, context.layout.lookahead)
        pose = *transform_point(context.pose, *target), context.pose[2] + atan2(target[1], target[0])
        self._local_goal.publish(conversions.pose_stamped(pose, snapshot.frame, snapshot.odom_stamp))

    def course_end(self, number, now, goal, snapshot, context):
        """Publish what came of the last decision of a course."""
        self._course_end.publish(self._message(number, now, goal, snapshot, context, None, ""))

    def _message(self, number, now, goal, snapshot, context, theta, refused):
        message = Decision(number=number, goal=goal, elapsed=context.time, refused=refused)
        message.header.stamp, message.header.frame_id = now, snapshot.frame
        message.scan, message.odometry, message.plan = snapshot.scan_stamp, snapshot.odom_stamp, snapshot.plan_stamp
        message.x, message.y, message.yaw = context.pose
        message.v, message.w = context.twist
        message.goal_x, message.goal_y, message.goal_yaw = context.goal
        message.ranges, message.angle_min, message.angle_increment = snapshot.seen.scan
        message.plan_x, message.plan_y = beginning(context.plan, context.pose, self._farthest).T
        message.movers = Movers(Header(0, snapshot.movers_stamp, snapshot.frame), *context.movers.T, [])
        message.before, message.after = (parameters_message(t, now, self._space) for t in (context.theta, theta))
        return message

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
