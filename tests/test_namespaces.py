"""Two robots on one master: in a namespace, every name of the stack stays in it but those that all robots share."""

import pytest
from ros_harness import session, wait_for

pytestmark = pytest.mark.ros
SHARED = {"/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/use_sim_time"}
NODES = ("applr", "move_base", "sim_bridge")
PREFIX = "robot1/"


def names_of(node):
    """Topics and services of a node, from the master."""
    import rosgraph

    publishers, subscribers, services = rosgraph.Master("/pytest").getSystemState()
    return {name for group in (publishers, subscribers, services) for name, nodes in group if node in nodes}


def test_a_stack_in_a_namespace():
    master = session()
    import rospy
    from std_srvs.srv import SetBool
    from tf2_msgs.msg import TFMessage

    frames = set()

    def keep(message):
        frames.update(name for t in message.transforms for name in (t.header.frame_id, t.child_frame_id))

    subscribers = [rospy.Subscriber(topic, TFMessage, keep) for topic in ("/tf", "/tf_static")]
    odometry = "odom:=odometry/filtered"
    arguments = {
        "applr": ["_mode:=dwa"],
        "move_base": [odometry]
        + [
            "_%s/%s:=%s" % (costmap, name, PREFIX + frame)
            for costmap in ("global_costmap", "local_costmap")
            for name, frame in (("global_frame", "odom"), ("robot_base_frame", "base_link"))
        ],
        "sim_bridge": ["_simulator:=kinematic", "_tf_prefix:=" + PREFIX],
    }
    children = [
        master.python("applr_ros1/scripts/%s.py" % name, *arguments[name], ROS_NAMESPACE="/robot1") for name in NODES
    ]
    try:
        for name, child in zip(NODES, children):
            wait_for(lambda child=child: "ready" in child.text or not child.alive(), 150.0, name)
            assert child.alive(), child.text
        for name in NODES:
            outside = {other for other in names_of("/robot1/" + name) if not other.startswith("/robot1/")}
            assert outside <= SHARED, (name, outside - SHARED)
        heartbeats = {"/robot1/applr", "/robot1/move_base"}
        wait_for(lambda: all("/robot1/applr/heartbeat" in names_of(node) for node in heartbeats), 5.0, "the heartbeat")
        wait_for(lambda: len(frames) >= 6, 5.0, "frames")
        assert {name for name in frames if not name.startswith(PREFIX)} == {"world"}
        rospy.wait_for_service("/robot1/applr/enable", 5.0)
        assert rospy.ServiceProxy("/robot1/applr/enable", SetBool)(False).success
        applr, planner = children[0], children[1]
        wait_for(lambda: "no parameter server" not in applr.text, 1.0)
        assert "Traceback" not in applr.text + planner.text
    finally:
        for child in children:
            child.end()
        for subscriber in subscribers:
            subscriber.unregister()
