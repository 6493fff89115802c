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
    wait_for(lambda: idle.jackal.commands[-1][1:] == (0.0, 0.0), "zero")


def collect_all(topics):
    """Return the subscribers of topics {topic: kind}, and lists that collect their messages."""
    return zip(*(collect(topic, kind) for topic, kind in topics.items()))


# -- goals -----------------------------------------------------------------------------------------
def test_goal_is_reached_through_the_action(idle):
    topics = {
        "/move_base/current_goal": PoseStamped,
        "/move_base/feedback": MoveBaseActionFeedback,
        "/move_base/NavfnROS/plan": PathMessage,
        PLANNER + "/local_plan": PathMessage,
        PLANNER + "/global_plan": PathMessage,
    }
    subscribers, (current, feedback, plan, local, cut) = collect_all(topics)
    kept = Kept()
    idle.client.send_goal(goal(2.0, 0.0, 0.6))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")
    commands = idle.jackal.commands
    stops(idle)
    x, y, yaw = idle.jackal.robot.pose
    assert math.hypot(x - 2.0, y) < 0.3
    assert abs(yaw - 0.6) < 0.25
    assert current[0].pose.position.x == 2.0
    assert current[0].header.frame_id == "odom"
    assert len(feedback) > 20
    wait_for(
        lambda: abs(feedback[-1].feedback.base_position.pose.position.x - x) < 0.1, "the latest"
    )
    assert plan[0].poses[-1].pose.position.x == 2.0
    assert len(plan[0].poses) > 30
    assert plan[0].poses[-1].pose.orientation.z == pytest.approx(math.sin(0.3))
    assert plan[0].poses[0].header.frame_id == "odom"
    assert local
    assert cut
    gaps = np.diff([time for time, _, _ in commands[:-1]])
    assert gaps.mean() > 0.045
    assert gaps.sum() - kept.waiting() < 0.06 * len(gaps)
    for subscriber in subscribers:
        subscriber.unregister()


def test_a_cancelled_goal_is_preempted_and_the_base_stops(idle):
    drive_on(idle)
    idle.client.cancel_goal()
    assert finish(idle.client) == (PREEMPTED, "")
    stops(idle)


def test_a_goal_on_the_simple_topic_replaces_the_one_before(idle):
    publisher = rospy.Publisher("/move_base_simple/goal", PoseStamped, queue_size=1)
    subscriber, got = collect("/move_base/result", MoveBaseActionResult)
    wait_for(lambda: publisher.get_num_connections(), "connection")
    drive_on(idle)
    publisher.publish(goal(0.5).target_pose)
    wait_for(lambda: len(got) > 1, "both results")
    assert [result.status.status for result in got] == [PREEMPTED, SUCCEEDED]
    subscriber.unregister()


# -- services --------------------------------------------------------------------------------------
def test_make_plan_and_its_refusal_while_driving(idle):
    make = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
    navfn = rospy.ServiceProxy("/move_base/NavfnROS/make_plan", GetPlan)
    here = goal(0.0).target_pose
    there = goal(2.0).target_pose
    plan = make(here, there, 0.0).plan
    assert plan.header.frame_id == ""
    assert plan.poses[-1].pose.position.x == 2.0
    assert len(plan.poses) > 30
    nobody = goal(0.0, frame="").target_pose
    # An empty frame means that the plan starts at the robot.
    assert len(make(nobody, there, 0.0).plan.poses) > 30
    assert make(here, goal(1.5, 0.7).target_pose, 0.0).plan.poses == []
    assert len(make(here, goal(1.5, 0.7).target_pose, 1.0).plan.poses) > 10
    assert make(here, goal(math.nan).target_pose, 1.0).plan.poses == []
    assert navfn(here, goal(99.0).target_pose, 0.0).plan.poses == []
    drive_on(idle)
    with pytest.raises(rospy.ServiceException, match="inactive"):
        make(here, there, 0.0)
    assert len(navfn(here, there, 0.0).plan.poses) > 30


# -- maps ------------------------------------------------------------------------------------------
def test_costmaps_footprints_and_cloud(idle):
    topics = {
        "/move_base/global_costmap/costmap": OccupancyGrid,
        "/move_base/local_costmap/costmap": OccupancyGrid,
        "/move_base/global_costmap/costmap_updates": OccupancyGridUpdate,
        "/move_base/local_costmap/footprint": PolygonStamped,
        PLANNER + "/cost_cloud": PointCloud2,
    }
    subscribers, (world, local, updates, outline, cloud) = collect_all(topics)

    def whole():
        cells = np.array(world[0].data, np.int8).reshape(800, 800)
        for of in updates:
            cells[of.y : of.y + of.height, of.x : of.x + of.width] = np.reshape(
                of.data, (of.height, of.width)
            )
        return cells

    wait_for(
        lambda: world and local and len(updates) > 2 and outline and whole().max() == 100, "maps"
    )
    assert world[0].info.origin.position.x == -20.0
    assert world[0].info.resolution == pytest.approx(0.05)
    assert whole().min() == 0
    hit = np.argwhere(whole() == 100)
    assert (hit[:, 1] * 0.05 - 20.0).min() == pytest.approx(1.4, abs=0.15)
    assert len(local[0].data) == 40000
    assert len(updates[0].data) == updates[0].width * updates[0].height
    assert len(outline[0].polygon.points) == 4
    wait_for(
        lambda: max(p.x for p in outline[-1].polygon.points) == pytest.approx(0.31),
        "the outline at the start",
    )
    idle.client.send_goal(goal(1.0))
    wait_for(lambda: cloud, "cost cloud")
    assert [f.name for f in cloud[0].fields][3:] == [
        "path_cost",
        "goal_cost",
        "occ_cost",
        "total_cost",
    ]
    assert len(cloud[0].data) == cloud[0].width * cloud[0].point_step
    finish(idle.client)
    # As in C++, the node also subscribes to the topic of the footprint.
    publisher = rospy.Publisher("/move_base/local_costmap/footprint", Polygon, queue_size=1)
    wait_for(lambda: publisher.get_num_connections(), "connection")
    for side in (0.4, 0.165):
        corners = ((-0.21, -side), (-0.21, side), (0.21, side), (0.21, -side))
        publisher.publish(Polygon([Point32(x, y, 0.0) for x, y in corners]))
        width = pytest.approx(2.0 * (side + 0.1), abs=0.1)  # including the padding
        wait_for(
            lambda width=width: np.ptp([p.y for p in outline[-1].polygon.points]) == width,
            "the outline",
        )
    publisher.unregister()
    for subscriber in subscribers:
        subscriber.unregister()


# -- start and end ---------------------------------------------------------------------------------
def test_zero_velocity_at_shutdown(idle):
    """Ctrl-C while driving. This is the last test of this file because it ends the node."""
    drive_on(idle)
    assert idle.node.end() == 0
    stops(idle)
