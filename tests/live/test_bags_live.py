"""Transitions from a live recording.

tests/training tests the further steps: other bag formats, datasets, training, driving with the
policy.
"""

import shlex
import subprocess

import pytest
import rospy
from applr_ros1.msg import Decision

from tests.support.bags import read
from tests.support.robots import JACKAL_PARAMETERS
from tests.support.ros import session, wait_for
from training.train.transitions import transitions

pytestmark = pytest.mark.ros
WORLD = "generated:0"


@pytest.mark.slow
def test_a_recorded_drive_gives_transitions(tmp_path):
    ros = session()
    bag_path = tmp_path / "drive.bag"
    rospy.set_param("/use_sim_time", True)
    rospy.set_param("/move_base", JACKAL_PARAMETERS)
    # The recorder as the launch file starts it, with its choice of topics
    roslaunch = ("roslaunch", "--args", "record", "applr_ros1", "jackal_applr.launch")
    printed = subprocess.run(
        [*roslaunch, f"record:={bag_path}"], capture_output=True, text=True, check=True
    )
    recorder = ros.spawn(*shlex.split(printed.stdout))
    nodes = [
        ros.node("move_base", "odom:=odometry/filtered"),
        ros.node("sim_bridge", "_world:=" + WORLD, "_simulator:=kinematic"),
        ros.node("applr", "_method:=random", "_seed:=3"),
    ]
    for node in nodes:
        node.until("ready")
    decided = []
    rospy.Subscriber("/applr/decision", Decision, decided.append)
    goal = ros.node("send_goal", "_goal:=auto", "_world:=" + WORLD)
    wait_for(lambda: len(decided) > 4 or not goal.alive(), "decisions")
    # The recorder ends last, or the bag would lack the end of the course.
    for child in (goal, *reversed(nodes), recorder):
        child.end()
        assert "Traceback" not in child.text, child.text
    wait_for(bag_path.exists, "the bag")
    recorded = read(bag_path)
    for observation in ("paper", "dimensionless"):
        episodes, skipped = transitions(recorded, observation=observation)
        assert sum(map(len, episodes)) >= 3, skipped
        assert len(episodes[0].rest[0]) == {"paper": 9, "dimensionless": 51}[observation]
    first_inputs = recorded.decisions[0].seen
    assert len(first_inputs.scan[0]) == 720
    # The plan leads on by more than a metre.
    plan_dx, plan_dy = first_inputs.plan[-1] - first_inputs.plan[0]
    assert max(plan_dx, plan_dy) > 1.0
