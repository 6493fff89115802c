"""Tests of the collision monitor's node with a fake Jackal: it stops at a wall, and if nodes or
lasers are silent.
"""

import os
import shutil
import signal
import time
import xmlrpc.client
from typing import List, NamedTuple

import pytest
import rosgraph
import rospy
from geometry_msgs.msg import Twist
from std_msgs.msg import Bool, String

from applr_ros1.nodes.conversions import twist
from applr_ros1.robots import JACKAL
from tests.support.nodes import FakeJackal
from tests.support.ros import Kept, session, wait_for

pytestmark = pytest.mark.ros
INPUTS = "scan:=front/scan", "odom:=odometry/filtered"
monitors = []  # nodes started so far, the last one running


class Stack(NamedTuple):
    """A Jackal in front of a wall, a publisher of commands, and the monitor's actions so far."""

    jackal: FakeJackal
    commands: rospy.Publisher
    actions: List[str]


def start():
    """Start a monitor, which counts as frozen after 1.5 s, and return its Child."""
    constants = {"applr_ros1.nodes.monitor.guard.FROZEN_S": 1.5}
    monitors.append(session().node("collision_monitor", *INPUTS, constants=constants))
    return monitors[-1]


@pytest.fixture(scope="module")
def stack():
    """Return the Jackal and its monitor for all tests of this file."""
    session()
    # A wall of posts, 1.6 m wide
    jackal = FakeJackal(circles=[(1.5, decimetres / 10, 0.075) for decimetres in range(-8, 9)])
    monitor = start()
    commands = rospy.Publisher("/cmd_vel_in", Twist, queue_size=1)
    actions = []
    subscriber = rospy.Subscriber(
        "/collision_monitor/action", String, lambda message: actions.append(message.data)
    )
    monitor.until(lambda: commands.get_num_connections())
    yield Stack(jackal, commands, actions)
    monitors[-1].end()
    subscriber.unregister()
    jackal.close()


def send(stack, v):
    """Send a command, wait a twentieth of a second, and return the last speed commanded to the base
    [m/s].
    """
    stack.commands.publish(twist(v, 0.0))
    time.sleep(0.05)
    return stack.jackal.commands[-1].v


def drive(stack, v):
    """Drive from a start far before the wall until the base has exactly the speed v [m/s]."""

    def drives():
        if send(stack, v) == v == stack.jackal.robot.twist[0]:
            return True
        # The space before the wall is short: the robot starts anew until it is as fast.
        stack.jackal.put((0.0, 0.0, 0.0))
        return False

    wait_for(drives, "the speed")


def time_to_zero(jackal, since):
    """Return the time from `since` until the base got its first zero command after it [s]."""
    zeros = [command.stamp for command in jackal.commands if command.v == 0.0]
    return min(stamp for stamp in zeros if stamp > since) - since


def test_drives_to_the_wall_and_stops_before_it(stack):
    jackal = stack.jackal
    wait_for(
        lambda: jackal.commands, "a stop before the first command, in case an earlier monitor died"
    )
    assert {command.velocity for command in jackal.commands} == {(0.0, 0.0)}
    # The master answers (publishers, subscribers, services), each as pairs (name, nodes).
    subscribed_topics = dict(rosgraph.Master("/test").getSystemState()[1])
    assert "/move_base/status" not in subscribed_topics, "no escape motions unless ~escape is set"
    drive(stack, 1.0)
    # Where the front of the padded footprint would touch the posts [m]
    contact_x = 1.5 - 0.075 - 0.229

    def stands_at_the_wall():
        return send(stack, 1.0) == 0.0 and jackal.robot.pose[0] > contact_x - 0.15

    wait_for(stands_at_the_wall, "the wall")
    wait_for(
        lambda: send(stack, 1.0) == 0.0 and stack.actions[-1].startswith("stop: an obstacle"),
        "the reason of the stop",
    )
    blocked = []
    subscriber = rospy.Subscriber(
        "/collision_monitor/held_back", Bool, lambda message: blocked.append(message.data)
    )
    wait_for(
        lambda: send(stack, 1.0) == 0.0 and blocked.count(True) > 3, "a message with each command"
    )
    subscriber.unregister()
    assert jackal.robot.pose[0] < contact_x


@pytest.mark.fault("14d")
def test_a_silent_planner_stops_the_base_until_it_commands_again(stack, measured):
    """The monitor publishes zeros at its own rate, so that a base without a command time-out stops,
    too.
    """
    jackal = stack.jackal
    drive(stack, 0.5)
    stopwatch = Kept()
    wait_for(lambda: jackal.commands[-1].velocity == (0.0, 0.0), "zero")
    silent_since = max(command.stamp for command in jackal.commands if command.v == 0.5)
    delay = time_to_zero(jackal, silent_since)
    measured("zero after", delay, "s")
    # Silence is noticed after 0.15 s, at the next tick of 0.05 s. Then the base is braked by
    # 1.9 m/s^2 from 0.5 to 0.3 m/s, and by 0.6 m/s^2 to zero, at which slow wheels do not lock.
    braking_s = 0.2 / 1.9 + 0.3 / 0.6
    assert delay < 0.15 + 0.05 + braking_s + stopwatch.waiting()
    wait_for(lambda: stack.actions[-1].startswith("stop: no command for 0.1"), "why")
    earlier_commands = len(jackal.commands)
    wait_for(lambda: len(jackal.commands) > earlier_commands + 3, "more zeros")

    def is_silent():
        command_count = len(jackal.commands)
        time.sleep(0.3)
        return len(jackal.commands) == command_count

    # Zeros for ever would fight a person with a remote control.
    wait_for(is_silent, "the end of zeros")
    drive(stack, 0.5)


@pytest.mark.fault("14a")
@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_a_killed_or_frozen_monitor_stops_the_base_and_exits_for_a_restart(stack, kind, measured):
    jackal = stack.jackal
    drive(stack, 0.5)
    stopwatch = Kept()
    os.kill(node_pid("/collision_monitor"), kind)
    began = time.time()

    def has_been_stopped():
        latest_command = jackal.commands[-1]
        return latest_command.v == 0.0 and latest_command.stamp > began

    wait_for(has_been_stopped, "zero")
    delay = time_to_zero(jackal, began)
    measured("zero after", delay, "s")
    assert delay < 0.5 + stopwatch.waiting()
    wait_for(lambda: not monitors[-1].alive(), "the end of its guard")
    assert monitors[-1].process.poll() != 0

    # The launch file restarts the monitor.
    earlier_commands = len(jackal.commands)
    start()
    wait_for(lambda: len(jackal.commands) > earlier_commands, "a zero of the next one")
    assert jackal.commands[earlier_commands].velocity == (0.0, 0.0)
    drive(stack, 0.3)


def test_the_last_commands_of_an_interrupted_monitor_are_zeros(stack):
    """roslaunch interrupts both processes at once. The planner goes on with its commands."""
    jackal = stack.jackal
    drive(stack, 0.5)
    for process_id in (monitors[-1].pid, node_pid("/collision_monitor")):
        os.kill(process_id, signal.SIGINT)

    def has_ended():
        send(stack, 0.5)
        return not monitors[-1].alive()

    wait_for(has_ended, "the end of the monitor")
    assert [command.velocity for command in jackal.commands[-3:]] == [(0.0, 0.0)] * 3
    start()
    drive(stack, 0.3)


def test_a_guard_begins_with_a_zero_before_any_node_lives():
    """An earlier guard may have died together with its node, and the base may have no command
    time-out.
    """
    ros = session()
    commands = []

    def keep(message):
        commands.append((message.linear.x, message.angular.z))

    subscriber = rospy.Subscriber("/orphan/cmd_vel", Twist, keep)
    child = ros.node(
        "collision_monitor", "cmd_vel:=orphan/cmd_vel", "__name:=orphan", "_robot:=/nowhere"
    )
    wait_for(lambda: not child.alive(), "the end, because the robot does not exist")
    wait_for(lambda: commands, "the zero")
    assert commands == [(0.0, 0.0)]
    assert child.process.poll() == 1, child.text
    subscriber.unregister()


def node_pid(name):
    """Return the process ID of a node."""
    node_uri = rosgraph.Master("/test").lookupNode(name)
    return xmlrpc.client.ServerProxy(node_uri).getPid("/test")[2]


def test_the_guard_stops_a_base_whose_commands_have_another_topic(stack, tmp_path):
    folder = tmp_path / "jackal"
    shutil.copytree(JACKAL.folder, folder)
    description = (folder / "robot.yaml").read_text()
    (folder / "robot.yaml").write_text(description.replace("cmd_vel: cmd_vel", "cmd_vel: wheels"))
    senders = []

    def remember_sender(message):
        senders.append(message._connection_header["callerid"])

    subscriber = rospy.Subscriber("/wheels", Twist, remember_sender)
    names = "__name:=of_wheels", "cmd_vel_in:=wheels_in"
    child = session().node("collision_monitor", *INPUTS, f"_robot:={folder}", *names)
    commands = rospy.Publisher("/wheels_in", Twist, queue_size=1)
    child.until(lambda: commands.get_num_connections() and "/of_wheels" in senders)
    # The base, which the guard still takes for connected, connects again a second late.
    time.sleep(1.0)
    subscriber.unregister()
    os.kill(node_pid("/of_wheels"), signal.SIGKILL)
    time.sleep(1.0)
    senders.clear()
    subscriber = rospy.Subscriber("/wheels", Twist, remember_sender)
    wait_for(lambda: "/of_wheels_guard" in senders, "zeros of the guard")
    wait_for(lambda: not child.alive(), "the end of the guard")
    subscriber.unregister()
    commands.unregister()
