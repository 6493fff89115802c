"""Publishers of the applr node: heartbeat, decisions, parameters and diagnostics.

Used by node.py.
"""

from __future__ import annotations

from math import atan2
from typing import Any, Mapping

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header, Time

from applr_ros1.common.angles import transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.ros_node import policy_status
from applr_ros1.drives.columns import fields_of_parameters, fields_of_seen
from applr_ros1.msg import Decision, Movers, Parameters
from applr_ros1.nodes import conversions
from applr_ros1.policy.observation import local_goal
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from applr_ros1.policy.supervisor import Ruling
from applr_ros1.robots import JACKAL, Robot


class ApplrTopics:
    """Publishers for the topics in <namespace>/applr, and for the shared /diagnostics."""

    def __init__(self, robot: Robot = JACKAL):
        self._space = space_of(robot)
        self._robot = robot
        self._name = policy_status()
        self._heartbeat = rospy.Publisher("applr/heartbeat", Time, queue_size=1)
        self._decision = rospy.Publisher("applr/decision", Decision, queue_size=5)
        self._course_end = rospy.Publisher("applr/course_end", Decision, queue_size=5)
        self._local_goal = rospy.Publisher("applr/local_goal", PoseStamped, queue_size=1)
        self._parameters = rospy.Publisher("applr/parameters", Parameters, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)

    def heartbeat(self, now: rospy.Time) -> None:
        """Publish a heartbeat, due as Supervisor.is_beat_due says.

        Without it, this package's move_base restores its start-up values.
        """
        self._heartbeat.publish(Time(now))

    def decision(self, ruling: Ruling, now: Any, goal: Any, snapshot: Any, context: Any) -> None:
        """Publish a decision: Context, stamps of its inputs, and what was decided."""
        self._decision.publish(self._message(ruling, now, goal, snapshot, context))

        # Displays show the local goal as an arrow from the robot to it.
        goal_ahead, goal_left = local_goal(context.plan, context.pose, context.layout.lookahead)
        arrow_x, arrow_y = transform_point(context.pose, goal_ahead, goal_left)
        arrow_yaw = context.pose[2] + atan2(goal_left, goal_ahead)
        arrow_pose = (arrow_x, arrow_y, arrow_yaw)
        arrow = conversions.pose_stamped(arrow_pose, snapshot.frame, snapshot.odom_stamp)
        self._local_goal.publish(arrow)

    def course_end(self, number: int, now: Any, goal: Any, snapshot: Any, context: Any) -> None:
        """Publish the observation at the end of a course."""
        no_ruling = Ruling(number, None, "", False, None)
        self._course_end.publish(self._message(no_ruling, now, goal, snapshot, context))

    def _message(self, ruling: Ruling, now: Any, goal: str, snapshot: Any, context: Any) -> Any:
        """Return an applr_ros1/Decision with all inputs, from which a dataset can be made."""
        seen_fields = fields_of_seen(snapshot.seen, self._robot)
        mover_fields = seen_fields.pop("movers")
        movers_header = Header(0, snapshot.movers_stamp, snapshot.frame)
        return Decision(
            header=Header(0, now, snapshot.frame),
            number=ruling.number,
            goal=goal,
            refused=ruling.refused,
            cleared=ruling.clears_costmaps,
            scan=snapshot.scan_stamp,
            odometry=snapshot.odom_stamp,
            plan=snapshot.plan_stamp,
            movers=Movers(header=movers_header, **mover_fields),
            before=parameters_message(context.theta, now, self._space),
            after=parameters_message(ruling.theta, now, self._space),
            **seen_fields,
        )

    def parameters(self, theta: Array, now: rospy.Time, multipliers: Array) -> None:
        """Publish the current parameters (n,) at ROS time `now`, and their multipliers (n,)."""
        self._parameters.publish(parameters_message(theta, now, self._space, multipliers))

    def diagnostics(
        self, now: rospy.Time, trouble: str, lost: bool, doing: str, values: Mapping[str, Any]
    ) -> None:
        """Publish the node's state.

        Args:
            now: ROS time.
            trouble: Problem in one line, or "".
            lost: Whether theta_0 has replaced the method.
            doing: Activity of the node, such as "idle: no goal"; shown if there is no problem.
            values: {key: value} to show.
        """
        # The robot drives on in each case: ERROR means without its method.
        level = DiagnosticStatus.OK
        if trouble:
            level = DiagnosticStatus.WARN
        if lost:
            level = DiagnosticStatus.ERROR
        message = conversions.diagnostics(self._name, level, trouble or doing, values, now)
        self._diagnostics.publish(message)


def parameters_message(
    theta: Any, stamp: Any, space: Space = SPACE, multipliers: Any = None
) -> Parameters:
    """Return an applr_ros1/Parameters of theta (n,).

    It has no names and values if theta is None. The multipliers (n,) by which the node scales the
    parameters before it sends them are ones if they are None.
    """
    values = {}
    if theta is not None:
        values = dict(zip(space.names, np.asarray(theta, np.float64).tolist()))
    fields = fields_of_parameters(values, space)
    if values and multipliers is not None:
        fields["multipliers"] = multipliers.tolist()
    return Parameters(header=Header(0, stamp, ""), **fields)
