"""Tests of `--quick`: those that need neither ROS nor another process.

No list names the others: a file that imports ROS or a browser is skipped as if they were not
installed, and a test is skipped once it starts a process, or needs a simulator that is missing.
"""

import multiprocessing.process
import os
import subprocess
import sys

import pytest

ROS = ("genpy", "rosbag", "rosgraph", "roslib", "rospy")  # every other package of ROS needs these
# A skip while it starts the browser would leave its event loop to the tests that follow.
BROWSER = "playwright"
STARTS_A_PROCESS = "starts a process"
# Packages of the simulator that `pip install -e '.[train]'` leaves out.
PYBULLET = ("pybullet", "pybullet_utils")


def hide_packages():
    """Let each import of ROS and of the browser fail in this process."""
    sys.modules.update(dict.fromkeys((*ROS, BROWSER)))


def forbid_processes(monkeypatch):
    """Skip each test that starts a process."""
    monkeypatch.setattr(subprocess.Popen, "__init__", _skip)
    monkeypatch.setattr(multiprocessing.process.BaseProcess, "start", _skip)
    monkeypatch.setattr(os, "fork", _skip)


def missing_simulator(failure):
    """Return the package of the simulator whose absence an exception reports, or ""."""
    is_missing = isinstance(failure, ModuleNotFoundError) and failure.name in PYBULLET
    return failure.name if is_missing else ""


def _skip(*_arguments, **_options):
    pytest.skip(STARTS_A_PROCESS)
