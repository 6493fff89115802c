"""The move_base node on a real master, with a fake Jackal: goals, services, maps."""

import math

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import Point32, Polygon, PolygonStamped, PoseStamped
from map_msgs.msg import OccupancyGridUpdate
from move_base_msgs.msg import MoveBaseActionFeedback, MoveBaseActionResult
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from sensor_msgs.msg import PointCloud2

from tests.support.nodes import PLANNER, PREEMPTED, SUCCEEDED, collect, finish, goal
from tests.support.ros import Kept, wait_for

pytestmark = pytest.mark.ros
pytest_plugins = ("tests.support.nodes",)


def drive_on(idle):
    """Send a goal 4 m away and wait until the robot drives."""
    idle.client.send_goal(goal(4.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, "motion")


def stops(idle):
    """Wait until the latest command is zero."""
    wait_for(lambda: idle.jackal.commands[-1].velocity == (0.0, 0.0), "zero")


def collect_all(topics):
    """Return the subscribers of topics {topic: kind}, and lists that collect their messages."""
    collected = [collect(topic, kind) for topic, kind in topics.items()]
    return zip(*collected)


# -- goals -----------------------------------------------------------------------------------------
def test_goal_is_reached_through_the_action(idle):
    topics = {
        "/move_base/current_goal": PoseStamped,
        "/move_base/feedback": MoveBaseActionFeedback,
        "/move_base/NavfnROS/plan": PathMessage,
        PLANNER + "/local_plan": PathMessage,
        PLANNER + "/global_plan": PathMessage,
    }
    subscribers, collected = collect_all(topics)
    current_goals, feedback, plans, local_plans, global_plans = collected
    stopwatch = Kept()
    idle.client.send_goal(goal(2.0, 0.0, 0.6))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")
    commands = idle.jackal.commands
    stops(idle)
    x, y, yaw = idle.jackal.robot.pose
    assert math.hypot(x - 2.0, y) < 0.3
    assert abs(yaw - 0.6) < 0.25
    assert current_goals[0].pose.position.x == 2.0
    assert current_goals[0].header.frame_id == "odom"
    assert len(feedback) > 20
    wait_for(
        lambda: abs(feedback[-1].feedback.base_position.pose.position.x - x) < 0.1, "the latest"
    )
    # The plan ends at the goal, with its heading: z of the quaternion is the sine of half of it.
    plan_poses = plans[0].poses
    assert plan_poses[0].header.frame_id == "odom"
    assert plan_poses[-1].pose.position.x == 2.0
    assert plan_poses[-1].pose.orientation.z == pytest.approx(math.sin(0.3))
    assert len(plan_poses) > 30
    assert local_plans
    assert global_plans
    # Commands come at 20 Hz, and are late by no more than the processor was.
    intervals = np.diff([command.stamp for command in commands[:-1]])
    assert intervals.mean() > 0.045
    assert intervals.sum() - stopwatch.waiting() < 0.06 * len(intervals)
    for subscriber in subscribers:
        subscriber.unregister()


def test_a_cancelled_goal_is_preempted_and_the_base_stops(idle):
    drive_on(idle)
    idle.client.cancel_goal()
    assert finish(idle.client) == (PREEMPTED, "")
    stops(idle)


def test_a_goal_on_the_simple_topic_replaces_the_one_before(idle):
    publisher = rospy.Publisher("/move_base_simple/goal", PoseStamped, queue_size=1)
    subscriber, results = collect("/move_base/result", MoveBaseActionResult)
    wait_for(lambda: publisher.get_num_connections(), "connection")
    drive_on(idle)
    publisher.publish(goal(0.5).target_pose)
    wait_for(lambda: len(results) > 1, "both results")
    assert [result.status.status for result in results] == [PREEMPTED, SUCCEEDED]
    subscriber.unregister()


# -- services --------------------------------------------------------------------------------------
def test_make_plan_and_its_refusal_while_driving(idle):
    make_plan = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
    navfn_make_plan = rospy.ServiceProxy("/move_base/NavfnROS/make_plan", GetPlan)
    start_pose = goal(0.0).target_pose
    end_pose = goal(2.0).target_pose
    plan = make_plan(start_pose, end_pose, 0.0).plan
    assert plan.header.frame_id == ""
    assert plan.poses[-1].pose.position.x == 2.0
    assert len(plan.poses) > 30
    # An empty frame means that the plan starts at the robot.
    no_start = goal(0.0, frame="").target_pose
    assert len(make_plan(no_start, end_pose, 0.0).plan.poses) > 30
    # A pose at a post is reached with a tolerance.
    pose_at_post = goal(1.5, 0.7).target_pose
    assert len(make_plan(start_pose, pose_at_post, 1.0).plan.poses) > 10
    # A pose outside the map
    assert navfn_make_plan(start_pose, goal(99.0).target_pose, 0.0).plan.poses == []
    drive_on(idle)
    with pytest.raises(rospy.ServiceException, match="inactive"):
        make_plan(start_pose, end_pose, 0.0)
    assert len(navfn_make_plan(start_pose, end_pose, 0.0).plan.poses) > 30


# -- maps ------------------------------------------------------------------------------------------
def test_costmaps_footprints_and_cloud(idle):
    topics = {
        "/move_base/global_costmap/costmap": OccupancyGrid,
        "/move_base/local_costmap/costmap": OccupancyGrid,
        "/move_base/global_costmap/costmap_updates": OccupancyGridUpdate,
        "/move_base/local_costmap/footprint": PolygonStamped,
        PLANNER + "/cost_cloud": PointCloud2,
    }
    subscribers, collected = collect_all(topics)
    global_maps, local_maps, updates, outlines, clouds = collected

    wait_for(lambda: global_maps and local_maps and len(updates) > 2 and outlines, "maps")
    assert global_maps[0].info.origin.position.x == -20.0
    assert global_maps[0].info.resolution == pytest.approx(0.05)
    # 10 m by 10 m
    assert len(local_maps[0].data) == 40000
    assert len(updates[0].data) == updates[0].width * updates[0].height
    assert len(outlines[0].polygon.points) == 4
    wait_for(
        lambda: max(corner.x for corner in outlines[-1].polygon.points) == pytest.approx(0.31),
        "the outline at the start",
    )
    idle.client.send_goal(goal(1.0))
    wait_for(lambda: clouds, "cost cloud")
    cost_fields = ["path_cost", "goal_cost", "occ_cost", "total_cost"]
    assert [field.name for field in clouds[0].fields][3:] == cost_fields
    assert len(clouds[0].data) == clouds[0].width * clouds[0].point_step
    finish(idle.client)

    # As in C++, the node also subscribes to the topic of the footprint.
    publisher = rospy.Publisher("/move_base/local_costmap/footprint", Polygon, queue_size=1)
    wait_for(lambda: publisher.get_num_connections(), "connection")
    # The second footprint is the Jackal's again, for the following tests.
    for half_width in (0.4, 0.165):
        sides = ((-0.21, -half_width), (-0.21, half_width), (0.21, half_width), (0.21, -half_width))
        publisher.publish(Polygon([Point32(x, y, 0.0) for x, y in sides]))
        padded_width = pytest.approx(2.0 * (half_width + 0.1), abs=0.1)

        def has_changed(width=padded_width):
            return np.ptp([corner.y for corner in outlines[-1].polygon.points]) == width

        wait_for(has_changed, "the outline")
    publisher.unregister()
    for subscriber in subscribers:
        subscriber.unregister()


# -- start and end ---------------------------------------------------------------------------------
def test_zero_velocity_at_shutdown(idle):
    """Ctrl-C while driving. This is the last test of this file because it ends the node."""
    drive_on(idle)
    assert idle.node.end() == 0
    stops(idle)
