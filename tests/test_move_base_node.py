"""The move_base node on a real master, with a made-up Jackal: its whole surface, goals, requests, faults."""
import json
import math
import socket
import time
import xmlrpc.client
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

import ros_harness  # noqa: E402
from ros_harness import wait_for  # noqa: E402

SURFACE = json.loads((Path(__file__).parent / "move_base_surface.json").read_text())
SCRIPT = "applr_ros1/scripts/move_base.py"
ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = 1, 2, 3, 4
POSTS = [(1.5, 0.8, 0.15), (1.5, 1.4, 0.15)]
PLANNER = "/move_base/TrajectoryPlannerROS"


def start(master, parameters=None, sim_time=False, name="move_base"):
    """The node as a child, ready."""
    import rospy
    from applr_ros1.planner.parameters import JACKAL
    rospy.set_param("/" + name, parameters or JACKAL)
    rospy.set_param("/use_sim_time", sim_time)
    child = master.python(SCRIPT, "odom:=odometry/filtered")
    wait_for(lambda: "ready" in child.text or not child.alive(), 150.0, "move_base")
    rospy.set_param("/use_sim_time", False)
    assert child.alive(), child.text
    return child


@pytest.fixture(scope="module")
def master():
    return ros_harness.session()


@pytest.fixture(scope="module")
def stack(master):
    import actionlib
    import rospy
    from fake_jackal import FakeJackal
    from move_base_msgs.msg import MoveBaseAction
    jackal = FakeJackal(POSTS)
    node = start(master)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    yield SimpleNamespace(node=node, jackal=jackal, client=client)
    jackal.close()
    assert node.end() == 0, node.text
    rospy.delete_param("/move_base")


@pytest.fixture
def idle(stack):
    """The stack at its start: robot at the origin, nothing to do, everything switched on."""
    import rospy
    from std_srvs.srv import Empty
    jackal = stack.jackal
    jackal.scans = jackal.transforms = True
    jackal.bend = lambda scan: scan
    stack.client.cancel_all_goals()
    jackal.put((0.0, 0.0, 0.0), POSTS)
    time.sleep(0.2)
    rospy.ServiceProxy("/move_base/clear_costmaps", Empty)()
    time.sleep(0.15)
    jackal.commands.clear()
    return stack


def goal(x, y=0.0, yaw=0.0, frame="odom", quaternion=None):
    from move_base_msgs.msg import MoveBaseGoal
    made = MoveBaseGoal()
    made.target_pose.header.frame_id = frame
    made.target_pose.pose.position.x, made.target_pose.pose.position.y = x, y
    q = made.target_pose.pose.orientation
    q.x, q.y, q.z, q.w = quaternion or (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return made


def collect(topic, kind):
    """(subscriber, list of the messages that come)."""
    import rospy
    got = []
    return rospy.Subscriber(topic, kind, got.append), got


def finish(client, seconds=20.0):
    import rospy
    assert client.wait_for_result(rospy.Duration(seconds)), "no result"
    return client.get_state(), client.get_goal_status_text()


# -- surface -------------------------------------------------------------------------------------------------------
def node_api(master):
    """The node's own XML-RPC server."""
    uri = xmlrpc.client.ServerProxy(master.uri).lookupNode("/test", "/move_base")[2]
    return xmlrpc.client.ServerProxy(uri)


@pytest.mark.parametrize("what, call", [("publishes", "getPublications"), ("subscribes", "getSubscriptions")])
def test_topics_are_those_of_the_cpp_node(stack, master, what, call):
    ours = [(topic, kind) for topic, kind in getattr(node_api(master), call)("/test")[2]
            if topic not in ("/rosout", "/applr/heartbeat")]
    assert sorted(ours) == sorted(SURFACE[what].items())


def test_services_are_those_of_the_cpp_node(stack):
    import rosservice
    ours = {name: rosservice.get_service_type(name) for name in rosservice.get_service_list(node="/move_base")}
    assert {name: kind for name, kind in ours.items() if "logger" not in name} == SURFACE["services"]


@pytest.mark.parametrize("server", SURFACE["dynamic_reconfigure"])
def test_servers_describe_the_cpp_parameters(stack, server):
    from dynamic_reconfigure.client import Client
    client = Client(server, timeout=5.0)
    got = {p["name"]: p for p in client.get_parameter_descriptions(timeout=5.0)}
    values = client.get_configuration(timeout=5.0)
    client.close()
    for p in SURFACE["dynamic_reconfigure"][server]:
        mine = got.pop(p["name"])
        low, high = (float(v) if v in ("inf", "-inf") else v for v in (p["min"], p["max"]))
        assert (mine["type"], mine["min"], mine["max"], mine["default"]) == (p["type"], low, high, p["default"])
        assert values[p["name"]] == p["jackal"]
    assert set(got) <= {"pdist_scale", "gdist_scale"}


def test_parameters_are_on_the_server(stack):
    import rospy
    wait_for(lambda: rospy.get_param("/move_base/aggressive_reset/reset_distance", 0) == 1.84, 5.0, "mirror")
    for server, parameters in SURFACE["dynamic_reconfigure"].items():
        for p in parameters:
            assert rospy.get_param(server + "/" + p["name"]) == p["jackal"], p["name"]


# -- goals ---------------------------------------------------------------------------------------------------------
def test_goal_is_reached_through_the_action(idle):
    from geometry_msgs.msg import PoseStamped
    from move_base_msgs.msg import MoveBaseActionFeedback
    from nav_msgs.msg import Path as PathMessage
    subscribers, got = zip(*[collect(topic, kind) for topic, kind in (
        ("/move_base/current_goal", PoseStamped), ("/move_base/feedback", MoveBaseActionFeedback),
        ("/move_base/NavfnROS/plan", PathMessage), (PLANNER + "/local_plan", PathMessage),
        (PLANNER + "/global_plan", PathMessage))])
    time.sleep(0.5)
    idle.client.send_goal(goal(2.0, 0.0, 0.6))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")
    x, y, yaw = idle.jackal.robot.pose
    assert math.hypot(x - 2.0, y) < 0.27 and abs(yaw - 0.6) < 0.17
    current, feedback, plan, local, cut = got
    assert current[0].pose.position.x == 2.0 and current[0].header.frame_id == "odom"
    assert len(feedback) > 20 and feedback[-1].feedback.base_position.pose.position.x == pytest.approx(x, abs=0.1)
    assert plan[0].poses[-1].pose.position.x == 2.0 and len(plan[0].poses) > 30
    assert plan[0].poses[-1].pose.orientation.z == pytest.approx(math.sin(0.3))
    assert plan[0].poses[0].header.frame_id == "odom" and local and cut
    time.sleep(0.3)
    assert idle.jackal.commands[-1][1:] == (0.0, 0.0)
    times = np.array([t for t, _, _ in idle.jackal.commands])
    gaps = np.diff(times[:-1]) * 1e3
    print("cmd_vel gap: median %.1f, p99 %.1f, max %.1f ms of %d" % (
        np.median(gaps), np.percentile(gaps, 99), gaps.max(), len(gaps)))
    assert np.median(gaps) == pytest.approx(50.0, abs=5.0) and np.percentile(gaps, 99) < 100.0
    for s in subscribers:
        s.unregister()


def test_preempt(idle):
    idle.client.send_goal(goal(4.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 5.0, "motion")
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
    wait_for(lambda: got and any(s.status == SUCCEEDED and s.text == "Goal reached."
                                 for s in got[-1].status_list[-1:]), 10.0, "goal reached")
    subscriber.unregister()


@pytest.mark.parametrize("bad, words", [
    (dict(x=1.0, quaternion=(0.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
    (dict(x=1.0, quaternion=(1.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
    (dict(x=1.0, quaternion=(0.0, 0.0, math.nan, 1.0)), "invalid quaternion"),
    (dict(x=math.nan), "not finite"),
    (dict(x=1.0, frame="nowhere"), "'nowhere' cannot be transformed"),
    (dict(x=1.0, frame=""), "frame_id"),
])
def test_bad_goals_are_aborted_at_once(idle, bad, words):
    idle.client.send_goal(goal(**bad))
    state, text = finish(idle.client, 2.0)
    assert state == ABORTED and words in text and "\n" not in text


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
    assert len(ends) == 100 and ends["goal 99"] == SUCCEEDED
    assert set(ends.values()) <= {PREEMPTED, SUCCEEDED, 8}
    assert any("another goal was recieved by the simple action server" in r.status.text for r in got)
    times = np.array([t for t, _, _ in idle.jackal.commands])
    assert len(times) > 20 and np.diff(times).max() < 0.3
    subscriber.unregister()


# -- services ------------------------------------------------------------------------------------------------------
def test_make_plan_and_its_refusal_while_driving(idle):
    import rospy
    from nav_msgs.srv import GetPlan
    make = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
    navfn = rospy.ServiceProxy("/move_base/NavfnROS/make_plan", GetPlan)
    here, there = goal(0.0).target_pose, goal(2.0).target_pose
    plan = make(here, there, 0.0).plan
    assert plan.header.frame_id == "" and plan.poses[-1].pose.position.x == 2.0 and len(plan.poses) > 30
    nobody = goal(0.0, frame="").target_pose
    assert len(make(nobody, there, 0.0).plan.poses) > 30  # an empty frame means: from the robot
    assert make(here, goal(1.5, 0.7).target_pose, 0.0).plan.poses == []
    assert len(make(here, goal(1.5, 0.7).target_pose, 1.0).plan.poses) > 10
    assert make(here, goal(math.nan).target_pose, 1.0).plan.poses == []
    assert navfn(here, goal(99.0).target_pose, 0.0).plan.poses == []
    idle.client.send_goal(goal(4.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 5.0, "motion")
    with pytest.raises(rospy.ServiceException, match="inactive"):
        make(here, there, 0.0)
    assert len(navfn(here, there, 0.0).plan.poses) > 30


def test_requests_hammered_while_driving(idle):
    import threading
    import rospy
    from nav_msgs.srv import GetPlan
    from std_srvs.srv import Empty
    idle.client.send_goal(goal(3.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 5.0, "motion")
    idle.jackal.commands.clear()
    calls, over = [0, 0], time.time() + 2.5

    def hammer(i, name, kind, *arguments):
        proxy = rospy.ServiceProxy(name, kind, persistent=True)
        while time.time() < over:
            proxy(*arguments)
            calls[i] += 1
    threads = [threading.Thread(target=hammer, args=a) for a in (
        (0, "/move_base/NavfnROS/make_plan", GetPlan, goal(0.0).target_pose, goal(2.0).target_pose, 0.0),
        (1, "/move_base/clear_costmaps", Empty))]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert min(calls) > 10, calls
    times = np.array([t for t, _, _ in idle.jackal.commands])
    assert np.diff(times).max() < 0.25, np.diff(times).max()
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")


# -- dynamic_reconfigure -------------------------------------------------------------------------------------------
CHANGES = {  # name, a new value, one out of bounds, the bound; another name and value
    "/move_base": ("planner_patience", 7.5, 1e9, 100.0, "shutdown_costmaps", True),
    PLANNER: ("max_vel_x", 0.7, 1e9, 20.0, "vx_samples", 9),
    "/move_base/global_costmap": ("publish_frequency", 2.0, -3.0, 0.0, "robot_radius", 0.7),
    "/move_base/local_costmap": ("transform_tolerance", 0.4, 99.0, 10.0, "width", 12),
    "/move_base/global_costmap/inflater_layer": ("inflation_radius", 0.2, 1e9, 50.0, "enabled", False),
    "/move_base/local_costmap/inflater_layer": ("cost_scaling_factor", 5.0, -1.0, 0.0, "inflate_unknown", True),
    "/move_base/global_costmap/obstacles_layer": ("max_obstacle_height", 1.5, 60.0, 50.0, "enabled", False),
    "/move_base/local_costmap/obstacles_layer": ("max_obstacle_height", 1.0, -1.0, 0.0, "combination_method", 0),
}


@pytest.mark.parametrize("server", CHANGES)
def test_every_server_is_read_set_clamped_and_refuses_nan(idle, server):
    import rospy
    from dynamic_reconfigure import DynamicReconfigureCallbackException
    from dynamic_reconfigure.client import Client
    name, value, beyond, bound, other, something = CHANGES[server]
    client = Client(server, timeout=5.0)
    before, kept = (client.get_configuration(timeout=5.0)[n] for n in (name, other))
    try:
        assert client.update_configuration({name: value})[name] == value
        wait_for(lambda: client.get_configuration()[name] == value, 3.0, "update")
        wait_for(lambda: rospy.get_param(server + "/" + name) == value, 3.0, "mirror")
        assert client.update_configuration({name: beyond})[name] == bound
        client.update_configuration({name: value})
        for bad in (math.nan, math.inf):
            said = len(idle.node.text)
            with pytest.raises(DynamicReconfigureCallbackException):
                client.update_configuration({name: bad, other: something})
            assert "refused a change: %s is %r" % (name, bad) in idle.node.text[said:]
        time.sleep(0.05)
        assert client.get_configuration()[name] == value and client.get_configuration()[other] == kept
    finally:
        client.update_configuration({name: before})
        client.close()


def test_fifty_reconfigures_a_second_leave_no_gap(idle):
    from dynamic_reconfigure.client import Client
    clients = [Client(server, timeout=5.0) for server in (
        PLANNER, "/move_base/local_costmap/inflater_layer", "/move_base/global_costmap/inflater_layer")]
    idle.client.send_goal(goal(3.0))
    wait_for(lambda: idle.jackal.robot.twist[0] > 0.3, 5.0, "motion")
    idle.jackal.commands.clear()
    took, over = [], time.time() + 2.5
    while time.time() < over:
        began = time.time()
        v = 0.5 + 0.1 * (len(took) % 2)
        got = clients[0].update_configuration({
            "max_vel_x": v, "max_vel_theta": 1.2 * v, "vx_samples": 7, "vtheta_samples": 21, "occdist_scale": 0.1 * v,
            "path_distance_bias": v, "goal_distance_bias": 1.5 * v, "min_vel_theta": -1.2 * v})
        got2 = [c.update_configuration({"inflation_radius": 0.5 * v}) for c in clients[1:]]
        took.append(1e3 * (time.time() - began))
        assert got["max_vel_x"] == v and all(g["inflation_radius"] == 0.5 * v for g in got2)
        time.sleep(max(0.0, 0.02 - (time.time() - began)))
    gaps = 1e3 * np.diff([t for t, _, _ in idle.jackal.commands])
    print("eight parameters: median %.1f, p95 %.1f ms of %d; cmd_vel gap p99 %.1f, max %.1f ms" % (
        np.median(took), np.percentile(took, 95), len(took), np.percentile(gaps, 99), gaps.max()))
    assert len(took) > 20 and gaps.max() < 250.0
    for client in clients:
        client.update_configuration({"restore_defaults": True} if client is clients[0] else {"inflation_radius": 0.3})
        client.close()


def test_older_names_always_show_the_same(idle):
    from dynamic_reconfigure.client import Client
    client = Client(PLANNER, timeout=5.0)
    assert client.update_configuration({"pdist_scale": 0.31})["path_distance_bias"] == 0.31
    assert client.update_configuration({"path_distance_bias": 0.75})["pdist_scale"] == 0.75
    client.close()


def test_lost_policy_puts_theta_0_back(master):
    """The guard's period is a start-up parameter: a node of its own with a short one."""
    from applr_ros1.nodes import guard
    watch = guard.Guard(2.0)
    assert not watch.is_lost(100.0)  # never heard: left alone
    watch.heartbeat(100.0)
    assert not watch.is_lost(106.0) and watch.is_lost(106.05) and not watch.is_lost(200.0)
    watch.heartbeat(300.0)
    assert not watch.is_lost(10.0) and watch.is_lost(16.1)  # the clock went back
    from applr_ros1.planner.parameter_check import complete
    from applr_ros1.planner.configuration import Configuration
    from applr_ros1.planner.parameters import JACKAL
    requests = guard.start_up_requests(Configuration(complete(JACKAL)).start_up)
    assert requests == {
        "TrajectoryPlannerROS": {"max_vel_x": 0.5, "max_vel_theta": 1.57, "min_vel_theta": -1.57, "vx_samples": 6,
                                 "vtheta_samples": 20, "occdist_scale": 0.1, "path_distance_bias": 0.75,
                                 "goal_distance_bias": 1.0},
        "local_costmap/inflater_layer": {"inflation_radius": 0.3},
        "global_costmap/inflater_layer": {"inflation_radius": 0.3}}


# -- maps ----------------------------------------------------------------------------------------------------------
def test_costmaps_footprints_and_cloud(idle):
    import rospy
    from geometry_msgs.msg import Polygon, PolygonStamped
    from map_msgs.msg import OccupancyGridUpdate
    from nav_msgs.msg import OccupancyGrid
    from sensor_msgs.msg import PointCloud2
    subscribers, (world, local, updates, outline, cloud) = zip(*[collect(topic, kind) for topic, kind in (
        ("/move_base/global_costmap/costmap", OccupancyGrid), ("/move_base/local_costmap/costmap", OccupancyGrid),
        ("/move_base/global_costmap/costmap_updates", OccupancyGridUpdate),
        ("/move_base/local_costmap/footprint", PolygonStamped), (PLANNER + "/cost_cloud", PointCloud2))])
    wait_for(lambda: world and local and len(updates) > 2 and outline, 5.0, "maps")
    whole = np.array(world[0].data, np.int8).reshape(800, 800)
    assert world[0].info.origin.position.x == -20.0 and world[0].info.resolution == pytest.approx(0.05)
    assert whole.max() == 100 and whole.min() == 0
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
    for s in subscribers:
        s.unregister()


# -- faults --------------------------------------------------------------------------------------------------------
def stands_still_and_recovers(stack, words, break_it, mend_it, within=2.0):
    stack.client.send_goal(goal(4.0))
    wait_for(lambda: stack.jackal.robot.twist[0] > 0.3, 5.0, "motion")
    said = len(stack.node.text)
    broken = time.time()
    break_it()
    wait_for(lambda: stack.jackal.robot.twist == (0.0, 0.0), within, "standstill")
    wait_for(lambda: words in stack.node.text[said:], 2.0, words)
    took = time.time() - broken
    mend_it()
    wait_for(lambda: stack.jackal.robot.twist[0] > 0.3, 5.0, "motion again")
    stack.client.cancel_all_goals()
    return took


def test_sensor_loss(idle):
    jackal = idle.jackal
    took = stands_still_and_recovers(idle, "no usable scan on /front/scan", lambda: setattr(jackal, "scans", False),
                                     lambda: setattr(jackal, "scans", True))
    assert took > 0.8


@pytest.mark.parametrize("fault, words", [
    ("short", "has 100 beams where it had 720"), ("empty", "has 0 beams"), ("nan", "is all NaN"),
    ("frame", "front_lazer"), ("old", "no usable scan"), ("future", "no usable scan")])
def test_scans_that_cannot_be_used(idle, fault, words):
    import rospy

    def bend(scan):
        if fault in ("short", "empty", "nan"):
            scan.ranges = {"short": scan.ranges[:100], "empty": [], "nan": [math.nan] * 720}[fault]
        elif fault == "frame":
            scan.header.frame_id = "front_lazer"
        else:
            scan.header.stamp += rospy.Duration(-5.0 if fault == "old" else 5.0)
        return scan
    stands_still_and_recovers(idle, words, lambda: setattr(idle.jackal, "bend", bend),
                              lambda: setattr(idle.jackal, "bend", lambda scan: scan))


def test_odd_beams_are_ordinary(idle):
    def bend(scan):
        scan.ranges = [math.nan, math.inf, -math.inf, 0.0, 1e30, -1.0] * 20 + scan.ranges[120:]
        return scan
    idle.jackal.bend = bend
    idle.client.send_goal(goal(1.0))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")


def test_lost_transform(idle):
    jackal = idle.jackal
    stands_still_and_recovers(idle, "transform odom <- base_link is", lambda: setattr(jackal, "transforms", False),
                              lambda: setattr(jackal, "transforms", True))


# -- start and end -------------------------------------------------------------------------------------------------
def test_bad_parameters_are_named_and_nothing_starts(stack, master):
    import rospy
    rospy.set_param("/bad_one", {"TrajectoryPlannerROS": {"max_vel_x": 99.0, "pdist_scala": 1.0}, "colour": "red"})
    child = master.python(SCRIPT, "__name:=bad_one")
    child.process.wait(20.0)
    assert child.process.returncode == 1
    lines = [line for line in child.text.splitlines() if line.startswith("move_base: parameter")]
    assert len(lines) == 3 and "Traceback" not in child.text
    assert "max_vel_x is 99.0" in child.text and "did you mean pdist_scale?" in child.text and "colour" in child.text


def test_zero_velocity_at_shutdown_and_theta_0_without_policy_and_clock_faults(stack, master):
    """A second node, in simulated time: heartbeat, /clock stalled and set back, Ctrl-C while driving."""
    import actionlib
    import copy
    import rospy
    from dynamic_reconfigure.client import Client
    from fake_jackal import FakeJackal
    from move_base_msgs.msg import MoveBaseAction
    from std_msgs.msg import Time as TimeMessage
    from applr_ros1.planner.parameters import JACKAL
    stack.jackal.close()
    stack.node.end()
    jackal = FakeJackal(POSTS, clock=100.0)
    stack.jackal = jackal
    tree = copy.deepcopy(JACKAL)
    tree["applr"] = {"period": 0.3}
    stack.node = start(master, tree, sim_time=True)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(10.0))

    # the policy goes silent
    heart = rospy.Publisher("/applr/heartbeat", TimeMessage, queue_size=1)
    servers = Client(PLANNER, timeout=5.0), Client("/move_base/local_costmap/inflater_layer", timeout=5.0)
    wait_for(lambda: heart.get_num_connections(), 5.0, "connection")
    heart.publish(TimeMessage(jackal.now()))
    servers[0].update_configuration({"max_vel_x": 1.1, "vtheta_samples": 44, "sim_time": 1.5})
    servers[1].update_configuration({"inflation_radius": 0.5})
    wait_for(lambda: servers[0].get_configuration()["max_vel_x"] == 1.1, 0.6, "policy's parameters")
    wait_for(lambda: servers[0].get_configuration()["max_vel_x"] == 0.5, 3.0, "theta_0")
    assert servers[0].get_configuration()["vtheta_samples"] == 20
    assert servers[0].get_configuration()["sim_time"] == 1.5  # not one of the eight
    wait_for(lambda: servers[1].get_configuration()["inflation_radius"] == 0.3, 3.0, "theta_0")
    assert stack.node.text.count("no sign of the applr node") == 1
    for server in servers:
        server.close()

    # the clock stalls
    client.send_goal(goal(4.0))
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 5.0, "motion")
    jackal.ticking = False
    wait_for(lambda: jackal.commands[-1][1:] == (0.0, 0.0), 3.0, "stop")
    assert "/clock has not moved" in stack.node.text
    jackal.ticking = True
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 5.0, "motion")

    # the clock goes back: an episode begins anew
    jackal.clock = 3.0
    assert finish(client, 3.0) == (ABORTED, "Aborting because the clock jumped back.")
    jackal.put((0.0, 0.0, 0.0))
    time.sleep(1.0)
    client.send_goal(goal(1.0))
    assert finish(client) == (SUCCEEDED, "Goal reached.")

    # Ctrl-C while driving
    client.send_goal(goal(4.0))
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 5.0, "motion")
    assert stack.node.end() == 0
    time.sleep(0.1)
    assert jackal.commands[-1][1:] == (0.0, 0.0), stack.node.text


def test_port_helper_is_not_the_default_master(master):
    assert master.port != 11311
    with socket.socket() as s:
        assert s.connect_ex(("127.0.0.1", master.port)) == 0
