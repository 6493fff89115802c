"""Tests of the collision monitor's node between a planner and an ideal robot, without a ROS master.

tests/live/test_collision_monitor_node.py has what needs processes: its guard, silence and the end.
"""

import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Path

from applr_ros1.common.messages import twist_of
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.nodes.conversions import pose_stamped, twist
from applr_ros1.nodes.monitor import node as monitor_node
from applr_ros1.nodes.monitor.node import ESCAPE, CollisionMonitorNode
from applr_ros1.robots import JACKAL
from tests.support.nodes import mount_laser, scan_message, sense
from tests.support.robots import ToyRobot

pytest_plugins = ("tests.support.offline_ros",)
CYCLE_S = 0.05
STOP = (0.0, 0.0)


class Driven:
    """Monitor's node whose commands move a robot, in cycles of CYCLE_S."""

    def __init__(self, ros, more_scans=(), escape=False):
        self.ros = ros
        self.robot = ToyRobot()
        self.status = None  # of move_base's goal
        self.latest_end = ros.now + 60.0  # [s]
        settings = MonitorSettings.of(JACKAL)
        self.node = CollisionMonitorNode(settings, JACKAL, "", list(more_scans), escape)
        mount_laser(ros)

    def cycle(self, command, more_scans=()):
        """Command (v, w), drive for a cycle, and return what the base got."""
        self.ros.now += CYCLE_S
        assert self.ros.now < self.latest_end, "it waits in vain"
        stamp = self.ros.time
        sense(self.ros, self.robot, ["front/scan", *more_scans])
        if self.status is not None:
            # As actionlib does, move_base lists an ended goal for a while.
            ended_goal = GoalStatus(GoalID(id="earlier"), GoalStatus.SUCCEEDED, "")
            current_goal = GoalStatus(GoalID(id="a"), self.status, "")
            self.ros.callbacks["move_base/status"](
                GoalStatusArray(status_list=[ended_goal, current_goal])
            )
            poses = [pose_stamped((x, 0.0, 0.0), "odom", stamp) for x in (0.0, 5.0)]
            self.ros.callbacks["move_base/NavfnROS/plan"](Path(poses=poses))
        self.ros.callbacks["cmd_vel_in"](twist(*command))
        sent = twist_of(self.ros.published["cmd_vel"][-1])
        self.robot.drive(sent, CYCLE_S)
        return sent

    @property
    def action(self):
        """Latest action, and its reason."""
        return self.ros.published["~action"][-1].data


@pytest.fixture
def driven(offline_ros, monkeypatch):
    """Return driven(**options), which starts a node."""
    # The class of the commands derives from rospy's own.
    monkeypatch.setattr(
        monitor_node, "BaseCommands", lambda topic, latch: rospy.Publisher(topic, Twist)
    )
    return lambda **options: Driven(offline_ros, **options)


@pytest.mark.fault("17c")
def test_the_monitor_makes_escape_motions_for_a_stuck_planner_until_it_commands(driven):
    # Given: a robot at rest after half a metre, so that the space behind it is known
    stuck = driven(escape=True)
    while stuck.robot.pose[0] < 0.5:
        stuck.cycle((0.3, 0.0))
    while stuck.robot.twist != STOP:
        stuck.cycle(STOP)
    for _ in range(60):
        assert stuck.cycle(STOP) == STOP, "no goal is active"

    # When: move_base gets a goal and stands
    stuck.status = GoalStatus.ACTIVE
    waited_s = 0.0
    v, w = stuck.cycle(STOP)
    while (v, w) == STOP:
        waited_s += CYCLE_S
        assert waited_s < 3.0
        v, w = stuck.cycle(STOP)

    # Then: after 2 s, a small and slow motion takes the place of its commands
    assert waited_s > 1.9
    assert abs(v) <= 0.1
    assert abs(w) <= 0.4
    assert stuck.action.startswith(f"{ESCAPE}: move_base makes no progress")
    (line,) = stuck.ros.log["warn"]
    assert line.endswith("trying small escape motions")

    # A command ends it at once.
    assert stuck.cycle((0.3, 0.0)) == (0.3, 0.0)


def test_a_silent_second_laser_stops_the_base_until_its_scans_arrive(driven):
    rear = "rear/scan"
    two = driven(more_scans=[rear])
    two.cycle((0.1, 0.0))
    assert f"{rear}: no scan has arrived yet" in two.action
    for _ in range(20):
        two.cycle((0.1, 0.0), [rear])
    assert two.action == "pass"
    for _ in range(12):
        two.cycle((0.1, 0.0))
    assert two.action.startswith(f"stop: the latest scan on {rear} is")
    # The age is that of the silent laser.
    assert ", 0.55 s ago" in two.action or ", 0.60 s ago" in two.action


def test_a_monitor_that_fails_stops_the_base(driven):
    one = driven()
    one.node.monitor.filter = None
    assert one.cycle((0.1, 0.0)) == STOP
    assert "please report it" in one.action


@pytest.mark.fault("10b")
def test_one_scan_of_another_frame_stops_the_base_only_for_seconds(driven, measured):
    """The line in the log names the frame and the node that has published the scan."""
    one = driven()
    one.cycle((0.1, 0.0))
    stray = scan_message(one.robot.ranges(), one.ros.time)
    stray.header.frame_id = "base_link"
    stray._connection_header = {"callerid": "/stray_driver"}
    one.ros.callbacks["front/scan"](stray)
    while "stop: the latest scan of frame base_link is" not in one.action:
        one.cycle(STOP)
    stopped_s = 0.0
    while one.action != "pass":
        one.cycle(STOP)
        stopped_s += CYCLE_S
        assert stopped_s < 10.0
    measured("commands pass after", stopped_s, "s")
    (line,) = one.ros.log["err"]
    scans = "scan of frame 'base_link' on /front/scan"
    assert f"/stray_driver has sent no {scans} for 5 s (1 before)" in line
