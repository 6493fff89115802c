"""The running stack for all tests of this folder, whole before each and untouched after it."""

import os
import signal
import time

import pytest

from tests.support.ros_harness import session


@pytest.fixture(scope="package")
def running(tmp_path_factory):
    import rospy

    from applr_ros1.common.ros_node import LONGEST
    from tests.faults.stack import Stack

    stack = Stack(session(), tmp_path_factory.mktemp("stack"))
    yield stack
    stack.relay.close()
    rospy.set_param("/use_sim_time", False)
    for child in stack.nodes.values():  # all at once, as roslaunch does
        child.thaw()
        os.kill(child.pid, signal.SIGINT)
    began = time.monotonic()
    for name, child in stack.nodes.items():
        status = child.process.wait(LONGEST + 2.0)  # a node that hangs ends itself, and prints where
        took = time.monotonic() - began
        assert status == 0, "%s ended with %d, %.1f s after Ctrl-C:\n%s" % (name, status, took, child.text)


@pytest.fixture
def stack(running):
    """The stack, whole: all nodes alive, no fault in the relay. After the test nothing has been touched."""
    relay = running.relay
    relay.mend()
    for name, child in running.nodes.items():  # a test that failed may have left a node frozen or dead
        child.thaw()
        if not child.alive():
            running.start(name)
    del relay.commands[:-1], relay.planned[:-1]
    yield running
    relay.mend()
    assert not relay.touched, "the robot touched something"
    for child in running.nodes.values():
        assert child.alive(), child.text
        assert "Traceback" not in child.text, child.text
