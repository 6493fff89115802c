"""A run of tests that is ended leaves no process behind (tests/conftest.py)."""

import os
import signal
import subprocess
import sys

import pytest

from tests.support import HANGS
from tests.support.processes import is_alive
from tests.support.ros_harness import ROOT, wait_for

pytest.importorskip("rospy")
TEST = """
import os, pathlib, time
from tests.support import ros_harness

def test_that_lasts():
    assert "ROS_NAMESPACE" not in os.environ
    with ros_harness.RosMaster() as master:
        child = master.spawn("sleep", "60")
        pathlib.Path("pids").write_text("%d %d end" % (master._master.pid, child.pid))
        time.sleep(60.0)
"""


@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, "-n0"), (signal.SIGTERM, "-n1")])
def test_a_run_that_is_ended_leaves_nobody(tmp_path, number, workers):
    (tmp_path / "test_it.py").write_text(TEST)
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    run = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "-p", "no:cacheprovider", workers],
        env=dict(os.environ, PYTHONPATH=path, ROS_NAMESPACE="robot1"),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    pids = tmp_path / "pids"
    wait_for(lambda: (pids.exists() and pids.read_text().endswith("end")) or run.poll() is not None, "the test")
    assert run.poll() is None, run.communicate()[0]
    started = [int(word) for word in pids.read_text().split()[:2]]
    assert all(map(is_alive, started))
    run.send_signal(number)
    said, _ = run.communicate(timeout=HANGS)
    assert run.returncode == 2, said
    wait_for(lambda: not any(map(is_alive, started)), "the end of what the test has started")
