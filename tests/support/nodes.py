"""Nodes for tests: a simulated Jackal, a move_base that misbehaves, and the stack of both.

The Jackal runs in a thread of the test process, in wall time. Tests can switch off its topics and
alter its scans.

The stand-in for move_base is a program. It has move_base's dynamic_reconfigure servers, which
misbehave on demand:

    python -m tests.support.nodes [--spelling kinetic] [--layer NAME] [--without NAME] [--robot
    NAME] [--text CODE]

These ROS parameters are lists of servers that misbehave. Servers in /fake/refuse raise an error.
Those in /fake/hold keep and report their old values. Those in /fake/lie keep their old values, but
report the new ones. Those in /fake/late publish their values 0.2 s late. Those in /fake/hang do not
answer until they are removed from the list.
"""

import argparse
import itertools
import sys
import threading
import time
import xmlrpc.client
from types import SimpleNamespace
from typing import List, NamedTuple, Tuple

import actionlib
import numpy as np
import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from applr_ros1.msg import Decision, Parameters
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.encoding import decode_config, encode_config
from dynamic_reconfigure.server import Server
from dynamic_reconfigure.srv import ReconfigureResponse
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Twist, Vector3
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Time
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import compose
from applr_ros1.nodes.conversions import pose_stamped
from applr_ros1.planner.parameters import check
from applr_ros1.planner.parameters.declarations import SERVERS, servers
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE
from applr_ros1.robots import load
from tests.support import ros
from tests.support.robots import (
    ANGLE_MAX,
    ANGLE_MIN,
    INCREMENT,
    JACKAL_PARAMETERS,
    LASER_X,
    RANGE_MAX,
    RANGE_MIN,
    ToyRobot,
)
from tests.support.ros import wait_for

TICK = 0.01  # simulation step [s]
COMMAND_TIMEOUT = 0.25  # age of a command after which the base stops [s]


class Command(NamedTuple):
    """Command that a base has received: wall time [s], speed [m/s] and turn rate [rad/s]."""

    stamp: float
    v: float
    w: float

    @property
    def velocity(self) -> Tuple[float, float]:
        """Speed and turn rate."""
        return self.v, self.w


class FakeJackal:
    """Robot that follows /cmd_vel among round obstacles and publishes scan, odometry, tf and
    optionally /clock.

    Args:
        circles: Obstacles (n, 3) of x, y, radius [m].
        pose: Initial pose (x, y, yaw).
        clock: Initial time of /clock [s], from which stamps are taken; None for wall time without
            /clock.
    """

    ticking = True

    def __init__(self, circles=(), pose=(0.0, 0.0, 0.0), clock=None):
        self.robot = ToyRobot(pose, circles)
        self._moving = threading.Lock()  # A step under way would take back what put() does.
        self.clock = clock
        self.scans = self.transforms = True
        # Function that alters each scan before publication.
        self.bend = lambda scan: scan
        self.commands = []  # received Commands, the latest one last
        self._command = 0.0, 0.0
        self._endpoints = []
        self._tf = self._publisher("/tf", TFMessage)
        self._odometry = self._publisher("/odometry/filtered", Odometry)
        self._scan = self._publisher("/front/scan", LaserScan)
        self._clock = self._publisher("/clock", Clock)
        laser_mount = transform("base_link", "front_laser", (LASER_X, 0.0, 0.0), self.now())
        static_tf = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        static_tf.publish(TFMessage([laser_mount]))
        # Without tcp_nodelay, Nagle's algorithm can delay a command by 40 ms.
        command_subscriber = rospy.Subscriber(
            "/cmd_vel", Twist, self._take, queue_size=50, tcp_nodelay=True
        )
        self._endpoints += [static_tf, command_subscriber]
        # Last, because the thread uses all of the above.
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _publisher(self, topic, kind):
        publisher = rospy.Publisher(topic, kind, queue_size=50)
        self._endpoints.append(publisher)
        return publisher

    def close(self):
        """End the thread and the robot's topics."""
        self._over.set()
        self._thread.join(2.0)
        for endpoint in self._endpoints:
            endpoint.unregister()

    def now(self):
        """Return the time of stamps: that of /clock, or wall time."""
        return rospy.Time.from_sec(time.time() if self.clock is None else self.clock)

    def put(self, pose, circles=None):
        """Move the robot to a pose and, if given, replace the obstacles."""
        with self._moving:
            self.robot.pose = pose
        if circles is not None:
            self.robot.circles = ToyRobot(circles=circles).circles

    def _take(self, message):
        self._command = message.linear.x, message.angular.z
        self.commands.append(Command(time.time(), *self._command))

    def _run(self):
        due_time = time.time()
        for n in itertools.count(1):
            # Wall time paces the simulation. A late step is made up for by shorter pauses: the
            # scans keep their 20 Hz on a busy machine.
            due_time += TICK
            if self._over.wait(max(0.0, due_time - time.time())):
                return
            if self.ticking:
                if self.clock is not None:
                    self.clock += TICK
                    self._clock.publish(self.now())
                self._tick(n, self.now())

    def _tick(self, n, stamp):
        is_fresh = self.commands and time.time() - self.commands[-1].stamp < COMMAND_TIMEOUT
        with self._moving:
            self.robot.drive(self._command if is_fresh else None, TICK)
        # Odometry comes at 50 Hz and scans at 20 Hz, as from the real robot.
        if n % 2 == 0:
            self.publish_pose(stamp)
        if n % 5 == 0 and self.scans:
            self._publish_scan(stamp, self.robot.ranges())

    def _publish_scan(self, stamp, ranges):
        self._scan.publish(self.bend(scan_message(ranges, stamp)))

    def publish_pose(self, stamp):
        """Publish tf and odometry of the present pose."""
        if self.transforms:
            self._tf.publish(TFMessage([odometry_transform(self.robot, stamp)]))
        self._odometry.publish(odometry_message(self.robot, stamp))


class Standing(FakeJackal):
    """Jackal at rest that publishes a plan and optionally a goal, and records the messages of the
    applr node.
    """

    def __init__(self):
        self.reset()
        self.ticking = False  # The thread must not tick before the publishers exist.
        super().__init__(pose=self.pose)
        self.robot.twist = self.twist
        self._plan = self._publisher("/move_base/NavfnROS/plan", Path)
        self._status = self._publisher("/move_base/status", GoalStatusArray)
        self._subscribe("/applr/decision", Decision, self._on_decision)
        self._subscribe("/applr/course_end", Decision, lambda end: self.ends.append(end))
        self._subscribe("/applr/heartbeat", Time, self._on_heartbeat)
        self._subscribe("/applr/parameters", Parameters, self._on_parameters)
        self._subscribe("/diagnostics", DiagnosticArray, self._on_diagnostics)
        self.ticking = True

    def _subscribe(self, topic, kind, callback):
        self._endpoints.append(rospy.Subscriber(topic, kind, callback, queue_size=50))

    def reset(self):
        """Restore the initial pose, scan and plan, and forget all messages."""
        self.ranges = np.random.default_rng(0).uniform(0.3, 4.0, 720).astype(np.float32)
        self.pose = (0.5, -0.25, 0.4)
        self.twist = (0.3, -0.1)
        path_x = np.linspace(0.5, 5.0, 180)
        self.path = np.column_stack([path_x, np.sin(np.linspace(0, 2, 180))])
        self.goal = self.clock = None
        self.statuses = True  # whether move_base's status is published
        self.decisions = []
        self.messages = []
        self.ends = []
        self.beats = []
        self.parameters = []
        self.values = {}

    def count(self, key):
        """Return a count of /diagnostics, 0 before the first message."""
        return int(self.values.get(key, 0))

    def _on_decision(self, message):
        self.decisions.append(decided(message))
        self.messages.append(message)

    def _on_heartbeat(self, message):
        self.beats.append(message.data.to_sec())

    def _on_parameters(self, message):
        self.parameters.append(list(message.values))

    def _on_diagnostics(self, message):
        status = message.status[0]
        # Replaced at once, because a test may read while this callback runs.
        self.values = {**values_of(status), "level": status.level, "message": status.message}

    def _tick(self, n, stamp):
        if n % 2:
            return
        # Read once, because the test's thread may change it meanwhile.
        goal = self.goal
        if self.statuses:
            status = GoalStatusArray()
            if goal is not None:
                status.status_list = [GoalStatus(GoalID(id=goal), GoalStatus.ACTIVE, "")]
            status.header.stamp = stamp
            self._status.publish(status)
        self.publish_pose(stamp)
        self._publish_scan(stamp, self.ranges)
        if goal is not None:
            poses = [pose_stamped((x, y, 0.0), "odom", stamp) for x, y in self.path]
            plan = Path(poses=poses)
            plan.header = plan.poses[0].header
            self._plan.publish(plan)


def scan_message(ranges, stamp):
    """Return a scan of the Jackal's laser."""
    limits = {
        "angle_min": ANGLE_MIN,
        "angle_max": ANGLE_MAX,
        "range_min": RANGE_MIN,
        "range_max": RANGE_MAX,
    }
    scan = LaserScan(angle_increment=INCREMENT, ranges=ranges.tolist(), **limits)
    scan.header.stamp = stamp
    scan.header.frame_id = "front_laser"
    return scan


def odometry_transform(robot, stamp):
    """Return the transform of a ToyRobot's centre in the odometry frame."""
    return transform("odom", "base_link", compose((0.0, 0.0, 0.0), robot.pose), stamp)


def odometry_message(robot, stamp):
    """Return the odometry of a ToyRobot."""
    odom_to_base = odometry_transform(robot, stamp)
    odometry = Odometry(child_frame_id="base_link")
    odometry.header = odom_to_base.header
    odometry.pose.pose.orientation = odom_to_base.transform.rotation
    odometry.pose.pose.position.x, odometry.pose.pose.position.y = robot.pose[:2]
    odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = robot.twist
    return odometry


def mount_laser(ros):
    """Tell the nodes of an OfflineRos where the Jackal's laser is."""
    laser_mount = transform("base_link", "front_laser", (LASER_X, 0.0, 0.0), rospy.Time(0))
    ros.tf.set_transform_static(laser_mount, "test")


def sense(ros, robot, scan_topics=("front/scan",)):
    """Send transform, odometry and scans of a ToyRobot to the nodes of an OfflineRos."""
    stamp = ros.time
    ros.tf.set_transform(odometry_transform(robot, stamp), "test")
    ros.callbacks["odometry/filtered"](odometry_message(robot, stamp))
    for topic in scan_topics:
        ros.callbacks[topic](scan_message(robot.ranges(), stamp))


def decided(message):
    """Return an applr_ros1/Decision as a dict. "theta" is empty if the method's output was
    rejected.
    """
    return {
        "theta_prev": dict(zip(message.before.names, message.before.values)),
        "theta": dict(zip(message.after.names, message.after.values)),
        "stamp": str(message.header.stamp),
        "refused": message.refused,
    }


def observed(message):
    """Return the paper's observation (729,) from an applr_ros1/Decision of a Jackal."""
    scan = np.array(message.ranges, np.float32), message.angle_min, message.angle_increment
    # The message has the poses of plan and robot in one frame, so one pose serves for both.
    robot_pose = (message.x, message.y, message.yaw)
    twist = (message.v, message.w)
    plan = np.column_stack([message.plan_x, message.plan_y])
    no_movers = np.zeros((0, 4))
    inputs = Seen(scan, message.elapsed, robot_pose, twist, robot_pose, plan, no_movers)
    return Context.of(np.array(message.before.values), inputs, SPACE, LAYOUT).observation


def values_of(status):
    """Return the values {key: text} of a diagnostic_msgs/DiagnosticStatus."""
    return {pair.key: pair.value for pair in status.values}


def transform(parent, child, pose, stamp):
    """Return the geometry_msgs/TransformStamped of a frame at a pose (x, y, yaw) in its parent."""
    stamped_pose = pose_stamped(pose, parent, stamp)
    translation = Vector3(pose[0], pose[1], 0.0)
    return TransformStamped(
        stamped_pose.header, child, Transform(translation, stamped_pose.pose.orientation)
    )


# The stack of move_base and the Jackal

# Codes of actionlib's GoalStatus, in its order.
PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = range(5)
# Two round posts left of the way along x, (x, y, radius) [m]: the robot passes, but its scans are
# not empty.
POSTS = [(1.5, 0.8, 0.15), (1.5, 1.4, 0.15)]
PLANNER = "/move_base/TrajectoryPlannerROS"


def start(master, parameters=None, sim_time=False, name="move_base", program="move_base"):
    """Start the node, or a stand-in for it, and return its Child once it is ready."""
    rospy.set_param("/" + name, parameters or JACKAL_PARAMETERS)
    rospy.set_param("/use_sim_time", sim_time)
    child = master.node(program, "odom:=odometry/filtered")
    child.until("ready")
    # Nodes read the parameter at their start. This process, and nodes that start later, use wall
    # time.
    rospy.set_param("/use_sim_time", False)
    return child


@pytest.fixture(scope="module")
def master():
    """Return the master of this process's tests."""
    return ros.session()


@pytest.fixture(scope="module")
def stack(master):
    """Start move_base and a Jackal for all tests of a file; return them with move_base's client."""
    jackal = FakeJackal(POSTS)
    node = start(master)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(ros.LONGEST))
    yield SimpleNamespace(node=node, jackal=jackal, client=client)
    jackal.close()
    # A crash at the end would pass unseen otherwise.
    assert node.end() == 0, node.text


@pytest.fixture
def idle(stack):
    """Return the stack in its initial state: robot at the origin, no goal, all topics on."""
    jackal = stack.jackal
    jackal.scans = jackal.transforms = True
    jackal.bend = lambda scan: scan
    if stack.client.get_state() in (PENDING, ACTIVE):
        # A call of cancel_all_goals uses another connection, and could end the next goal.
        stack.client.cancel_goal()
        finish(stack.client)
    wait_for(lambda: jackal.robot.twist == (0.0, 0.0), "standstill")
    jackal.put((0.0, 0.0, 0.0), POSTS)
    # Scans of the old place are on their way. They must not mark the costmaps after these have
    # been cleared.
    time.sleep(0.2)
    rospy.ServiceProxy("/move_base/clear_costmaps", Empty)()
    # Commands that move_base sent before are on their way, too.
    time.sleep(0.15)
    jackal.commands.clear()
    return stack


def goal(x, y=0.0, yaw=0.0, frame="odom", quaternion=None):
    """Return a goal of move_base. A quaternion (x, y, z, w) replaces the yaw, whether valid or
    not.
    """
    target_pose = pose_stamped((x, y, yaw), frame, rospy.Time())
    if quaternion is not None:
        target_pose.pose.orientation = Quaternion(*quaternion)
    return MoveBaseGoal(target_pose=target_pose)


class Collected(NamedTuple):
    """A subscriber, and the list that collects its messages."""

    subscriber: rospy.Subscriber
    messages: List[rospy.Message]


def collect(topic, kind):
    """Subscribe to a topic that has a publisher, and collect its messages."""
    messages = []
    subscriber = rospy.Subscriber(topic, kind, messages.append)
    wait_for(subscriber.get_num_connections, topic)
    time.sleep(0.2)  # The publisher learns of the connection a moment later.
    return Collected(subscriber, messages)


def node_api(master):
    """Return a proxy of the XML-RPC server of the move_base node."""
    # The master answers (status, message, URI of the node).
    node_uri = xmlrpc.client.ServerProxy(master.uri).lookupNode("/test", "/move_base")[2]
    return xmlrpc.client.ServerProxy(node_uri)


def connected(master, topic, node):
    """Return whether move_base and `node` are connected by a topic."""
    # A connection is (id, node, direction, transport, topic, ...).
    connections = node_api(master).getBusInfo("/test")[2]
    return any((link[1], link[4]) == (node, topic) for link in connections)


class Finished(NamedTuple):
    """How a goal has ended: one of the codes of GoalStatus, and a text for people."""

    state: int
    text: str


def finish(client):
    """Wait for the end of the client's goal."""
    assert client.wait_for_result(rospy.Duration(ros.LONGEST)), "no result"
    return Finished(client.get_state(), client.get_goal_status_text())


# The stand-in for move_base

# Names of the two weights in ROS Kinetic's move_base.
KINETIC = {"path_distance_bias": "pdist_scale", "goal_distance_bias": "gdist_scale"}


def config_type(parameters, code=""):
    """Return dynamic_reconfigure's description of a group of parameters, as a .cfg file would
    generate it.

    With `code`, max_vel_x is a string whose choices the server describes by this Python code.
    """
    descriptions = []
    for parameter_name, parameter in parameters:
        description = {
            "name": parameter_name,
            "type": parameter.type,
            "default": parameter.default,
            "description": parameter.doc,
            "min": parameter.min,
            "max": parameter.max,
            "level": 0,
            "edit_method": "",
        }
        if code and parameter_name == "max_vel_x":
            description.update(type="str", edit_method=code)
        descriptions.append(description)
    # The fields of the group around all parameters that dynamic_reconfigure reads
    group = {
        "name": "Default",
        "type": "",
        "id": 0,
        "parent": 0,
        "state": True,
        "groups": [],
        "parameters": descriptions,
    }

    def by_name(field):
        """Return a field of each parameter {name: value}."""
        return {description["name"]: description[field] for description in descriptions}

    return SimpleNamespace(
        config_description=group,
        min=by_name("min"),
        max=by_name("max"),
        defaults=by_name("default"),
        level=by_name("level"),
        type=by_name("type"),
    )


class Liar(Server):
    """Server that publishes its values late if it is in /fake/late, and confirms without applying
    if in /fake/lie.
    """

    def _set_callback(self, request):
        server_name = self.ns.rstrip("/")
        if server_name in rospy.get_param("/fake/late", []):
            topic = self.update_topic

            def publish_late(message):
                threading.Timer(0.2, topic.publish, [message]).start()

            self.update_topic = SimpleNamespace(publish=publish_late)
            try:
                return super()._set_callback(request)
            finally:
                self.update_topic = topic
        if server_name not in rospy.get_param("/fake/lie", []):
            return super()._set_callback(request)
        # Only the answer claims the new values: the topic still has the old ones.
        requested_values = decode_config(request.config, self.type.config_description)
        self.update_topic.publish(encode_config(self.config))
        return ReconfigureResponse(encode_config({**self.config, **requested_values}))


def serve(name, parameters, code=""):
    """Start the server `name`."""
    in_force = {}  # "config" are the values in force; empty until the server has its first ones

    def callback(config, level):
        # The first call comes from the server's constructor, which must not fail.
        if in_force:
            while name in rospy.get_param("/fake/hang", []):
                rospy.rostime.wallsleep(0.05)
            if name in rospy.get_param("/fake/refuse", []):
                raise RuntimeError("refused on request")
            if name in rospy.get_param("/fake/hold", []):
                return in_force["config"].copy()
        in_force["config"] = config.copy()
        return config

    return Liar(config_type(parameters, code), callback, name)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--spelling", default="noetic")
    parser.add_argument("--layer", default="inflater_layer")
    parser.add_argument("--without", default="")
    parser.add_argument(
        "--robot", default="", help="robot whose move_base has the servers to start instead"
    )
    parser.add_argument(
        "--text", default="", metavar="CODE", help="code of the choices of max_vel_x, a string"
    )
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("move_base")
    served = {}  # {name of a server: its parameters}
    if arguments.robot:
        declared = servers(check.complete(load(arguments.robot).parameters()))
        for role, server in declared.items():
            served[role] = server.parameters
    else:
        served["TrajectoryPlannerROS"] = [
            parameter
            for parameter in SERVERS["TrajectoryPlannerROS"]
            if parameter.name != arguments.without
        ]
        for costmap in ("local_costmap", "global_costmap"):
            served[costmap] = SERVERS[costmap]
            served[costmap + "/" + arguments.layer] = SERVERS["local_costmap/inflater_layer"]
            # Another layer, which the client must not mistake for that of the inflation.
            served[costmap + "/a_layer"] = SERVERS["local_costmap/obstacles_layer"]
    renamed = KINETIC if arguments.spelling == "kinetic" else {}
    for role, parameters in served.items():
        # The server of move_base itself has no name of its own.
        server_name = rospy.get_name() + "/" + role if role else rospy.get_name()
        named_parameters = []
        for parameter in parameters:
            served_name = renamed.get(parameter.name, parameter.name)
            named_parameters.append((served_name, parameter))
        serve(server_name, named_parameters, arguments.text)
    print("all up", flush=True)  # Tests wait for this line.
    rospy.spin()


if __name__ == "__main__":
    sys.exit(main())
