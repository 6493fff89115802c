"""What tests/conftest.py promises: a test run that is ended from outside ends what its tests have started, and -k
chooses among the tests of files that have a process of their own, too."""

import os
import signal
import subprocess
import sys

import pytest
from ros_harness import ROOT, wait_for
from test_launch import is_alive

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros
TEST = """
import os, pathlib, time
import ros_harness

def test_that_lasts():
    assert "ROS_NAMESPACE" not in os.environ
    with ros_harness.RosMaster() as master:
        child = master.spawn("sleep", "60")
        pathlib.Path("pids").write_text("%d %d end" % (master._master.pid, child.pid))
        time.sleep(60.0)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_run_that_is_ended_leaves_nobody(tmp_path, number):
    (tmp_path / "test_long.py").write_text(TEST)
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]))
    environment["ROS_NAMESPACE"] = "robot1"
    run = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-p", "conftest", "-p", "no:cacheprovider", "test_long.py"],
        env=environment,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # under nohup SIGHUP is ignored
    )
    pids = tmp_path / "pids"
    wait_for(lambda: (pids.exists() and pids.read_text().endswith("end")) or run.poll() is not None, 60.0, "the test")
    assert run.poll() is None, run.communicate()[0]
    started = [int(word) for word in pids.read_text().split()[:2]]
    assert all(map(is_alive, started))
    run.send_signal(number)
    said, _ = run.communicate(timeout=60)
    assert run.returncode == 2, said
    wait_for(lambda: not any(map(is_alive, started)), 5.0, "the end of what the test has started")


def test_chosen_tests_of_several_files_with_nodes_run():
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    command += ["tests/test_barn.py", "tests/test_start_of_nodes.py", "-k", "scores_of_the or is_still_starting"]
    environment = {name: value for name, value in os.environ.items() if name != "APPLR_TESTS_OF_ONE_FILE"}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stdout
    for name, count in (("test_barn.py", 1), ("test_start_of_nodes.py", 2)):
        assert "%s: %d passed" % (name, count) in run.stdout, run.stdout
