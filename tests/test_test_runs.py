"""What tests/conftest.py promises of a run: what is left out, and that one that is ended leaves no process."""

import os
import re
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
TIERS = """
import pytest
from tests.support.seeds import seeds

def test_skipped():
    pytest.skip("always")

@seeds(8)
def test_drawn(seed):
    print("seed", seed)

@pytest.mark.slow
def test_slow():
    print("ran slow")

@pytest.mark.long
def test_long():
    print("ran long")
"""


def start(folder, *options, text=TEST, **environment):
    """A pytest with this repository's conftest.py in a folder of its own."""
    (folder / "test_both.py").write_text(text)
    return subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "-p", "no:cacheprovider", *options],
        env=dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]), **environment),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, "-n0"), (signal.SIGTERM, "-n1")])
def test_a_run_that_is_ended_leaves_nobody(tmp_path, number, workers):
    run = start(tmp_path, "-k", "lasts", workers, ROS_NAMESPACE="robot1")
    pids = tmp_path / "pids"
    wait_for(lambda: (pids.exists() and pids.read_text().endswith("end")) or run.poll() is not None, "the test")
    assert run.poll() is None, run.communicate()[0]
    started = [int(word) for word in pids.read_text().split()[:2]]
    assert all(map(is_alive, started))
    run.send_signal(number)
    said, _ = run.communicate(timeout=HANGS)
    assert run.returncode == 2, said
    wait_for(lambda: not any(map(is_alive, started)), "the end of what the test has started")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("-k", "skipped or slow"), []),
        ((), ["seed 0", "seed 1"]),
        (("--all",), ["seed %d" % seed for seed in range(8)] + ["ran slow"]),
        (("-m", "slow or long"), ["ran slow", "ran long"]),
    ],
)
def test_what_a_run_leaves_out_and_that_one_in_which_no_test_passed_is_a_failure(tmp_path, options, said):
    run = start(tmp_path, "-s", *options, text=TIERS)
    lines = run.communicate(timeout=HANGS)[0]
    assert re.findall(r"seed \d|ran \w+", lines) == said
    assert run.returncode == (0 if said else pytest.ExitCode.NO_TESTS_COLLECTED), lines
