"""Escape motions of the collision monitor for a move_base that makes none, such as the C++ one."""

import time
from typing import NamedTuple

import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Path
from std_msgs.msg import String

from applr_ros1.nodes.conversions import pose_stamped, twist
from tests.support.nodes import FakeJackal
from tests.support.ros import Kept, session, wait_for

pytestmark = pytest.mark.ros
INPUTS = "scan:=front/scan", "odom:=odometry/filtered"


class MoveBase:
    """Fake move_base with a goal 5 m away. Publishes its status, a plan, and `command`."""

    def __init__(self):
        self.command = (0.0, 0.0)
        self.status = None
        self._commands = rospy.Publisher("/move_base/cmd_vel", Twist, queue_size=1)
        self._statuses = rospy.Publisher("/move_base/status", GoalStatusArray, queue_size=1)
        self._plans = rospy.Publisher("/move_base/NavfnROS/plan", Path, queue_size=1)
        self._timer = rospy.Timer(rospy.Duration(0.05), self._tick)

    def ready(self):
        """Return whether the monitor has subscribed to all topics."""
        publishers = (self._commands, self._statuses, self._plans)
        return all(publisher.get_num_connections() for publisher in publishers)

    def _tick(self, _):
        if self.status is not None:
            # As actionlib does, it lists an ended goal for a while.
            ended_goal = GoalStatus(GoalID(id="earlier"), GoalStatus.SUCCEEDED, "")
            current_goal = GoalStatus(GoalID(id="a"), self.status, "")
            self._statuses.publish(GoalStatusArray(status_list=[ended_goal, current_goal]))
        poses = [pose_stamped((x, 0.0, 0.0), "odom", rospy.Time(0)) for x in (0.0, 5.0)]
        self._plans.publish(Path(poses=poses))
        self._commands.publish(twist(*self.command))

    def end(self):
        self._timer.shutdown()
        for publisher in (self._commands, self._statuses, self._plans):
            publisher.unregister()


class Watched:
    """The monitor's node, with its actions and diagnostics so far."""

    def __init__(self):
        options = "cmd_vel_in:=move_base/cmd_vel", "_escape:=true"
        self.node = session().node("applr_ros1.nodes.monitor.node", *INPUTS, *options)
        self.actions = []
        self.statuses = []
        self._subscribers = (
            rospy.Subscriber("/collision_monitor/action", String, self._on_action),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics),
        )

    def _on_action(self, message):
        self.actions.append(message.data)

    def _on_diagnostics(self, message):
        self.statuses.append(message.status[0])

    def end(self):
        for subscriber in self._subscribers:
            subscriber.unregister()
        self.node.end()


class Stack(NamedTuple):
    """A Jackal, a fake move_base, and the monitor between them."""

    jackal: FakeJackal
    planner: MoveBase
    watched: Watched


@pytest.fixture
def stack():
    """Provide a robot at rest without a goal, after half a metre of driving, so that the space
    behind it is known.
    """
    session()
    jackal = FakeJackal()
    planner = MoveBase()
    watched = Watched()
    watched.node.until(planner.ready)
    planner.command = (0.3, 0.0)
    wait_for(lambda: jackal.robot.pose[0] > 0.5, "half a metre")
    planner.command = (0.0, 0.0)
    wait_for(lambda: jackal.robot.twist == (0.0, 0.0), "a stop")
    yield Stack(jackal, planner, watched)
    planner.end()
    jackal.close()
    watched.end()


def moved(jackal, since):
    """Return the commands since a time that are not zero."""
    later_commands = [command for command in jackal.commands if command.stamp > since]
    return [command for command in later_commands if command.velocity != (0.0, 0.0)]


@pytest.mark.fault("17c")
def test_the_monitor_makes_escape_motions_for_a_stuck_planner_until_it_commands(stack):
    jackal, planner, watched = stack
    began = time.time()
    planner.status = GoalStatus.ACTIVE
    wait_for(lambda: moved(jackal, began), "a motion")
    # A planner that stands for 2 s is stuck. The motions are small and slow.
    first_motion = moved(jackal, began)[0]
    assert first_motion.stamp - began > 1.9
    assert abs(first_motion.v) <= 0.1
    assert abs(first_motion.w) <= 0.4

    def warnings():
        return [status for status in watched.statuses if "makes no progress" in status.message]

    wait_for(warnings, "diagnostics")
    assert warnings()[0].level == DiagnosticStatus.WARN
    escape_action = "escape: move_base makes no progress"
    wait_for(
        lambda: any(action.startswith(escape_action) for action in watched.actions), "the action"
    )

    # The planner commands again.
    planner.command = (0.3, 0.0)
    stopwatch = Kept()
    began = time.time()
    wait_for(lambda: jackal.commands[-1].v == 0.3, "the planner's command")
    escape_commands = [command for command in moved(jackal, began) if command.v != 0.3]
    # Two commands may have been under way.
    most_commands = 2 + stopwatch.waiting() / 0.05
    assert len(escape_commands) <= most_commands, "a command ends the escape motion at once"
    assert watched.node.text.count("trying small escape motions") == 1
