"""The move_base node when sensors, transforms, clock, policy or parameters fail, and when it ends."""

import math
import time

import pytest
from move_base_stack import ABORTED, PLANNER, POSTS, SCRIPT, SUCCEEDED, finish, goal, start
from ros_harness import wait_for

pytestmark = pytest.mark.ros
pytest_plugins = ("move_base_stack",)


# -- faults --------------------------------------------------------------------------------------------------------
def stands_still_and_recovers(stack, words, break_it, mend_it, within=2.0):
    stack.client.send_goal(goal(4.0))
    wait_for(lambda: stack.jackal.robot.twist[0] > 0.3, 10.0, "motion")
    said = len(stack.node.text)
    broken = time.time()
    break_it()
    wait_for(lambda: stack.jackal.robot.twist == (0.0, 0.0), within, "standstill")
    wait_for(lambda: words in stack.node.text[said:], 2.0, words)
    took = time.time() - broken
    mend_it()
    wait_for(lambda: stack.jackal.robot.twist[0] > 0.3, 10.0, "motion again")
    stack.client.cancel_all_goals()
    return took


def test_sensor_loss(idle):
    jackal = idle.jackal
    took = stands_still_and_recovers(
        idle,
        "no usable scan on /front/scan",
        lambda: setattr(jackal, "scans", False),
        lambda: setattr(jackal, "scans", True),
    )
    assert took > 0.8


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("short", "has 100 beams where it had 720"),
        ("empty", "has 0 beams"),
        ("nan", "is all NaN"),
        ("frame", "front_lazer"),
        ("old", "no usable scan"),
        ("future", "no usable scan"),
    ],
)
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

    stands_still_and_recovers(
        idle, words, lambda: setattr(idle.jackal, "bend", bend), lambda: setattr(idle.jackal, "bend", lambda scan: scan)
    )


def test_another_scanner_is_taken_after_two_seconds(idle):
    """A scanner that comes up with other beams, for instance behind one that was there by mistake."""
    idle.jackal.bend = lambda scan: setattr(scan, "ranges", scan.ranges[:400]) or scan
    idle.client.send_goal(goal(1.0))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")
    assert "has 400 beams where it had 720" in idle.node.text


def test_a_transform_stamped_ahead_does_not_stop_the_robot_for_long(idle):
    import rospy

    jackal = idle.jackal
    idle.client.send_goal(goal(4.0))
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 10.0, "motion")

    def ahead(message, publish=jackal._tf.publish):
        for transform in message.transforms:
            transform.header.stamp += rospy.Duration(30.0)
        jackal._tf.publish = publish
        publish(message)

    jackal._tf.publish = ahead  # one message
    wait_for(lambda: jackal._tf.publish is not ahead, 2.0, "the message")
    time.sleep(1.0)
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 2.0, "motion again")
    idle.client.cancel_all_goals()


def test_odd_beams_are_ordinary(idle):
    def bend(scan):
        scan.ranges = [math.nan, math.inf, -math.inf, 0.0, 1e30, -1.0] * 20 + scan.ranges[120:]
        return scan

    idle.jackal.bend = bend
    idle.client.send_goal(goal(1.0))
    assert finish(idle.client) == (SUCCEEDED, "Goal reached.")


def test_lost_transform(idle):
    jackal = idle.jackal
    stands_still_and_recovers(
        idle,
        "transform odom <- base_link is",
        lambda: setattr(jackal, "transforms", False),
        lambda: setattr(jackal, "transforms", True),
    )


# -- start and end -------------------------------------------------------------------------------------------------
def test_bad_parameters_are_named_and_nothing_starts(stack, master):
    import rospy

    rospy.set_param("/bad_one", {"TrajectoryPlannerROS": {"max_vel_x": 99.0, "pdist_scala": 1.0}, "colour": "red"})
    child = master.python(SCRIPT, "__name:=bad_one")
    child.process.wait(20.0)
    assert child.process.returncode == 1
    lines = [line for line in child.text.splitlines() if line.startswith("move_base: parameter")]
    assert len(lines) == 3
    assert "Traceback" not in child.text
    assert "max_vel_x is 99.0" in child.text
    assert "did you mean pdist_scale?" in child.text
    assert "colour" in child.text


def test_zero_velocity_at_shutdown_and_theta_0_without_policy_and_clock_faults(stack, master):
    """A second node, in simulated time: heartbeat, /clock stalled and set back, Ctrl-C while driving."""
    import copy

    import actionlib
    import rospy
    from dynamic_reconfigure.client import Client
    from fake_jackal import FakeJackal
    from move_base_msgs.msg import MoveBaseAction
    from std_msgs.msg import Time as TimeMessage

    from applr_ros1.planner.parameters.declarations import JACKAL

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
    wait_for(lambda: "no sign of the applr node" in stack.node.text, 3.0, "a line about it")
    for server in servers:
        server.close()

    # the clock stalls
    client.send_goal(goal(4.0))
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 10.0, "motion")
    jackal.ticking = False
    wait_for(lambda: jackal.commands[-1][1:] == (0.0, 0.0), 3.0, "stop")
    assert "/clock has not moved" in stack.node.text
    jackal.ticking = True
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 10.0, "motion")

    # the clock goes back: an episode begins anew
    jackal.clock = 3.0
    assert finish(client, 3.0) == (ABORTED, "Aborting because the clock jumped back.")
    jackal.put((0.0, 0.0, 0.0))
    time.sleep(1.0)
    client.send_goal(goal(1.0))
    assert finish(client) == (SUCCEEDED, "Goal reached.")

    # Ctrl-C while driving
    client.send_goal(goal(4.0))
    wait_for(lambda: jackal.robot.twist[0] > 0.3, 10.0, "motion")
    assert stack.node.end() == 0
    time.sleep(0.1)
    assert jackal.commands[-1][1:] == (0.0, 0.0), stack.node.text
