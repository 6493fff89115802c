"""The machine is busy, or another stack runs on it."""

import os
import subprocess
import sys
import time

import pytest
import rosgraph

from tests.support.ros_harness import LONGEST, Kept, RosMaster, wait_for

pytestmark = pytest.mark.ros


@pytest.mark.slow
@pytest.mark.fault("25")
def test_the_processor_is_busy(stack, measured):
    """Two endless loops per core: commands stay young enough to drive on, and left-out cycles are reported."""
    stack.under_way(room=10.0)
    del stack.relay.planned[:-1]
    move_base = stack.nodes["move_base"]
    said = len(move_base.text)
    stack.relay.bend["clock"] = lambda clock: None  # the node does not get to see a time for 200 ms
    time.sleep(0.2)
    stack.relay.mend()
    kept = Kept()
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * os.cpu_count())]
    try:
        time.sleep(2.0)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    gap = stack.longest_gap()
    measured("longest gap of commands", 1e3 * gap, "ms")
    assert gap < 0.5 * kept.slowdown()
    wait_for(lambda: "cycles left out" in move_base.text[said:], "a line about the cycles that were missed")
    stack.drives_again()


@pytest.mark.fault("24")
def test_two_stacks_on_one_machine(stack, measured):
    """A second master with a robot of its own: neither hears the other, and the end of one leaves the other alone."""
    stack.under_way(room=12.0)
    other = RosMaster()
    try:
        bridge = other.node("sim_bridge", "_simulator:=kinematic")
        bridge.until("ready")
        stack.under_way(room=10.0)
        publishers = rosgraph.Master("/looks", other.uri).getSystemState()[0]
        assert {node for _, nodes in publishers for node in nodes} == {"/sim_bridge"}
        truth = subprocess.run(
            ["rostopic", "echo", "-n", "1", "/sim_bridge/ground_truth/twist/twist/linear/x"],
            env=other.env,
            capture_output=True,
            text=True,
            timeout=LONGEST,
            check=True,
        )
        speed = abs(float(truth.stdout.split()[0]))
        measured("speed of the robot that was not sent anywhere", speed, "m/s")
        assert speed < 0.01
        stack.under_way()
    finally:
        other.close()
    stack.under_way()
    assert all(child.alive() for child in stack.nodes.values())
