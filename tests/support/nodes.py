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
        self.clock = clock
        self.scans = self.transforms = True
        # Function that alters each scan before publication.
        self.bend = lambda scan: scan
        self.commands = []  # (wall time, v, w)
        self._command = 0.0, 0.0
        self._ends = []
        self._tf = self._publisher("/tf", TFMessage)
        self._odometry = self._publisher("/odometry/filtered", Odometry)
        self._scan = self._publisher("/front/scan", LaserScan)
        self._clock = self._publisher("/clock", Clock)
        mounted = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        mounted.publish(
            TFMessage([transform("base_link", "front_laser", (LASER_X, 0.0, 0.0), self.now())])
        )
        self._ends += [
            mounted,
            rospy.Subscriber("/cmd_vel", Twist, self._take, queue_size=50, tcp_nodelay=True),
        ]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _publisher(self, topic, kind):
        self._ends.append(rospy.Publisher(topic, kind, queue_size=50))
        return self._ends[-1]

    def close(self):
        self._over.set()
        self._thread.join(2.0)
        for end in self._ends:
            end.unregister()

    def now(self):
        return rospy.Time.from_sec(time.time() if self.clock is None else self.clock)

    def put(self, pose, circles=None):
        """Move the robot to a pose and, if given, replace the obstacles."""
        self.robot.pose = pose
        if circles is not None:
            self.robot.circles = ToyRobot(circles=circles).circles

    def _take(self, message):
        self._command = message.linear.x, message.angular.z
        self.commands.append((time.time(),) + self._command)

    def _run(self):
        due = time.time()
        for n in itertools.count(1):
            due += TICK
            if self._over.wait(max(0.0, due - time.time())):
                return
            if self.ticking:
                if self.clock is not None:
                    self.clock += TICK
                    self._clock.publish(self.now())
                self._tick(n, self.now())

    def _tick(self, n, stamp):
        fresh = self.commands and time.time() - self.commands[-1][0] < COMMAND_TIMEOUT
        self.robot.drive(self._command if fresh else None, TICK)
        if n % 2 == 0:
            self._publish_pose(stamp)
        if n % 5 == 0 and self.scans:
            self._publish_scan(stamp, self.robot.ranges())

    def _publish_scan(self, stamp, ranges):
        limits = {
            "angle_min": ANGLE_MIN,
            "angle_max": ANGLE_MAX,
            "range_min": RANGE_MIN,
            "range_max": RANGE_MAX,
        }
        scan = LaserScan(angle_increment=INCREMENT, ranges=ranges.tolist(), **limits)
        scan.header.stamp = stamp
        scan.header.frame_id = "front_laser"
        self._scan.publish(self.bend(scan))

    def _publish_pose(self, stamp):
        placed = transform("odom", "base_link", compose((0.0, 0.0, 0.0), self.robot.pose), stamp)
        if self.transforms:
            self._tf.publish(TFMessage([placed]))
        odometry = Odometry(child_frame_id="base_link")
        odometry.header = placed.header
        odometry.pose.pose.orientation = placed.transform.rotation
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = self.robot.pose[:2]
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self.robot.twist
        self._odometry.publish(odometry)


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
        for topic, kind, callback in (
            ("/applr/decision", Decision, self._on_decision),
            ("/applr/course_end", Decision, lambda m: self.ends.append(m)),
            ("/applr/heartbeat", Time, lambda m: self.beats.append(m.data.to_sec())),
            ("/applr/parameters", Parameters, lambda m: self.parameters.append(list(m.values))),
            ("/diagnostics", DiagnosticArray, self._on_diagnostics),
        ):
            self._ends.append(rospy.Subscriber(topic, kind, callback, queue_size=50))
        self.ticking = True

    def reset(self):
        self.ranges = np.random.default_rng(0).uniform(0.3, 4.0, 720).astype(np.float32)
        self.pose = (0.5, -0.25, 0.4)
        self.twist = (0.3, -0.1)
        self.path = np.column_stack([np.linspace(0.5, 5.0, 180), np.sin(np.linspace(0, 2, 180))])
        self.goal = self.clock = None
        self.statuses = True  # whether move_base's status is published
        self.decisions = []
        self.messages = []
        self.ends = []
        self.beats = []
        self.parameters = []
        self.values = {}

    def count(self, key):
        return int(self.values.get(key, 0))

    def _on_decision(self, message):
        self.decisions.append(decided(message))
        self.messages.append(message)

    def _on_diagnostics(self, message):
        status = message.status[0]
        self.values = {
            **{v.key: v.value for v in status.values},
            "level": status.level,
            "message": status.message,
        }

    def _tick(self, n, stamp):
        if n % 2:
            return
        goal = self.goal
        if self.statuses:
            active = (
                [GoalStatus(GoalID(id=goal), GoalStatus.ACTIVE, "")] if goal is not None else []
            )
            status = GoalStatusArray(status_list=active)
            status.header.stamp = stamp
            self._status.publish(status)
        self._publish_pose(stamp)
        self._publish_scan(stamp, self.ranges)
        if goal is not None:
            plan = Path(poses=[pose_stamped((x, y, 0.0), "odom", stamp) for x, y in self.path])
            plan.header = plan.poses[0].header
            self._plan.publish(plan)


def decided(message):
    """Return an applr_ros1/Decision as a dict. "theta" is empty if the method's output was
    rejected.
    """
    sets = {
        key: dict(zip(of.names, of.values))
        for key, of in (("theta_prev", message.before), ("theta", message.after))
    }
    return dict(sets, stamp=str(message.header.stamp), refused=message.refused)


def observed(message):
    """Return the paper's observation (729,) from an applr_ros1/Decision of a Jackal."""
    scan = np.array(message.ranges, np.float32), message.angle_min, message.angle_increment
    pose = (message.x, message.y, message.yaw)
    plan = np.column_stack([message.plan_x, message.plan_y])
    seen = Seen(scan, message.elapsed, pose, (message.v, message.w), pose, plan, np.zeros((0, 4)))
    return Context.of(np.array(message.before.values), seen, SPACE, LAYOUT).observation


def transform(parent, child, pose, stamp):
    """Return the geometry_msgs/TransformStamped of a frame at a pose (x, y, yaw) in its parent."""
    placed = pose_stamped(pose, parent, stamp)
    place = Vector3(pose[0], pose[1], 0.0)
    return TransformStamped(placed.header, child, Transform(place, placed.pose.orientation))


# The stack of move_base and the Jackal

PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = range(5)
POSTS = [(1.5, 0.8, 0.15), (1.5, 1.4, 0.15)]
PLANNER = "/move_base/TrajectoryPlannerROS"


def start(master, parameters=None, sim_time=False, name="move_base"):
    """Start the node and return its Child once it is ready."""
    rospy.set_param("/" + name, parameters or JACKAL_PARAMETERS)
    rospy.set_param("/use_sim_time", sim_time)
    child = master.node("move_base", "odom:=odometry/filtered")
    child.until("ready")
    rospy.set_param("/use_sim_time", False)
    return child


@pytest.fixture(scope="module")
def master():
    return ros.session()


@pytest.fixture(scope="module")
def stack(master):
    jackal = FakeJackal(POSTS)
    node = start(master)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(ros.LONGEST))
    yield SimpleNamespace(node=node, jackal=jackal, client=client)
    jackal.close()
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
    time.sleep(0.2)
    rospy.ServiceProxy("/move_base/clear_costmaps", Empty)()
    time.sleep(0.15)
    jackal.commands.clear()
    return stack


def goal(x, y=0.0, yaw=0.0, frame="odom", quaternion=None):
    """Return a goal of move_base. A quaternion (x, y, z, w) replaces the yaw, whether valid or
    not.
    """
    target = pose_stamped((x, y, yaw), frame, rospy.Time())
    if quaternion is not None:
        target.pose.orientation = Quaternion(*quaternion)
    return MoveBaseGoal(target_pose=target)


def collect(topic, kind):
    """Subscribe to a topic that has a publisher; return (subscriber, list that collects its
    messages).
    """
    messages = []
    subscriber = rospy.Subscriber(topic, kind, messages.append)
    wait_for(subscriber.get_num_connections, topic)
    time.sleep(0.2)  # The publisher learns of the connection a moment later.
    return subscriber, messages


def node_api(master):
    """Return a proxy of the XML-RPC server of the move_base node."""
    uri = xmlrpc.client.ServerProxy(master.uri).lookupNode("/test", "/move_base")[2]
    return xmlrpc.client.ServerProxy(uri)


def connected(master, topic, node):
    """Return whether move_base and `node` are connected by a topic."""
    return any(
        (line[1], line[4]) == (node, topic) for line in node_api(master).getBusInfo("/test")[2]
    )


def finish(client):
    assert client.wait_for_result(rospy.Duration(ros.LONGEST)), "no result"
    return client.get_state(), client.get_goal_status_text()


# The stand-in for move_base

KINETIC = {"path_distance_bias": "pdist_scale", "goal_distance_bias": "gdist_scale"}


def config_type(parameters, code=""):
    """Return dynamic_reconfigure's description of a group of parameters, as a .cfg file would
    generate it.

    With `code`, max_vel_x is a string whose choices the server describes by this Python code.
    """
    always = {"level": 0, "edit_method": ""}
    rows = [
        dict(
            always,
            name=name,
            type=p.type,
            default=p.default,
            description=p.doc,
            min=p.min,
            max=p.max,
        )
        for name, p in parameters
    ]
    for row in (row for row in rows if code and row["name"] == "max_vel_x"):
        row.update(type="str", edit_method=code)
    names = {
        "name": "Default",
        "parentname": "Default",
        "upper": "DEFAULT",
        "lower": "groups",
        "field": "default",
    }
    kinds = {"type": "", "class": "DEFAULT", "parentclass": "", "cstate": "true"}
    group = {
        **names,
        **kinds,
        "id": 0,
        "parent": 0,
        "state": True,
        "groups": [],
        "parameters": rows,
    }
    return SimpleNamespace(
        config_description=group,
        min={r["name"]: r["min"] for r in rows},
        max={r["name"]: r["max"] for r in rows},
        defaults={r["name"]: r["default"] for r in rows},
        level={r["name"]: 0 for r in rows},
        type={r["name"]: r["type"] for r in rows},
    )


class Liar(Server):
    """Server that publishes its values late if it is in /fake/late, and confirms without applying
    if in /fake/lie.
    """

    def _set_callback(self, request):
        if self.ns.rstrip("/") in rospy.get_param("/fake/late", []):
            topic = self.update_topic
            late = SimpleNamespace(
                publish=lambda message: threading.Timer(0.2, topic.publish, [message]).start()
            )
            self.update_topic = late
            try:
                return super()._set_callback(request)
            finally:
                self.update_topic = topic
        if self.ns.rstrip("/") not in rospy.get_param("/fake/lie", []):
            return super()._set_callback(request)
        asked = decode_config(request.config, self.type.config_description)
        self.update_topic.publish(encode_config(self.config))
        return ReconfigureResponse(encode_config({**self.config, **asked}))


def serve(name, parameters, code=""):
    """Start the server `name`."""
    begun = []

    def callback(config, level):
        while begun and name in rospy.get_param("/fake/hang", []):
            rospy.rostime.wallsleep(0.05)
        if begun and name in rospy.get_param("/fake/refuse", []):
            raise RuntimeError("refused on request")
        if begun and name in rospy.get_param("/fake/hold", []):
            return begun[-1].copy()
        begun[:] = [config.copy()]
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
    args = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("move_base")
    if args.robot:
        declared = servers(check.complete(load(args.robot).parameters()))
        served = {name: server.parameters for name, server in declared.items()}
    else:
        served = {
            "TrajectoryPlannerROS": [
                p for p in SERVERS["TrajectoryPlannerROS"] if p.name != args.without
            ]
        }
        for costmap in ("local_costmap", "global_costmap"):
            served[costmap] = SERVERS[costmap]
            served[costmap + "/" + args.layer] = SERVERS["local_costmap/inflater_layer"]
            served[costmap + "/a_layer"] = SERVERS["local_costmap/obstacles_layer"]
    renamed = KINETIC if args.spelling == "kinetic" else {}
    named = {
        rospy.get_name() + ("/" + name if name else ""): parameters
        for name, parameters in served.items()
    }
    for full, parameters in named.items():
        serve(full, [(renamed.get(p.name, p.name), p) for p in parameters], args.text)
    print("all up", flush=True)
    rospy.spin()


if __name__ == "__main__":
    sys.exit(main())
