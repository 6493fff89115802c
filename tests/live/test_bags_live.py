"""From a live recording to transitions: what is rebuilt from the bag is what the applr node saw.

What becomes of them (other bag formats, datasets, training, a policy that drives) is tested in tests/training.
"""

import contextlib

import pytest
import rospy

from tests.support.jackal import JACKAL
from tests.support.ros_harness import session, wait_for
from training.bags.episodes import BagReport, trajectories
from training.bags.reader import read

pytestmark = pytest.mark.ros
WORLD = "generated:0"


@pytest.mark.slow
def test_a_recorded_drive_is_rebuilt_as_the_node_saw_it(tmp_path):
    ros, bag = session(), tmp_path / "drive.bag"
    rospy.set_param("/use_sim_time", True)
    rospy.set_param("/move_base", JACKAL)
    robot = "_world:=" + WORLD, "_simulator:=kinematic", "_real_time_factor:=2"
    nodes = [ros.python("-m", "applr_ros1.scripts.record", bag)]
    nodes.append(ros.python("-m", "applr_ros1.scripts.move_base", "odom:=odometry/filtered"))
    nodes.append(ros.python("-m", "applr_ros1.scripts.sim_bridge", *robot))
    nodes.append(ros.python("-m", "applr_ros1.scripts.applr", "_method:=random", "_seed:=3"))
    for node in nodes[1:]:
        wait_for(lambda node=node: "ready" in node.text or not node.alive(), 180.0, "the stack")
        assert node.alive(), node.text
    goal = ros.python("-m", "applr_ros1.scripts.send_goal", "_goal:=auto", "_world:=" + WORLD)
    with contextlib.suppress(AssertionError):  # the drive may last longer than it is watched
        wait_for(lambda: not goal.alive(), 30.0)
    for child in (goal, *reversed(nodes)):
        child.end()
        assert "Traceback" not in child.text, child.text
    wait_for(bag.exists, 10.0, "the bag")
    report = BagReport()
    assert list(trajectories(read(bag), report=report))
    assert report.transitions >= 3, report
    assert report.verified >= report.transitions, report
