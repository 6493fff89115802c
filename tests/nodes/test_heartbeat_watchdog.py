"""Tests of the watchdog alone. tests/faults/test_processes.py tests it in a running stack."""

from applr_ros1.nodes.move_base.heartbeat_watchdog import HeartbeatWatchdog, start_up_settings
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.parameter_space import SPACE
from tests.support.robots import JACKAL_PARAMETERS


def test_a_lost_heartbeat_is_reported_once():
    watchdog = HeartbeatWatchdog(2.0)
    assert not watchdog.is_lost(100.0)  # There was no heartbeat yet.
    # Lost after 2.5 periods
    watchdog.heartbeat(100.0)
    assert not watchdog.is_lost(105.0)
    assert watchdog.is_lost(105.05)
    assert not watchdog.is_lost(200.0)
    # The clock jumped back, as at the start of a simulation: the wait begins anew.
    watchdog.heartbeat(300.0)
    assert not watchdog.is_lost(10.0)
    assert watchdog.is_lost(15.1)


def test_what_is_set_then_are_the_values_of_the_start():
    move_base = MoveBase(JACKAL_PARAMETERS)
    requests = start_up_settings(move_base, SPACE)
    assert requests == SPACE.settings(SPACE.theta0)
