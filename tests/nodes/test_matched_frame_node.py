"""Tests of the frame of matched poses in the nodes, without a ROS master: the monitor's transforms,
the planner's parameters, and goals before the first transform.
"""

from unittest.mock import create_autospec

import pytest
import rospy

from applr_ros1.common.angles import compose
from applr_ros1.common.messages import pose_of
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.nodes import conversions
from applr_ros1.nodes.monitor import node as monitor_node
from applr_ros1.nodes.monitor.frame_broadcaster import FrameBroadcaster
from applr_ros1.nodes.monitor.node import CollisionMonitorNode
from applr_ros1.nodes.move_base.frame_restart import FrameRestart
from applr_ros1.nodes.robot_parameters import with_robot
from applr_ros1.planner.parameters.check import check
from applr_ros1.robots import JACKAL
from tests.support.move_base_node import lone_node

pytest_plugins = ("tests.support.offline_ros",)
CORRECTION = (0.5, -0.2, 0.3)


@pytest.fixture
def broadcast(offline_ros):
    """Return a frame, and the messages that it has broadcast so far."""
    return FrameBroadcaster("robot1/odom", "robot1/matched"), offline_ros.published["/tf"]


def test_the_frame_is_a_child_of_the_odometrys_which_may_have_another_parent(broadcast):
    frame, messages = broadcast
    frame.broadcast(rospy.Time(10), CORRECTION)
    ((transform,),) = (message.transforms for message in messages)
    assert transform.header.frame_id == "robot1/odom"
    assert transform.child_frame_id == "robot1/matched"
    assert transform.header.stamp == rospy.Time(10, 100_000_000)
    matched_in_odometry = pose_of(transform.transform)
    assert compose(CORRECTION, matched_in_odometry) == pytest.approx((0.0, 0.0, 0.0))


def test_it_is_broadcast_twenty_times_a_second_with_or_without_scans(broadcast):
    frame, messages = broadcast
    for centiseconds in range(100):
        frame.broadcast(rospy.Time(10, centiseconds * 10_000_000), CORRECTION)
    assert len(messages) == 20
    # A wall clock is set back a little, and a clock jumps.
    for is_jump, seconds in ((False, 10), (True, 3)):
        if is_jump:
            frame.forget()
        frame.broadcast(rospy.Time(seconds), CORRECTION)
        (transform,) = messages[-1].transforms
        assert transform.header.stamp == rospy.Time(seconds, 100_000_000)


def test_nothing_is_broadcast_before_a_simulated_clock_starts(broadcast):
    frame, messages = broadcast
    frame.broadcast(rospy.Time(0), CORRECTION)
    assert messages == []


def global_frame(**parameters):
    """Return the frame of the global costmap of a node with private parameters."""
    tree, _ = with_robot({"robot": "turtlebot3_waffle_pi", **parameters})
    assert check(tree) == []
    return tree["global_costmap"]["global_frame"]


def test_the_global_costmap_is_in_the_frame_unless_there_is_a_map_or_the_user_says_otherwise():
    assert global_frame() == global_frame(matched=False) == "odom"
    assert global_frame(matched=True) == "matched"
    assert global_frame(matched=True, tf_prefix="robot1") == "robot1/matched"
    assert global_frame(matched=True, map=True) == "map"
    assert global_frame(matched=True, global_costmap={"global_frame": "odom"}) == "odom"


@pytest.mark.parametrize(
    ("awaits_monitor", "knows_frame", "is_taken"),
    [(True, False, False), (True, True, True), (False, False, True)],
)
def test_a_goal_waits_for_the_monitors_first_transform(
    awaits_monitor, knows_frame, is_taken, monkeypatch
):
    node, ros = lone_node(monkeypatch, robot="turtlebot3_waffle_pi", matched=awaits_monitor)
    node.sensors.place_of.return_value = (0.0, 0.0, 0.0) if knows_frame else None
    node.goals.is_new_goal_available.return_value = True
    node.goals.is_active.return_value = False
    goal = conversions.pose_stamped((1.0, 2.0, 0.0), "odom", rospy.Time(9))
    node.goals.accept_new_goal.return_value.target_pose = goal
    node.sensors.to_global.return_value = (1.0, 2.0, 0.0)
    node.cycle(rospy.Time(10))
    assert node.goals.accept_new_goal.called == node.move_base.set_goal.called == is_taken
    line = "a goal waits for frame matched of the collision monitor: start the monitor"
    assert ros.log["warn"] == ([] if is_taken else [line])


def test_a_monitor_that_starts_again_begins_another_frame():
    restart = FrameRestart()
    assert restart.jump(10.0, CORRECTION) is None
    # A scan corrects the odometry, and later tf is late.
    assert restart.jump(10.05, (0.56, -0.2, 0.3)) is None
    assert restart.jump(13.0, (0.55, -0.2, 0.3)) is None
    # The odometry goes on, so that a place in the old frame is known in the new one.
    change = restart.jump(16.0, (0.0, 0.0, 0.0))
    place_in_old_frame = compose((0.55, -0.2, 0.3), (2.0, 1.0, 0.4))
    assert compose(change, place_in_old_frame) == pytest.approx((2.0, 1.0, 0.4))
    assert restart.jump(19.0, (0.0, 0.0, 0.0)) is None


def test_another_drive_begins_no_frame():
    restart = FrameRestart()
    restart.jump(10.0, CORRECTION)
    restart.forget()
    assert restart.jump(2.0, (0.0, 0.0, 0.0)) is None


def test_goal_and_maps_follow_a_monitor_that_starts_again(monkeypatch):
    node, ros = lone_node(monkeypatch, robot="turtlebot3_waffle_pi", matched=True)
    node.move_base.goal = compose(CORRECTION, (2.0, 1.0, 0.4))
    node.sensors.pose.return_value = (0.0, 0.0, 0.0)
    odometry = {"odom": CORRECTION}  # pose of the odometry's frame in that of the matched poses
    node.sensors.place_of.side_effect = odometry.get
    node.cycle(rospy.Time(10))
    assert not node.move_base.clear_costmaps.called
    odometry["odom"] = (0.0, 0.0, 0.0)
    node.cycle(rospy.Time(15))
    assert node.move_base.clear_costmaps.called
    ((goal, time),) = (call.args for call in node.move_base.set_goal.call_args_list)
    assert goal == pytest.approx((2.0, 1.0, 0.4))
    assert time == 15.0
    (published_goal,) = ros.published["~current_goal"]
    assert published_goal.header.stamp == rospy.Time(15)
    assert published_goal.header.frame_id == "matched"
    (warning,) = ros.log["warn"]
    assert warning.startswith("the collision monitor has started again: the goal moves")


def test_an_error_of_the_monitor_does_not_move_its_frame(offline_ros, monkeypatch):
    # Given: a monitor node whose sensors fail
    for name in ("BaseCommands", "Sensors", "warm_up"):
        monkeypatch.setattr(monitor_node, name, create_autospec(getattr(monitor_node, name)))
    node = CollisionMonitorNode(MonitorSettings.of(JACKAL), JACKAL, "", [], escape=False)
    node.sensors.observations.side_effect = ValueError("a test")
    node.monitor.matcher.correction = CORRECTION

    # When: a command arrives
    offline_ros.callbacks["cmd_vel_in"](conversions.twist(0.5, 0.0))

    assert len(offline_ros.log["err"]) == 1
    assert node.monitor.matcher.correction == CORRECTION
