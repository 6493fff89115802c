"""Tests of `--quick`: those that need neither ROS nor another process.

No list names the others: a file that imports ROS or a browser is skipped as if they were not
installed, and a test is skipped once it starts a process.
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


def hide_packages():
    """Let each import of ROS and of the browser fail in this process."""
    sys.modules.update(dict.fromkeys((*ROS, BROWSER)))


def forbid_processes(monkeypatch):
    """Skip each test that starts a process."""
    monkeypatch.setattr(subprocess.Popen, "__init__", _skip)
    monkeypatch.setattr(multiprocessing.process.BaseProcess, "start", _skip)
    monkeypatch.setattr(os, "fork", _skip)


def _skip(*_arguments, **_options):
    pytest.skip(STARTS_A_PROCESS)
