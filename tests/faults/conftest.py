"""Fixtures with the running stack, which all tests of this folder share."""

import os
import signal

import pytest

from tests.support.ros import LONGEST, session


@pytest.fixture(scope="package")
def running(tmp_path_factory):
    """Start the stack for all tests of the folder; at its end, check that all nodes end well."""
    import rospy

    from tests.faults.stack import Stack

    stack = Stack(session(), tmp_path_factory.mktemp("stack"))
    yield stack
    stack.relay.close()
    rospy.set_param("/use_sim_time", False)
    # All nodes are interrupted before any is waited for, as roslaunch does.
    for child in stack.nodes.values():
        child.thaw()
        os.kill(child.pid, signal.SIGINT)
    for node_name, child in stack.nodes.items():
        assert child.process.wait(LONGEST) == 0, node_name + ":\n" + child.text


@pytest.fixture
def stack(running):
    """Provide the stack without faults. After the test, check that all nodes are alive and there
    was no contact.
    """
    relay = running.relay
    relay.clear_faults()
    # The latest command of each stays: tests ask for it at any time.
    del relay.commands[:-1], relay.planned[:-1]
    yield running
    assert relay.touched is None, f"the robot touched an obstacle: {relay.touched}"
    for child in running.nodes.values():
        assert child.alive(), child.text
        assert "Traceback" not in child.text, child.text
