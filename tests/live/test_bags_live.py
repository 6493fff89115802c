"""From a live recording to an actor that drives: rosbag record → rosbags-convert →
bags_to_dataset → offline training → method applr. The rebuilt transitions are those that the applr node saw.
"""

import contextlib
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.jackal import JACKAL
from tests.support.ros_harness import ROOT, session, wait_for

pytestmark = pytest.mark.ros
WORLD = "generated:0"
RECORDED = [
    "/clock",
    "/tf",
    "/tf_static",
    "/front/scan",
    "/odometry/filtered",
    "/move_base/current_goal",
    "/move_base/status",
    "/move_base/result",
    "/move_base/NavfnROS/plan",
    "/move_base/TrajectoryPlannerROS/parameter_updates",
    "/move_base/local_costmap/inflater_layer/parameter_updates",
    "/move_base/global_costmap/inflater_layer/parameter_updates",
    "/applr/decision",
    "/sim_bridge/collision",
]


@pytest.fixture(scope="module")
def stack():
    """Simulator and planner, and start(method, **parameters) for the applr node."""
    import rospy

    ros = session()
    rospy.set_param("/use_sim_time", True)
    rospy.set_param("/move_base", JACKAL)
    planner = ros.python("-m", "applr_ros1.scripts.move_base", "odom:=odometry/filtered")
    options = "_world:=" + WORLD, "_simulator:=kinematic", "_real_time_factor:=2"
    robot = ros.python("-m", "applr_ros1.scripts.sim_bridge", *options)
    for node in (planner, robot):
        wait_for(lambda node=node: "ready" in node.text or not node.alive(), 180.0, "the stack")
        assert node.alive(), node.text
    yield ros
    for node in (planner, robot):
        node.end()


def drive(ros, seconds, **parameters):
    """One course with an applr node of those parameters, until the goal or for `seconds` of wall time. Returns what
    the node printed.
    """
    node = ros.python("-m", "applr_ros1.scripts.applr", *["_%s:=%s" % item for item in parameters.items()])
    goal = None
    try:
        wait_for(lambda: "ready" in node.text, 20.0, "applr node")
        goal = ros.python("-m", "applr_ros1.scripts.send_goal", "_goal:=auto", "_world:=" + WORLD)
        with contextlib.suppress(AssertionError):  # the drive may last longer than it is watched
            wait_for(lambda: not goal.alive(), seconds)
    finally:
        for child in filter(None, (goal, node)):
            child.end()
    assert "Traceback" not in node.text
    return node.text


def run(*command):
    done = subprocess.run([str(c) for c in command], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_recording_to_driving(stack, tmp_path):
    import rospy
    from std_srvs.srv import Empty

    from training.bags.episodes import BagReport, trajectories
    from training.bags.reader import read

    bag = tmp_path / "drive.bag"
    recorder = stack.spawn("rosbag", "record", "--lz4", "-O", bag, *RECORDED)
    wait_for(lambda: list(tmp_path.glob("*.active")), 20.0, "recorder")
    drive(stack, 40.0, method="random", seed=3)
    recorder.end()
    wait_for(bag.exists, 10.0, "bag")

    report = BagReport()
    found = list(trajectories(read(bag), report=report))
    assert report.transitions >= 3, report
    assert report.verified >= report.transitions, report
    convert = shutil.which("rosbags-convert") or Path(sys.executable).parent / "rosbags-convert"
    run(convert, "--src", bag, "--dst", tmp_path / "ros2", "--dst-storage", "mcap")
    converted = list(trajectories(read(tmp_path / "ros2")))
    for name in ("scan", "rest", "action", "reward"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(t, name) for t in found]), np.concatenate([getattr(t, name) for t in converted])
        )
    said = run(sys.executable, "-m", "training.bags_to_dataset", tmp_path / "ros2", "--out", tmp_path / "dataset")
    assert "%d transitions" % report.transitions in said

    short = "--gradient-steps", 20, "--net-arch", 32, 32, "--batch-size", 8, "--eval-worlds", "none", "--device", "cpu"
    learn = sys.executable, "-m", "training.train", "--dataset", tmp_path / "dataset", "--out", tmp_path / "run"
    run(*learn, "--bc-alpha", 2.5, *short)
    (actor,) = sorted((tmp_path / "run").rglob("*.safetensors"))[:1]
    rospy.wait_for_service("/sim_bridge/reset", 5.0)
    rospy.ServiceProxy("/sim_bridge/reset", Empty)()
    heard = []
    from applr_ros1.msg import Decision

    listener = rospy.Subscriber("/applr/decision", Decision, heard.append)
    text = drive(stack, 8.0, method="applr:%s" % actor)
    listener.unregister()
    assert "ready, method applr:" in text, text
    assert "theta_0" not in text, text
    assert len(heard) >= 2
    assert not any(decision.refused for decision in heard)
