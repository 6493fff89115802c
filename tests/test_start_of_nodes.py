"""Nodes that are started without a ROS master, or stopped at once, say so in one line."""

import os
import signal
import subprocess
import sys
import time

import pytest
import ros_harness

pytest.importorskip("rospy")
NODES = ("applr", "collision_monitor", "move_base", "sim_bridge", "teleop", "send_goal")


def start(*arguments):
    paths = [str(ros_harness.ROOT), str(ros_harness.GENERATED), os.environ.get("PYTHONPATH", "")]
    return subprocess.Popen(
        [sys.executable, *arguments],
        env=dict(
            os.environ,
            ROS_MASTER_URI="http://localhost:%d" % ros_harness.free_port(),
            PYTHONPATH=os.pathsep.join(paths).rstrip(os.pathsep),
        ),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@pytest.mark.parametrize("name", NODES)
def test_without_a_master(name):
    process = start(str(ros_harness.ROOT / "applr_ros1" / "scripts" / (name + ".py")))
    _, text = process.communicate(timeout=30)
    assert process.returncode == 1, text
    assert len(text.splitlines()) == 1, text
    assert "no ROS master at http://localhost:" in text
    assert "roscore" in text


@pytest.mark.parametrize("delay", [0.0, 0.2, 0.5])
def test_ctrl_c_during_the_import(delay):
    begin = "import sys; from applr_ros1.common.errors import run_script; print('begun', flush=True);"
    process = start("-c", begin + "sys.argv[1:] = ['--help']; sys.exit(run_script('training.train'))")
    assert process.stdout.readline() == "begun\n"
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=30)
    assert "Traceback" not in text, text
    assert len(text.splitlines()) <= 1, text
