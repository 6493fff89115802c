"""Nodes that are started without a ROS master, or stopped at once, say so in one line."""

import os
import signal
import subprocess
import sys
import time

import pytest
import ros_harness

pytest.importorskip("rospy")
NODES = ("applr", "move_base", "sim_bridge", "teleop", "send_goal")


def start(name, *arguments):
    env = dict(
        os.environ,
        ROS_MASTER_URI="http://localhost:%d" % ros_harness.free_port(),
        PYTHONPATH=os.pathsep.join([str(ros_harness.ROOT), str(ros_harness.GENERATED), os.environ["PYTHONPATH"]])
        if "PYTHONPATH" in os.environ
        else os.pathsep.join([str(ros_harness.ROOT), str(ros_harness.GENERATED)]),
    )
    script = ros_harness.ROOT / "applr_ros1" / "scripts" / (name + ".py")
    return subprocess.Popen(
        [sys.executable, str(script), *arguments],
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@pytest.mark.parametrize("name", NODES)
def test_without_a_master(name):
    process = start(name)
    _, text = process.communicate(timeout=30)
    assert process.returncode == 1, text
    assert len(text.splitlines()) == 1, text
    assert "no ROS master at http://localhost:" in text
    assert "roscore" in text


@pytest.mark.parametrize("delay", [0.15, 0.4, 0.8])
def test_ctrl_c_during_the_start(delay):
    process = start("train", "--help")
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=30)
    assert "Traceback" not in text, text
    assert len(text.splitlines()) <= 1, text
