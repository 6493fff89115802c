"""What the applr node publishes: heartbeat, decisions and observations (for bags), parameters, diagnostics.

Called by nodes/applr_node.py. What bags need is published twice: as messages of this package, with stamps and fields to
plot, and as standard messages (JSON, arrays), which can be read without this package.
"""

import json
from math import atan2, nan

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Quaternion
from std_msgs.msg import Float32MultiArray, Float64MultiArray, MultiArrayDimension, String, Time

from applr_ros1.common.angles import place, quaternion_of
from applr_ros1.msg import Decision, Parameters
from applr_ros1.policy.parameter_space import SPACE, Space


class ApplrTopics:
    """Publishers below applr in the node's namespace, and /diagnostics, which all robots share.

    Args:
        prefix: What the topics' names begin with.
        space: The parameters.
    """

    def __init__(self, prefix="applr", space: Space = SPACE):
        self._space = space
        self._name = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self._heartbeat = rospy.Publisher(prefix + "/heartbeat", Time, queue_size=1)
        self._observation = rospy.Publisher(prefix + "/observation", Float32MultiArray, queue_size=5)
        self._decision = rospy.Publisher(prefix + "/decision", String, queue_size=5)
        self._local_goal = rospy.Publisher(prefix + "/local_goal", PoseStamped, queue_size=1)
        self._parameters = rospy.Publisher(prefix + "/parameters", Float64MultiArray, queue_size=1, latch=True)
        self._weights = rospy.Publisher(prefix + "/weights", String, queue_size=1, latch=True)
        self._typed_decision = rospy.Publisher(prefix + "/typed/decision", Decision, queue_size=5)
        self._typed_parameters = rospy.Publisher(prefix + "/typed/parameters", Parameters, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)

    def heartbeat(self, now):
        """Once a period and at least every 2 s while the node lives; our move_base restores its start-up without it."""
        self._heartbeat.publish(Time(now))

    def decision(self, number, now, goal, seen, target, obs, theta_prev, theta, refused):
        """One decision: the observation as the actor got it, and JSON that says which messages it came from."""
        message = Float32MultiArray(data=obs)
        message.layout.dim = [MultiArrayDimension(f"observation {number}", len(obs), len(obs))]
        self._observation.publish(message)
        self._decision.publish(
            json.dumps(
                {
                    "number": number,
                    "stamp": str(now),
                    "goal": goal,
                    "scan": str(seen.scan_stamp),
                    "odometry": str(seen.odom_stamp),
                    "plan": str(seen.plan_stamp),
                    "frame": seen.frame,
                    "pose": seen.pose,
                    "local_goal": target,
                    "theta_prev": self._space.as_dict(theta_prev),
                    "theta": None if theta is None else self._space.as_dict(theta),
                    "refused": refused,
                }
            )
        )
        self._local_goal.publish(_local_goal(seen, target))
        typed = Decision(number=number, goal=goal, observation=obs, refused=refused)
        typed.header.stamp, typed.header.frame_id = now, seen.frame
        typed.scan, typed.odometry, typed.plan = seen.scan_stamp, seen.odom_stamp, seen.plan_stamp
        typed.x, typed.y, typed.yaw = seen.pose
        typed.local_goal_x, typed.local_goal_y = target
        typed.before, typed.after = (
            parameters_message(theta_prev, now, self._space),
            parameters_message(theta, now, self._space),
        )
        self._typed_decision.publish(typed)

    def weights(self, multipliers):
        """Publish {name: factor} of the parameters that the planner gets multiplied, as JSON; {} for none.

        What the planner's parameter_updates say, divided by these, is the parameter set.
        """
        self._weights.publish(json.dumps(multipliers))

    def parameters(self, theta, now):
        """Publish theta (n,), the parameters in force at ROS time `now`."""
        self._typed_parameters.publish(parameters_message(theta, now, self._space))
        message = Float64MultiArray(data=theta)
        message.layout.dim = [MultiArrayDimension(",".join(self._space.names), len(theta), len(theta))]
        self._parameters.publish(message)

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
        status = DiagnosticStatus(
            level=level,
            name=self._name,
            hardware_id="none",
            message=trouble or doing,
            values=[KeyValue(key, str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = now
        self._diagnostics.publish(message)


def parameters_message(theta, stamp, space=SPACE):
    """An applr_ros1/Parameters of theta (n,); without names and values for None."""
    message = Parameters()
    message.header.stamp = stamp
    fields = [name for name in message.__slots__ if name not in ("header", "names", "values")]
    for name in fields:
        setattr(message, name, nan)
    if theta is not None:
        message.names, message.values = list(space.names), [float(value) for value in theta]
        for name, value in zip(message.names, message.values):
            aliases = (name,) + space.targets[name][0].names
            for alias in [alias for alias in aliases if alias in fields][:1]:
                setattr(message, alias, value)
    return message


def _local_goal(seen, target):
    """The local goal (robot frame) as a pose in the plan's frame, heading from the robot towards it."""
    heading = seen.pose[2] + atan2(target[1], target[0])
    message = PoseStamped()
    message.header.frame_id, message.header.stamp = seen.frame, seen.odom_stamp
    message.pose.position.x, message.pose.position.y = place(seen.pose, *target)
    message.pose.orientation = Quaternion(*quaternion_of(heading))
    return message
