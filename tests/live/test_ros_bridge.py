"""Tests of the simulated Jackal over ROS: topics, tf, commands, time-out, reset, change of world,
errors, lock step.
"""

import threading
import time
from math import hypot
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
import tf2_ros
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import Empty, EmptyResponse, Trigger
from visualization_msgs.msg import Marker, MarkerArray

import worlds
from applr_ros1.nodes.conversions import twist
from tests.support.ros import LONGEST, Kept, session, wait_for

pytestmark = pytest.mark.ros

TOPICS = {
    "/clock": Clock,
    "/front/scan": LaserScan,
    "/odometry/filtered": Odometry,
    "/imu/data": Imu,
    "/collision": Bool,
    "/sim_bridge/ground_truth": Odometry,
    "/sim_bridge/obstacles": MarkerArray,
}


def start(name, parameters):
    """Start the bridge in a child process, and return its Child."""
    arguments = ["_%s:=%s" % pair for pair in parameters.items()]
    return session().node("sim_bridge", "__name:=" + name, *arguments)


class Robot:
    """Bridge in a child process, the messages since the last `forget`, and a publisher of
    commands.
    """

    def __init__(self, **parameters):
        self.received = {topic: [] for topic in TOPICS}
        self.subscribers = []
        for topic, kind in TOPICS.items():
            # Queue and buffer hold some seconds of scans, because tests look at each message.
            self.subscribers.append(
                rospy.Subscriber(topic, kind, self._keep, (topic,), queue_size=200, buff_size=2**22)
            )
        self.command = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        self.process = start("sim_bridge", parameters)
        self.wait(lambda: self.received["/front/scan"] and self.command.get_num_connections())

    def _keep(self, message, where):
        self.received[where[0]].append(message)

    def wait(self, condition):
        """Wait for condition(), and return its value; fail at once if the bridge ends."""
        return self.process.until(condition)

    def forget(self):
        for messages in self.received.values():
            messages.clear()

    def next(self, topic):
        """Wait for the next message of a topic and return it."""
        messages = self.received[topic]
        earlier_messages = len(messages)
        return self.wait(lambda: len(messages) > earlier_messages and messages[-1])

    def drive(self, v, w, until):
        """Publish commands at 20 Hz of wall time until a condition holds."""

        def driven():
            self.command.publish(twist(v, w))
            time.sleep(0.05)
            return until()

        self.wait(driven)

    @property
    def place(self):
        return position(self.next("/odometry/filtered"))

    @property
    def true_place(self):
        return position(self.next("/sim_bridge/ground_truth"))

    @property
    def speed(self):
        return self.next("/sim_bridge/ground_truth").twist.twist.linear.x

    @property
    def now(self):
        """Simulated time [s]."""
        return self.next("/clock").clock.to_sec()

    def close(self):
        self.process.end()
        for subscriber in self.subscribers:
            subscriber.unregister()
        self.command.unregister()


@pytest.fixture(scope="module")
def robot():
    """Return a bridge for all tests of this file, in their order: the last one ends it."""
    session()
    running = Robot(world="generated:0", seed=3)
    yield running
    running.close()


def position(message):
    """Return the position (x, y) [m] of an Odometry message."""
    return message.pose.pose.position.x, message.pose.pose.position.y


def test_reports_when_it_is_ready(robot):
    robot.wait(lambda: "ready: world generated:0" in robot.process.text)
    assert "pybullet build time" not in robot.process.text
    # The parameter is not set here.
    assert "rosparam set /use_sim_time true" in robot.process.text


def test_topics_have_their_rates_and_frames(robot):
    began = time.monotonic()
    simulated_begin = robot.now
    stopwatch = Kept()
    robot.forget()
    topics = ("/front/scan", "/odometry/filtered", "/imu/data", "/sim_bridge/ground_truth")
    robot.wait(lambda: min(len(robot.received[topic]) for topic in topics) > 60)
    received = {topic: list(messages) for topic, messages in robot.received.items()}

    # Medians, because a busy machine loses some messages.
    for topic in topics:
        intervals = np.diff([message.header.stamp.to_sec() for message in received[topic]])
        assert intervals.min() > 0.01
        assert np.median(intervals) == pytest.approx(0.02, abs=0.002), topic
    clock_intervals = np.diff([message.clock.to_sec() for message in received["/clock"]])
    assert np.median(clock_intervals) == pytest.approx(0.01, abs=0.003)

    # The simulation runs in real time, less what the machine had for others.
    simulated_s = robot.now - simulated_begin
    real_s = time.monotonic() - began
    assert real_s - 0.3 - stopwatch.waiting() < simulated_s < 1.3 * real_s + 0.3

    scan = received["/front/scan"][-1]
    odometry = received["/odometry/filtered"][-1]
    assert scan.header.frame_id == "front_laser"
    assert len(scan.ranges) == 720
    assert scan.angle_min == pytest.approx(-2.35619)
    assert scan.angle_max == pytest.approx(2.35619)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert received["/sim_bridge/ground_truth"][-1].header.frame_id == "world"


def test_frames_of_laser_odometry_and_world_are_published(robot):
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    wait_for(lambda: buffer.can_transform("odom", "front_laser", rospy.Time(0)), "tf")
    laser = buffer.lookup_transform("base_link", "front_laser", rospy.Time(0)).transform.translation
    assert (laser.x, laser.y, laser.z) == (0.055, 0.0, 0.333)
    # The odometry begins at the course's start, without its yaw.
    start_pose = worlds.load("generated:0").course.start
    wait_for(lambda: buffer.can_transform("world", "odom", rospy.Time(0)), "tf of the world")
    origin = buffer.lookup_transform("world", "odom", rospy.Time(0)).transform
    assert (origin.translation.x, origin.translation.y) == pytest.approx(start_pose[:2])
    assert origin.rotation.w == 1.0
    listener.unregister()


def test_obstacles_are_shown(robot):
    world = worlds.load("generated:0")
    markers = rospy.wait_for_message("/sim_bridge/obstacles", MarkerArray, LONGEST).markers
    cylinder_ids = []
    for marker in markers:
        if marker.type == Marker.CYLINDER and marker.action == Marker.ADD:
            cylinder_ids.append(marker.id)
    assert len(cylinder_ids) == len(world.cylinders)
    # RViz keeps markers of the world before otherwise.
    assert markers[0].action == Marker.DELETEALL
    # Of two markers with the same ID, RViz would show one.
    assert len(set(cylinder_ids)) == len(cylinder_ids)


@pytest.mark.fault("14")
@pytest.mark.parametrize("topic", ["/cmd_vel", "/jackal_velocity_controller/cmd_vel"])
def test_drives_on_either_topic_and_stops_when_commands_do(robot, topic):
    on_cmd_vel = robot.command
    if topic != "/cmd_vel":
        robot.command = rospy.Publisher(topic, Twist, queue_size=1)
    wait_for(robot.command.get_num_connections, "connection")
    robot.drive(0.5, 0.0, lambda: robot.speed == pytest.approx(0.5, abs=0.05))
    robot.command = on_cmd_vel

    # The base stops 0.25 s after the last command, and needs some time to brake.
    silent_from = robot.now
    stopwatch = Kept()
    robot.wait(lambda: abs(robot.speed) < 0.02)
    assert robot.now - silent_from < 0.5 + stopwatch.waiting()


def test_commands_that_are_not_finite_are_refused(robot):
    robot.drive(float("nan"), 0.0, lambda: "rejected: send finite numbers" in robot.process.text)
    end_time = robot.now + 0.3
    robot.drive(0.3, float("inf"), lambda: robot.now > end_time)
    assert abs(robot.speed) < 0.02


def test_reset_returns_robot_and_odometry_to_the_start_and_clears_the_costmaps(robot):
    clear_requests = []

    def clear(request):
        clear_requests.append(request)
        return EmptyResponse()

    # Stands for move_base, whose costmaps have obstacles of the old place.
    service = rospy.Service("/move_base/clear_costmaps", Empty, clear)
    robot.drive(0.5, 0.3, lambda: hypot(*robot.place) > 0.2)
    robot.forget()
    reset = rospy.ServiceProxy("/sim_bridge/reset", Empty)
    # Again, if the last command came after the reset and drives the robot off the start.
    robot.wait(lambda: reset() and clear_requests and robot.place == (0.0, 0.0))
    start_pose = worlds.load("generated:0").course.start
    robot.wait(lambda: robot.true_place == pytest.approx(start_pose[:2], abs=1e-3))
    clocks = [message.clock for message in robot.received["/clock"]]
    assert clocks == sorted(clocks)  # ROS time must not jump back.
    service.shutdown("done")


def test_contact_is_reported(robot):
    rospy.ServiceProxy("/sim_bridge/reset", Empty)()
    robot.forget()
    robot.wait(lambda: len(robot.received["/collision"]) > 10)

    def touched():
        """Return whether a contact was reported."""
        return any(message.data for message in robot.received["/collision"])

    assert not touched()
    turn_end = robot.now + 1.0
    # The robot turns to the side wall and drives into it.
    robot.drive(0.0, 1.57, lambda: robot.now > turn_end)
    robot.drive(1.0, 0.0, touched)


def test_changes_the_world_without_a_restart(robot):
    load_world = rospy.ServiceProxy("/sim_bridge/load_world", Trigger)
    rospy.set_param("/sim_bridge/world", "physical_course")
    answer = load_world()
    assert answer.success
    assert answer.message == "world physical_course"
    # The generated worlds have cylinders only. The markers may come after the answer.
    worlds_shown = robot.received["/sim_bridge/obstacles"]
    robot.wait(
        lambda: Marker.CUBE in {marker.type for shown in worlds_shown for marker in shown.markers}
    )
    start_pose = worlds.load("physical_course").course.start
    robot.wait(lambda: robot.true_place == pytest.approx(start_pose[:2], abs=1e-3))

    # There is no such world.
    rospy.set_param("/sim_bridge/world", "generated:5000")
    answer = load_world()
    assert not answer.success
    assert "generated:5000" in answer.message
    assert "\n" not in answer.message


def test_ends_on_interrupt(robot):
    stopwatch = Kept()
    began = time.monotonic()
    assert robot.process.end() == 0
    assert time.monotonic() - began < 3.0 + stopwatch.waiting()
    assert "Traceback" not in robot.process.text


@pytest.mark.parametrize("hertz", [5.0, 10.0, 20.0])
def test_factor_zero_waits_for_commands_at_the_planners_own_rate(monkeypatch, hertz):
    """The bridge waits only for a planner that answers: when the planner's cycle is due, or one
    tick earlier.
    """
    from sim_bridge import ros_bridge

    monkeypatch.setattr(rospy, "get_param", lambda *_: hertz)
    bridge = SimpleNamespace(
        driven=False,
        newest=None,
        period=0.0,
        due=0.0,
        arrived=threading.Condition(),
        commands=[],
        waits=[],
    )
    bridge.simulator = SimpleNamespace(
        state=SimpleNamespace(time=0.0),
        command=lambda *_: bridge.commands.append(bridge.simulator.state.time),
    )
    period = 1.0 / hertz
    planner = SimpleNamespace(due=0.0, cycles=0)  # time of its next cycle [s], and cycles so far

    def plan():
        """Let the planner command if its cycle is due; return whether a command has arrived."""
        # A scan may arrive a tick before the cycle is due.
        earliness = 0.01 if len(bridge.commands) % 2 else 0.0
        if bridge.simulator.state.time >= planner.due - earliness - 1e-6:
            planner.cycles += 1
            planner.due = period * planner.cycles
            ros_bridge.Bridge.on_command(bridge, Twist())
        return bridge.newest is not None

    def wait_for(condition, patience):
        """Stand for the wait for a command, and remember whether one came."""
        has_come = plan()
        bridge.waits.append(has_come)
        return has_come

    bridge.arrived.wait_for = wait_for
    # Four seconds in ticks of 0.01 s
    for _ in range(400):
        ros_bridge.Bridge.take_command(bridge)
        bridge.simulator.state.time += 0.01
        if not bridge.driven:
            plan()
        ros_bridge.Bridge.lock_step(bridge)
    # A wait in vain would cost its whole patience in wall time.
    assert all(bridge.waits)
    assert len(bridge.commands) == pytest.approx(4.0 * hertz, abs=2)
