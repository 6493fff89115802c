"""A robot's stack in a namespace, beside a second simulated robot: names, frames, clock, sight, recording, replay.

tests/launch/test_launch_arguments.py loads two stacks in namespaces without starting them.
"""

import math

import pytest
import rosbag
import rosgraph
import rospy
from applr_ros1.msg import Parameters
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from tests.support import ROOT
from tests.support.ros_harness import session, wait_for

pytestmark = pytest.mark.ros
SHARED = {"/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/use_sim_time"}
NODES = ("applr", "move_base", "sim_bridge", "collision_monitor", "movers")
STARTS = {"robot1": (-3.0, 1.2, 1.57), "robot2": (-1.5, 3.8, -1.57)}  # in sight of each other
RADII = 0.2, 0.5  # m, of the cylinder as which one robot sees the other
LAUNCH = """<launch>
  <group ns="robot1">
    <include file="{file}">
      <arg name="tf_prefix" value="robot1"/>
      <arg name="simulator" value="kinematic"/>
      <arg name="goal" value="0 3 1.57"/> <!-- away from robot2, or no plan leads there once it is seen -->
      <arg name="record" value="{bag}"/>
    </include>
    <param name="sim_bridge/start" value="{start}"/>
    <param name="sim_bridge/others" value="/robot2"/>
  </group>
</launch>"""


def names_of(node):
    """Topics and services of a node, from the master."""
    publishers, subscribers, services = rosgraph.Master("/pytest").getSystemState()
    return {name for group in (publishers, subscribers, services) for name, nodes in group if node in nodes}


class Watched:
    """The two robots' frames, places in the world and scans, as they come."""

    def __init__(self):
        self.frames, self.places, self.scans, self.decided = set(), {}, {}, []
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, self.keep_frames)
        for name in STARTS:
            rospy.Subscriber("/%s/sim_bridge/ground_truth" % name, Odometry, self.keep_place, name)
            rospy.Subscriber("/%s/front/scan" % name, LaserScan, lambda m, name=name: self.scans.__setitem__(name, m))
        rospy.Subscriber("/robot1/applr/decision", rospy.AnyMsg, self.decided.append)

    def keep_frames(self, message):
        self.frames.update(name for t in message.transforms for name in (t.header.frame_id, t.child_frame_id))

    def keep_place(self, message, name):
        at, turned = message.pose.pose.position, message.pose.pose.orientation
        self.places[name] = at.x, at.y, 2.0 * math.atan2(turned.z, turned.w)

    def detects(self, name, other):
        """A beam of the robot's scan ends where the other one is, as a cylinder."""
        scan, (x, y, yaw), (to_x, to_y, _) = self.scans[name], self.places[name], self.places[other]
        bearing = math.atan2(to_y - y, to_x - x) - yaw
        short = math.hypot(to_x - x, to_y - y) - scan.ranges[round((bearing - scan.angle_min) / scan.angle_increment)]
        return RADII[0] < short < RADII[1]


@pytest.mark.slow
def test_a_stack_in_a_namespace_beside_another_robot(tmp_path):
    master, bag, file = session(), tmp_path / "a.bag", tmp_path / "robot1.launch"
    stack = ROOT / "applr_ros1" / "launch" / "jackal_applr.launch"
    start = {name: "%g %g %g" % place for name, place in STARTS.items()}
    file.write_text(LAUNCH.format(file=stack, bag=bag, start=start["robot1"]))
    watched = Watched()
    rospy.set_param("/use_sim_time", True)
    launched = master.spawn("roslaunch", file)
    words = "_tf_prefix:=robot2", "_start:=" + start["robot2"], "_others:=/robot1", "_clock:=false"
    second = master.node("sim_bridge", "__ns:=/robot2", "_simulator:=kinematic", *words)
    try:
        launched.until(lambda: len(watched.decided) >= 2 and len(watched.scans) == len(watched.places) == 2)
        for names in (("robot1", "robot2"), ("robot2", "robot1")):
            launched.until(lambda names=names: watched.detects(*names))
        launched.until(lambda: math.dist(watched.places["robot1"][:2], STARTS["robot1"][:2]) > 1.5)
        for name in NODES:
            outside = {n for n in names_of("/robot1/" + name) if not n.startswith("/robot1/")}
            assert outside <= SHARED | {"/robot2/sim_bridge/ground_truth"}, (name, outside - SHARED)
        publishers, _, _ = rosgraph.Master("/pytest").getSystemState()
        assert dict(publishers)["/clock"] == ["/robot1/sim_bridge"]
        assert {name for name in watched.frames if not name.startswith(("robot1/", "robot2/"))} == {"world"}
        assert rospy.ServiceProxy("/robot1/applr/enable", SetBool)(False).success
        assert "no sign of the applr node" not in launched.text
    finally:
        second.end()
        launched.end()
        rospy.set_param("/use_sim_time", False)
    assert "Traceback" not in launched.text + second.text
    wait_for(bag.exists, "the bag")
    with rosbag.Bag(str(bag)) as recorded:
        topics = recorded.get_type_and_topic_info().topics
        stamps = [stamp.to_sec() for _, _, stamp in recorded.read_messages("/robot1/applr/decision")]
    assert {"/robot1/front/scan", "/robot1/move_base/TrajectoryPlannerROS/local_plan", "/tf"} <= set(topics)
    assert not any(topic.startswith("/robot2/") for topic in topics)
    assert len(stamps) >= 1
    replayed(master, bag, start=2.0)


def replayed(master, bag, start):
    """replay.launch shows what was live: latched messages also from before its start, parameters, one clock."""
    shown, clock = {}, []
    for topic, kind in (
        ("/tf_static", TFMessage),
        ("/robot1/sim_bridge/obstacles", MarkerArray),
        ("/robot1/applr/parameters", Parameters),
    ):
        rospy.Subscriber(topic, kind, lambda message, topic=topic: shown.__setitem__(topic, message))
    rospy.Subscriber("/clock", Clock, lambda message: clock.append(message.clock.to_sec()))
    player = master.spawn(
        "roslaunch", "applr_ros1", "replay.launch", "rviz:=false", "bag:=%s" % bag, "options:=--clock -s %g" % start
    )
    try:
        player.until(lambda: len(shown) == 3 and len(clock) > 50)
        assert clock == sorted(clock)
        assert len(shown["/robot1/sim_bridge/obstacles"].markers) > 50
    finally:
        player.end()
        rospy.set_param("/use_sim_time", False)
