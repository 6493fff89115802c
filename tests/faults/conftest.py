"""The running stack for all tests of this folder, whole before each and untouched after it."""

import os
import signal

import pytest

from tests.support.ros_harness import LONGEST, session


@pytest.fixture(scope="package")
def running(tmp_path_factory):
    import rospy

    from tests.faults.stack import Stack

    stack = Stack(session(), tmp_path_factory.mktemp("stack"))
    yield stack
    stack.relay.close()
    rospy.set_param("/use_sim_time", False)
    for child in stack.nodes.values():  # all at once, as roslaunch does
        child.thaw()
        os.kill(child.pid, signal.SIGINT)
    for name, child in stack.nodes.items():
        assert child.process.wait(LONGEST) == 0, name + ":\n" + child.text  # a node that hangs prints where


@pytest.fixture
def stack(running):
    """The stack. After the test its nodes live and nothing has been touched."""
    relay = running.relay
    relay.mend()
    del relay.commands[:-1], relay.planned[:-1]
    yield running
    assert not relay.touched, "the robot touched something"
    for child in running.nodes.values():
        assert child.alive(), child.text
        assert "Traceback" not in child.text, child.text
