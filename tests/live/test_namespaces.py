"""Test of a robot's stack in a namespace: names, frames, recording, replay."""

import math

import pytest
import rosbag
import rosgraph
import rospy
from applr_ros1.msg import Parameters
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from tests.support import ROOT
from tests.support.ros import session, wait_for

pytestmark = pytest.mark.ros
SHARED = {"/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/use_sim_time"}
NODES = ("applr", "move_base", "sim_bridge", "collision_monitor", "movers")
START = -3.0, 1.2, 1.57
LAUNCH = """<launch>
  <group ns="robot1">
    <include file="{file}">
      <arg name="tf_prefix" value="robot1"/>
      <arg name="simulator" value="kinematic"/>
      <arg name="goal" value="0 3 1.57"/>
      <arg name="record" value="{bag}"/>
    </include>
    <param name="sim_bridge/start" value="{start}"/>
  </group>
</launch>"""


def names_of(node):
    """Return the topics and services of a node, as the master lists them."""
    publishers, subscribers, services = rosgraph.Master("/pytest").getSystemState()
    return {
        name
        for group in (publishers, subscribers, services)
        for name, nodes in group
        if node in nodes
    }


class Watched:
    """Recorder of the robot's frames, positions in the world and decisions."""

    def __init__(self):
        self.frames = set()
        self.places = []
        self.decided = []
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, self.keep_frames)
        rospy.Subscriber("/robot1/sim_bridge/ground_truth", Odometry, self.keep_place)
        rospy.Subscriber("/robot1/applr/decision", rospy.AnyMsg, self.decided.append)

    def keep_frames(self, message):
        self.frames.update(
            name for t in message.transforms for name in (t.header.frame_id, t.child_frame_id)
        )

    def keep_place(self, message):
        self.places.append((message.pose.pose.position.x, message.pose.pose.position.y))


@pytest.mark.slow
def test_a_stack_in_a_namespace(tmp_path):
    master = session()
    bag = tmp_path / "a.bag"
    file = tmp_path / "robot1.launch"
    stack = ROOT / "applr_ros1" / "launch" / "jackal_applr.launch"
    file.write_text(LAUNCH.format(file=stack, bag=bag, start="%g %g %g" % START))
    watched = Watched()
    rospy.set_param("/use_sim_time", True)
    launched = master.spawn("roslaunch", file)
    try:
        launched.until(lambda: len(watched.decided) >= 2)
        launched.until(lambda: math.dist(watched.places[-1], START[:2]) > 2.2)
        for name in NODES:
            outside = {n for n in names_of("/robot1/" + name) if not n.startswith("/robot1/")}
            assert outside <= SHARED, (name, outside - SHARED)
        assert {name for name in watched.frames if not name.startswith("robot1/")} == {"world"}
        assert rospy.ServiceProxy("/robot1/applr/enable", SetBool)(False).success
        assert "no heartbeat of the applr node" not in launched.text
    finally:
        launched.end()
        rospy.set_param("/use_sim_time", False)
    assert "Traceback" not in launched.text
    wait_for(bag.exists, "the bag")
    with rosbag.Bag(str(bag)) as recorded:
        topics = recorded.get_type_and_topic_info().topics
        stamps = [
            stamp.to_sec() for _, _, stamp in recorded.read_messages("/robot1/applr/decision")
        ]
    assert {
        "/robot1/front/scan",
        "/robot1/move_base/TrajectoryPlannerROS/local_plan",
        "/tf",
    } <= set(topics)
    assert len(stamps) >= 1
    replayed(master, bag, start=0.5)


def replayed(master, bag, start):
    """Check that replay.launch publishes the recorded messages, including latched ones from before
    its start.
    """
    shown = {}
    clock = []
    for topic, kind in (
        ("/tf_static", TFMessage),
        ("/robot1/sim_bridge/obstacles", MarkerArray),
        ("/robot1/applr/parameters", Parameters),
    ):
        rospy.Subscriber(
            topic, kind, lambda message, topic=topic: shown.__setitem__(topic, message)
        )
    rospy.Subscriber("/clock", Clock, lambda message: clock.append(message.clock.to_sec()))
    player = master.spawn(
        "roslaunch",
        "applr_ros1",
        "replay.launch",
        "rviz:=false",
        "bag:=%s" % bag,
        "options:=--clock -s %g" % start,
    )
    try:
        player.until(lambda: len(shown) == 3 and len(clock) > 50)
        assert clock == sorted(clock)
        assert len(shown["/robot1/sim_bridge/obstacles"].markers) > 50
    finally:
        player.end()
        rospy.set_param("/use_sim_time", False)
