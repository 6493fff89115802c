"""The move_base node on a real master, with a made-up Jackal: goals, services, maps."""

import math
import time

import numpy as np
import pytest
from move_base_stack import ABORTED, PLANNER, PREEMPTED, SUCCEEDED, collect, finish, goal
from ros_harness import wait_for

pytestmark = pytest.mark.ros
pytest_plugins = ("move_base_stack",)


# -- goals ---------------------------------------------------------------------------------------------------------
def test_goal_is_reached_through_the_action(idle):
    from geometry_msgs.msg import PoseStamped
    from move_base_msgs.msg import MoveBaseActionFeedback
    from nav_msgs.msg import Path as PathMessage

    subscribers, got = zip(
        *[
            collect(topic, kind)
            for topic, kind in (
                ("/move_base/current_goal", PoseStamped),
                ("/move_base/feedback", MoveBaseActionFeedback),
                ("/move_base/NavfnROS/plan", PathMessage),
                (PLANNER + "/local_plan", PathMessage),
                (PLANNER + "/global_plan", PathMessage),
            )
        ]
    )
    time.sleep(0.5)
    idle.client.send_goal(goal(2.0, 0.0, 0.6))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")
    x, y, yaw = idle.jackal.robot.pose
    assert math.hypot(x - 2.0, y) < 0.27
    assert abs(yaw - 0.6) < 0.17
    current, feedback, plan, local, cut = got
    assert current[0].pose.position.x == 2.0
    assert current[0].header.frame_id == "odom"
    assert len(feedback) > 20
    assert feedback[-1].feedback.base_position.pose.position.x == pytest.approx(x, abs=0.1)
    assert plan[0].poses[-1].pose.position.x == 2.0
    assert len(plan[0].poses) > 30
    assert plan[0].poses[-1].pose.orientation.z == pytest.approx(math.sin(0.3))
    assert plan[0].poses[0].header.frame_id == "odom"
    assert local
    assert cut
    time.sleep(0.3)
    assert idle.jackal.commands[-1][1:] == (0.0, 0.0)
    times = np.array([t for t, _, _ in idle.jackal.commands])
    gaps = np.diff(times[:-1]) * 1e3
    print(
        "cmd_vel gap: median %.1f, p99 %.1f, max %.1f ms of %d"
        % (np.median(gaps), np.percentile(gaps, 99), gaps.max(), len(gaps))
    )
    assert np.median(gaps) == pytest.approx(50.0, abs=5.0)
    assert np.percentile(gaps, 99) < 100.0
    for s in subscribers:
        s.unregister()


def test_preempt(idle):
    idle.client.send_goal(goal(4.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 10.0, "motion")
    idle.client.cancel_goal()
    assert finish(idle.client, 1.0) == (PREEMPTED, "")
    time.sleep(0.2)
    assert idle.jackal.commands[-1][1:] == (0.0, 0.0)


def test_simple_goal_topic(idle):
    import rospy
    from actionlib_msgs.msg import GoalStatusArray
    from geometry_msgs.msg import PoseStamped

    publisher = rospy.Publisher("/move_base_simple/goal", PoseStamped, queue_size=1)
    subscriber, got = collect("/move_base/status", GoalStatusArray)
    wait_for(lambda: publisher.get_num_connections(), 5.0, "connection")
    publisher.publish(goal(0.5).target_pose)
    wait_for(
        lambda: got and any(s.status == SUCCEEDED and s.text == "Goal reached." for s in got[-1].status_list[-1:]),
        10.0,
        "goal reached",
    )
    subscriber.unregister()


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (dict(x=1.0, quaternion=(0.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
        (dict(x=1.0, quaternion=(1.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
        (dict(x=1.0, quaternion=(0.0, 0.0, math.nan, 1.0)), "invalid quaternion"),
        (dict(x=math.nan), "not finite"),
        (dict(x=1.0, frame="nowhere"), "'nowhere' cannot be transformed"),
        (dict(x=1.0, frame=""), "frame_id"),
    ],
)
def test_bad_goals_are_aborted_at_once(idle, bad, words):
    idle.client.send_goal(goal(**bad))
    state, text = finish(idle.client, 2.0)
    assert state == ABORTED
    assert words in text
    assert "\n" not in text


def test_goal_in_another_frame(idle):
    idle.jackal.put((0.0, 0.0, math.pi / 2))
    time.sleep(0.3)
    idle.client.send_goal(goal(0.6, 0.0, 0.0, frame="base_link"))
    assert finish(idle.client)[0] == SUCCEEDED
    assert idle.jackal.robot.pose[1] == pytest.approx(0.6, abs=0.27)


def test_a_hundred_goals_in_a_second(idle):
    import rospy
    from move_base_msgs.msg import MoveBaseActionGoal, MoveBaseActionResult

    publisher = rospy.Publisher("/move_base/goal", MoveBaseActionGoal, queue_size=200)
    subscriber, got = collect("/move_base/result", MoveBaseActionResult)
    wait_for(lambda: publisher.get_num_connections() and subscriber.get_num_connections(), 5.0, "connections")
    for i in range(100):
        message = MoveBaseActionGoal(goal=goal(0.3 + 0.003 * i))
        message.goal_id.id, message.goal_id.stamp = "goal %d" % i, rospy.Time.now()
        publisher.publish(message)
        time.sleep(0.01)
    wait_for(lambda: len(got) == 100, 15.0, "results")
    ends = {r.status.goal_id.id: r.status.status for r in got}
    assert len(ends) == 100
    assert ends["goal 99"] == SUCCEEDED
    assert set(ends.values()) <= {PREEMPTED, SUCCEEDED, 8}
    assert any("another goal was recieved by the simple action server" in r.status.text for r in got)
    times = np.array([t for t, _, _ in idle.jackal.commands])
    assert len(times) > 20
    assert np.diff(times).max() < 0.3
    subscriber.unregister()


# -- services ------------------------------------------------------------------------------------------------------
def test_make_plan_and_its_refusal_while_driving(idle):
    import rospy
    from nav_msgs.srv import GetPlan

    make = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
    navfn = rospy.ServiceProxy("/move_base/NavfnROS/make_plan", GetPlan)
    here, there = goal(0.0).target_pose, goal(2.0).target_pose
    plan = make(here, there, 0.0).plan
    assert plan.header.frame_id == ""
    assert plan.poses[-1].pose.position.x == 2.0
    assert len(plan.poses) > 30
    nobody = goal(0.0, frame="").target_pose
    assert len(make(nobody, there, 0.0).plan.poses) > 30  # an empty frame means: from the robot
    assert make(here, goal(1.5, 0.7).target_pose, 0.0).plan.poses == []
    assert len(make(here, goal(1.5, 0.7).target_pose, 1.0).plan.poses) > 10
    assert make(here, goal(math.nan).target_pose, 1.0).plan.poses == []
    assert navfn(here, goal(99.0).target_pose, 0.0).plan.poses == []
    idle.client.send_goal(goal(4.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 10.0, "motion")
    with pytest.raises(rospy.ServiceException, match="inactive"):
        make(here, there, 0.0)
    assert len(navfn(here, there, 0.0).plan.poses) > 30


def test_requests_hammered_while_driving(idle):
    import threading

    import rospy
    from nav_msgs.srv import GetPlan
    from std_srvs.srv import Empty

    idle.client.send_goal(goal(3.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 10.0, "motion")
    idle.jackal.commands.clear()
    calls, over = [0, 0], time.time() + 2.5

    def hammer(i, name, kind, *arguments):
        proxy = rospy.ServiceProxy(name, kind, persistent=True)
        while time.time() < over:
            proxy(*arguments)
            calls[i] += 1

    threads = [
        threading.Thread(target=hammer, args=a)
        for a in (
            (0, "/move_base/NavfnROS/make_plan", GetPlan, goal(0.0).target_pose, goal(2.0).target_pose, 0.0),
            (1, "/move_base/clear_costmaps", Empty),
        )
    ]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert min(calls) > 10, calls
    times = np.array([t for t, _, _ in idle.jackal.commands])
    assert np.diff(times).max() < 0.25, np.diff(times).max()
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")


# -- maps ----------------------------------------------------------------------------------------------------------
def test_costmaps_footprints_and_cloud(idle):
    import rospy
    from geometry_msgs.msg import Point32, Polygon, PolygonStamped
    from map_msgs.msg import OccupancyGridUpdate
    from nav_msgs.msg import OccupancyGrid
    from sensor_msgs.msg import PointCloud2

    subscribers, (world, local, updates, outline, cloud) = zip(
        *[
            collect(topic, kind)
            for topic, kind in (
                ("/move_base/global_costmap/costmap", OccupancyGrid),
                ("/move_base/local_costmap/costmap", OccupancyGrid),
                ("/move_base/global_costmap/costmap_updates", OccupancyGridUpdate),
                ("/move_base/local_costmap/footprint", PolygonStamped),
                (PLANNER + "/cost_cloud", PointCloud2),
            )
        ]
    )
    wait_for(lambda: world and local and len(updates) > 2 and outline, 5.0, "maps")
    whole = np.array(world[0].data, np.int8).reshape(800, 800)
    assert world[0].info.origin.position.x == -20.0
    assert world[0].info.resolution == pytest.approx(0.05)
    assert whole.max() == 100
    assert whole.min() == 0
    hit = np.argwhere(whole == 100)
    assert (hit[:, 1] * 0.05 - 20.0).min() == pytest.approx(1.4, abs=0.15)
    assert len(local[0].data) == 40000
    assert len(updates[0].data) == updates[0].width * updates[0].height
    assert len(outline[0].polygon.points) == 4
    assert max(p.x for p in outline[0].polygon.points) == pytest.approx(0.31)
    idle.client.send_goal(goal(1.0))
    wait_for(lambda: cloud, 5.0, "cost cloud")
    assert [f.name for f in cloud[0].fields][3:] == ["path_cost", "goal_cost", "occ_cost", "total_cost"]
    assert len(cloud[0].data) == cloud[0].width * cloud[0].point_step
    finish(idle.client)
    # the same name also takes an outline, as in C++
    publisher = rospy.Publisher("/move_base/global_costmap/footprint", Polygon, queue_size=1)
    wait_for(lambda: publisher.get_num_connections(), 5.0, "connection")
    before = (np.array(world[-1].data) == 99).sum()
    for side in (0.4, 0.165):
        world.clear()
        publisher.publish(
            Polygon([Point32(x, y, 0.0) for x, y in ((-0.21, -side), (-0.21, side), (0.21, side), (0.21, -side))])
        )
        time.sleep(0.2)
        subscribers[0].unregister()
        subscribers = (
            rospy.Subscriber("/move_base/global_costmap/costmap", OccupancyGrid, world.append),
        ) + subscribers[1:]
        wait_for(lambda: world, 5.0, "whole map")
        if side == 0.4:
            assert (np.array(world[-1].data) == 99).sum() > before  # a larger inscribed radius
    publisher.unregister()
    for s in subscribers:
        s.unregister()
