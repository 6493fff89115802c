"""Tests of nodes that freeze, die and restart while the robot drives, and of parameters that other
clients change.
"""

import time

import numpy as np
import pytest
import rospy
from dynamic_reconfigure.client import Client

from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from tests.support.nodes import PLANNER
from tests.support.ros import LONGEST, Kept, wait_for

pytestmark = pytest.mark.ros
PERIODS = 3  # number of decision periods after which a silent applr node counts as lost
# Time from a fault to rest [s]: the reaction time, and 1.05 s of braking from 2 m/s without
# locking.
STANDS = 1.5


@pytest.fixture
def client(stack):
    """Provide a parameter client like that of the applr node."""
    client = ReconfigureClient()
    wait_for(lambda: not client.connect(), "servers")
    yield client
    client.close()


def has_what_was_decided(stack, client):
    """Return whether the servers have the latest decision, except for distance weights, whose unit
    may differ.
    """
    in_force = SPACE.as_dict(client.values())
    for parameter_name, decided_value in stack.decisions[-1]["theta"].items():
        is_weight = parameter_name.endswith("_scale")
        if not is_weight and in_force[parameter_name] != decided_value:
            return False
    return True


@pytest.mark.fault("3")
def test_the_base_stops_while_the_planner_is_frozen(stack, client, measured):
    """After SIGSTOP the base stops, and requests time out. After SIGCONT everything goes on."""
    stack.under_way()
    measured("stands after", stack.stands_after(stack.nodes["move_base"].freeze, STANDS), "s")
    stopwatch = Kept()
    began = time.monotonic()
    assert client.apply(SPACE.settings(THETA_0))
    measured("request given up after", time.monotonic() - began, "s")
    assert time.monotonic() - began < 1.2 + stopwatch.waiting()
    stack.nodes["move_base"].thaw()
    stack.drives_again()
    wait_for(lambda: has_what_was_decided(stack, client), "parameters")


@pytest.mark.fault("4", "14")
def test_the_base_stops_and_a_restarted_planner_gets_the_current_parameters(stack, measured):
    # At the goal the parameters would be theta_0, no longer what was decided.
    stack.under_way(room=10.0)
    measured("stands after", stack.stands_after(stack.nodes["move_base"].kill, STANDS), "s")
    stack.start("move_base")
    began = time.monotonic()
    earlier_decisions = len(stack.decisions)
    wait_for(lambda: "came back" in stack.output("applr"), "the new servers noticed")
    stack.client.stop_tracking_goal()
    assert stack.client.wait_for_server(rospy.Duration(LONGEST))
    stack.send()
    stack.drives_again()
    wait_for(lambda: len(stack.decisions) > earlier_decisions + 2, "decisions")
    # A new client has no values of the servers before the restart.
    new_client = ReconfigureClient()
    wait_for(lambda: not new_client.connect(), "servers")
    wait_for(lambda: has_what_was_decided(stack, new_client), "the current parameters")
    measured("current parameters after", time.monotonic() - began, "s")
    new_client.close()


@pytest.mark.fault("8")
def test_theta_0_returns_if_the_applr_node_is_killed(stack, client, measured):
    """The planner is reverted to theta_0 within three periods, and commands keep coming."""
    stack.under_way(room=10.0)
    wait_for(lambda: not np.array_equal(client.values(), THETA_0), "parameters of the policy")
    del stack.relay.planned[:-1]
    stopwatch = Kept()
    killed_at = stack.relay.now

    def on_theta_0():
        return np.array_equal(client.values(), THETA_0)

    stack.nodes["applr"].kill()
    wait_for(on_theta_0, "theta_0")
    elapsed_periods = (stack.relay.now - killed_at) / stack.PERIOD
    measured("on theta_0 after", elapsed_periods, "periods")
    assert elapsed_periods < PERIODS + 0.2 + stopwatch.waiting() / stack.PERIOD
    longest_gap = np.diff([command.stamp for command in stack.relay.planned]).max()
    measured("longest gap of commands", 1e3 * longest_gap, "ms")
    assert longest_gap < 0.25 + stopwatch.waiting()
    stack.start("applr")
    stack.under_way()
    wait_for(lambda: not on_theta_0(), "parameters of the new node")


@pytest.mark.fault("14a")
@pytest.mark.parametrize(
    "killed", [True, False], ids=["the collision monitor is killed", "commands get lost"]
)
def test_the_base_stops_if_commands_no_longer_reach_it(stack, measured, killed):
    """The base stops, and drives again once the monitor is restarted or commands arrive again."""
    stack.under_way()

    def lose_commands():
        stack.relay.faults["command"] = lambda command: None

    break_it = stack.nodes["collision_monitor"].kill if killed else lose_commands
    measured("stands after", stack.stands_after(break_it, 0.5, locks=True), "s")
    if killed:
        # A base without a time-out must stand, too.
        assert stack.relay.commands[-1].velocity == (0.0, 0.0)
        stack.start("collision_monitor")
    stack.relay.clear_faults()
    stack.drives_again()


@pytest.mark.fault("6")
def test_a_change_by_another_client_is_in_the_next_observation(stack):
    stack.under_way(room=10.0)
    another_client = Client(PLANNER, timeout=LONGEST)
    earlier_decisions = len(stack.decisions)

    def is_observed():
        # Again and again, because the next decision sets the policy's value.
        another_client.update_configuration({"max_vel_x": 0.77})
        new_decisions = stack.decisions[earlier_decisions:]
        return 0.77 in [decision["theta_prev"]["max_vel_x"] for decision in new_decisions]

    wait_for(is_observed, "theta(t-1)")
    another_client.close()
