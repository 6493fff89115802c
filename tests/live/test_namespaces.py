"""Test of a robot's stack in a namespace: names, frames, recording, replay."""

import math

import pytest
import rosbag
import rosgraph
import rospy
from applr_ros1.msg import Parameters
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from tests.support import ROOT
from tests.support.ros import session, wait_for

pytestmark = pytest.mark.ros
# Names that all robots share, in the root namespace.
SHARED = {"/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/use_sim_time"}
NODES = ("applr", "move_base", "sim_bridge", "collision_monitor", "movers")
# A start that is not the world's: the parameter must have come through the namespace [m, rad].
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
    registrations = [*publishers, *subscribers, *services]
    return {name for name, nodes in registrations if node in nodes}


class Watched:
    """Recorder of the robot's frames, positions in the world and decisions."""

    def __init__(self):
        self.frames = set()
        self.places = []
        self.decided = []
        self.plan_frames = set()
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, self.keep_frames)
        rospy.Subscriber("/robot1/sim_bridge/ground_truth", Odometry, self.keep_place)
        rospy.Subscriber("/robot1/move_base/NavfnROS/plan", Path, self.keep_plan_frame)
        rospy.Subscriber("/robot1/applr/decision", rospy.AnyMsg, self.decided.append)

    def keep_frames(self, message):
        for transform in message.transforms:
            self.frames |= {transform.header.frame_id, transform.child_frame_id}

    def keep_plan_frame(self, message):
        self.plan_frames.add(message.header.frame_id)

    def keep_place(self, message):
        self.places.append((message.pose.pose.position.x, message.pose.pose.position.y))


@pytest.mark.slow
def test_a_stack_in_a_namespace(tmp_path):
    master = session()
    bag_path = tmp_path / "a.bag"
    launch_file = tmp_path / "robot1.launch"
    whole_stack = ROOT / "applr_ros1" / "launch" / "jackal_applr.launch"
    launch_file.write_text(LAUNCH.format(file=whole_stack, bag=bag_path, start="%g %g %g" % START))
    watched = Watched()
    rospy.set_param("/use_sim_time", True)
    launched = master.spawn("roslaunch", launch_file)
    try:
        launched.until(lambda: len(watched.decided) >= 2)
        launched.until(lambda: math.dist(watched.places[-1], START[:2]) > 2.2)
        for node_name in NODES:
            outside_names = set()
            for name in names_of("/robot1/" + node_name):
                if not name.startswith("/robot1/"):
                    outside_names.add(name)
            assert outside_names <= SHARED, (node_name, outside_names - SHARED)
        # The world is one for all robots.
        outside_frames = {frame for frame in watched.frames if not frame.startswith("robot1/")}
        assert outside_frames == {"world"}
        assert watched.plan_frames == {"robot1/matched"}
        assert rospy.ServiceProxy("/robot1/applr/enable", SetBool)(False).success
        assert "no heartbeat of the applr node" not in launched.text
    finally:
        launched.end()
        rospy.set_param("/use_sim_time", False)
    assert "Traceback" not in launched.text
    wait_for(bag_path.exists, "the bag")
    with rosbag.Bag(str(bag_path)) as recorded:
        topics = set(recorded.get_type_and_topic_info().topics)
        assert recorded.get_message_count("/robot1/applr/decision") >= 1
    assert {"/robot1/front/scan", "/robot1/move_base/TrajectoryPlannerROS/local_plan"} <= topics
    assert "/robot1/move_base/current_goal" in topics, "the drive is recorded from its begin"
    assert "/tf" in topics
    replayed(master, bag_path, start=0.5)


def replayed(master, bag, start):
    """Check that replay.launch publishes the recorded messages, including latched ones from before
    its start.
    """
    static_tf = []
    obstacles = []
    parameters = []
    clock_times = []
    rospy.Subscriber("/tf_static", TFMessage, static_tf.append)
    rospy.Subscriber("/robot1/sim_bridge/obstacles", MarkerArray, obstacles.append)
    rospy.Subscriber("/robot1/applr/parameters", Parameters, parameters.append)
    rospy.Subscriber("/clock", Clock, lambda message: clock_times.append(message.clock.to_sec()))
    options = "rviz:=false", "bag:=%s" % bag, "options:=--clock -s %g" % start
    player = master.spawn("roslaunch", "applr_ros1", "replay.launch", *options)
    try:
        player.until(lambda: static_tf and obstacles and parameters and len(clock_times) > 50)
        assert clock_times == sorted(clock_times)
        assert len(obstacles[-1].markers) > 50
    finally:
        player.end()
        rospy.set_param("/use_sim_time", False)
