"""Two robots on one master (two_jackals.launch): they drive at once in one world, each in a namespace of its own."""

import math

import pytest

from tests.support.ros_harness import session

pytestmark = pytest.mark.ros
SHARED = {"/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/use_sim_time"}
ROBOTS = ("robot1", "robot2")
STARTS = {"robot1": (-3.0, 1.2), "robot2": (-1.5, 3.8)}  # of the launch file
NODES = ("applr", "move_base", "sim_bridge", "collision_monitor", "movers")


def names_of(node):
    """Topics and services of a node, from the master."""
    import rosgraph

    publishers, subscribers, services = rosgraph.Master("/pytest").getSystemState()
    return {name for group in (publishers, subscribers, services) for name, nodes in group if node in nodes}


class Watched:
    """What the two robots did."""

    def __init__(self):
        import rospy
        from nav_msgs.msg import Odometry
        from std_msgs.msg import Bool
        from tf2_msgs.msg import TFMessage

        self.frames, self.places = set(), {}
        self.nearest, self.together, self.contacts = math.inf, 0, 0
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, self.keep_frames)
        for name in ROBOTS:
            rospy.Subscriber("/%s/sim_bridge/ground_truth" % name, Odometry, self.keep_place, name)
            rospy.Subscriber("/%s/collision" % name, Bool, self.keep_contact)

    def keep_frames(self, message):
        self.frames.update(name for t in message.transforms for name in (t.header.frame_id, t.child_frame_id))

    def keep_contact(self, message):
        self.contacts += message.data

    def keep_place(self, message, name):
        position = message.pose.pose.position
        self.places[name] = position.x, position.y, message.twist.twist.linear.x
        if len(self.places) == 2:
            (x, y, v), (other_x, other_y, other_v) = self.places.values()
            self.nearest = min(self.nearest, math.hypot(x - other_x, y - other_y))
            self.together += min(v, other_v) > 0.1

    def way(self, name):
        """Displacement [m] of a robot from where it started, along the world's axes."""
        return tuple(a - b for a, b in zip(self.places[name], STARTS[name]))


@pytest.mark.slow
def test_two_robots_on_one_master(tmp_path):
    import rosbag
    import rosgraph
    import rospy
    from std_srvs.srv import SetBool

    master = session()
    seen = Watched()
    launched = master.spawn(
        "roslaunch", "applr_ros1", "two_jackals.launch", "simulator:=kinematic", "record:=%s" % (tmp_path / "a.bag")
    )
    try:
        launched.until(lambda: launched.text.count("goal sent") == 2)
        for robot, other in (ROBOTS, ROBOTS[::-1]):
            for name in NODES:
                outside = {n for n in names_of("/%s/%s" % (robot, name)) if not n.startswith("/%s/" % robot)}
                assert outside <= SHARED | {"/%s/sim_bridge/ground_truth" % other}, (name, outside - SHARED)
        publishers, _, _ = rosgraph.Master("/pytest").getSystemState()
        assert dict(publishers)["/clock"] == ["/robot1/sim_bridge"]
        launched.until(lambda: launched.text.count("goal reached") == 2)
        for name, goal in zip(ROBOTS, ((1.5, 2.6), (-1.5, -2.6))):
            assert math.dist(seen.way(name), goal) < 0.4 + 0.1, (name, seen.way(name))  # tolerance, wheels that slip
        assert seen.together > 20  # scans at 50 Hz while both were moving
        assert 0.5 < seen.nearest < 2.0
        assert seen.contacts == 0
        assert {name for name in seen.frames if not name.startswith(tuple(r + "/" for r in ROBOTS))} == {"world"}
        assert rospy.ServiceProxy("/robot2/applr/enable", SetBool)(False).success
        assert "Traceback" not in launched.text
        assert "no sign of the applr node" not in launched.text
    finally:
        launched.end()
        rospy.set_param("/use_sim_time", False)
    with rosbag.Bag(str(tmp_path / "a.bag")) as bag:
        topics = bag.get_type_and_topic_info().topics
        stamps = [stamp.to_sec() for _, _, stamp in bag.read_messages("/robot1/applr/decision")]
    assert {"/robot1/front/scan", "/robot1/move_base/TrajectoryPlannerROS/local_plan", "/tf"} <= set(topics)
    assert not any(topic.startswith("/robot2/") for topic in topics)
    assert len(stamps) >= 1
    replayed(master, tmp_path / "a.bag", start=3.0)


def replayed(master, bag, start):
    """replay.launch shows what was live: latched messages also from before its start, parameters, one clock."""
    import rospy
    from applr_ros1.msg import Parameters
    from rosgraph_msgs.msg import Clock
    from tf2_msgs.msg import TFMessage
    from visualization_msgs.msg import MarkerArray

    seen, clock = {}, []
    for topic, kind in (
        ("/tf_static", TFMessage),
        ("/robot1/sim_bridge/obstacles", MarkerArray),
        ("/robot1/applr/parameters", Parameters),
    ):
        rospy.Subscriber(topic, kind, lambda message, topic=topic: seen.__setitem__(topic, message))
    rospy.Subscriber("/clock", Clock, lambda message: clock.append(message.clock.to_sec()))
    player = master.spawn(
        "roslaunch", "applr_ros1", "replay.launch", "rviz:=false", "bag:=%s" % bag, "options:=--clock -s %g" % start
    )
    try:
        player.until(lambda: len(seen) == 3 and len(clock) > 50)
        assert clock == sorted(clock)
        assert len(seen["/robot1/sim_bridge/obstacles"].markers) > 50
    finally:
        player.end()
        rospy.set_param("/use_sim_time", False)
