"""The velocity node: a method that commands velocities drives the robot in the place of move_base's local planner.

Run by scripts/velocity.py beside a move_base whose own commands go nowhere; launch/velocity_method.launch starts both.
It commands while move_base pursues a goal, and stands otherwise. A command holds until the method's next one: since the
base stops by itself when commands cease, it is sent again and again. docs/tutorials/own_method.md describes such
methods. Parameters: ~method (my_file.py:Class or module:Class) and ~seed.
"""

import rospy
from geometry_msgs.msg import Twist

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.common.progress import Throttled
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.nodes import conversions
from applr_ros1.nodes.applr.inputs import RobotInputs
from applr_ros1.policy import methods
from applr_ros1.policy.decision import COMMAND_PERIOD
from applr_ros1.policy.observation import goal_angle, local_goal, observe


class VelocityNode:
    """Joins inputs and method, and publishes cmd_vel (geometry_msgs/Twist).

    Args:
        method: A Method that commands.
        inputs: Scan, odometry, plan and goal (nodes/applr/inputs.py).
        seed: Of what the method draws; the courses have seed, seed + 1 ...
    """

    def __init__(self, method, inputs, seed=0):
        self.method, self.inputs, self.seed = method, inputs, seed
        self._goal, self._began = None, None  # the goal's id, and when it was first seen
        self._command, self._due = (0.0, 0.0), None  # the method's newest command, and when the next one is due
        self._warn = Throttled(rospy.logwarn)
        self._out = rospy.Publisher("cmd_vel", Twist, queue_size=1)

    def spin(self):
        """A decision every period of ROS time, and its command as often as a planner's, until shutdown with a stop."""
        rospy.on_shutdown(self._stop)
        turn, last = min(self.method.period, COMMAND_PERIOD), rospy.Time(0)
        while not rospy.is_shutdown():
            try:
                now = rospy.Time.now()
                last, before = now, last
                if now < before:  # rospy notices it while it sleeps, and of a simulated clock only
                    raise rospy.exceptions.ROSTimeMovedBackwardsException(now - before)
                self._turn(now)
                left = turn - (rospy.Time.now() - now).to_sec()
                rospy.sleep(max(left, 0.001))
            except rospy.exceptions.ROSTimeMovedBackwardsException:
                self._warn("velocity: the clock jumped back; starting afresh")
                self._stop()
                self.inputs.clear()
                self._goal = None
            except rospy.exceptions.ROSInterruptException:
                return

    def _turn(self, now):
        """The command, where there is a goal; a stop where the goal has ended or no decision can be made."""
        goal = self.inputs.goal(now)
        try:
            if goal != self._goal:
                self._begin(goal, now)
            if goal is not None:
                context = self._context(now)  # the robot stands without it, whether a decision is due or not
                if self._is_due(now):
                    self._command = self.method.command(context)
                self._publish(*self._command)
        except Exception as problem:  # a method is exchangeable: whatever it does, the node goes on
            self._warn(f"velocity: standing: {one_line(problem)}")
            self._command = 0.0, 0.0
            self._stop()

    def _is_due(self, now):
        """Whether the method is to decide now; then its next decision is due a period later."""
        early = (self._due - now).to_sec()
        due = early < 0.5 * min(COMMAND_PERIOD, self.method.period)
        if due:
            self._due = max(self._due, now) + rospy.Duration(self.method.period)
        return due

    def _begin(self, goal, now):
        if goal is None:
            self._stop()
        else:
            self.method.reset(self.seed)
            self.seed += 1
        self._goal, self._began, self._due = goal, now, now

    def _context(self, now):
        layout = self.method.layout
        seen = self.inputs.snapshot(now, layout)
        phi = goal_angle(local_goal(seen.plan, seen.pose, layout.lookahead))
        space = self.method.space
        observation = observe(seen.ranges, phi, space.theta0, space, layout)
        time = (now - self._began).to_sec()
        return methods.Context(observation, seen.ranges, phi, space.theta0, time, *seen.motion, space)

    def _stop(self):
        self._publish(0.0, 0.0)

    def _publish(self, v, w):
        self._out.publish(conversions.twist(v, w))


def main():
    """The command. Raises ApplrError, one line, for parameters that cannot be used."""
    init_node("velocity")
    spec, seed = str(rospy.get_param("~method", "")), number_within("seed", rospy.get_param("~seed", 0), 0, 2**31 - 1)
    if not spec:
        raise ApplrError("~method is empty: give my_file.py:Class or module:Class of a method that commands")
    method = methods.make(spec, commands=True)
    node = VelocityNode(method, RobotInputs(move_base=rospy.resolve_name("move_base")), int(seed))
    rospy.loginfo("velocity: ready, method %s, a command every %g s", spec, method.period)
    with until_shutdown():
        node.spin()
    return 0
