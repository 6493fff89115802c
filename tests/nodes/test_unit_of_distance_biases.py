"""Tests of the reconfigure client without ROS: the unit of settings, and when they are in force."""

import numpy as np
import pytest

from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from tests.support.servers import running_servers

PLANNER = "TrajectoryPlannerROS"
CELL_M = 0.05  # edge of a cell of the local costmap [m]
PATH_INDEX = SPACE.names.index("pdist_scale")
BIAS = THETA_0[PATH_INDEX]
PER_METRE = BIAS / CELL_M


@pytest.fixture
def client():
    """Return a client of running servers, whose planner counts per metre."""
    client = ReconfigureClient()
    client.servers = running_servers(SPACE, SPACE.settings(SPACE.low))
    client.factor = CELL_M
    return client


def bias_of(client):
    """Return the planner's path distance bias."""
    return client.servers[PLANNER].values["path_distance_bias"]


def test_settings_per_cell_are_converted_and_others_are_sent_as_they_are(client):
    assert client.apply(SPACE.settings(THETA_0, per_cell=True)) == ""
    assert bias_of(client) == PER_METRE
    assert client.multipliers[PATH_INDEX] == 20.0
    assert client.apply(SPACE.settings(THETA_0)) == ""
    assert bias_of(client) == BIAS
    assert client.multipliers[PATH_INDEX] == 1.0

    # Until the planner's unit is known, and for a planner that counts per cell
    for factor in (None, 1.0):
        client.factor = factor
        assert client.apply(SPACE.settings(THETA_0, per_cell=True)) == ""
        assert bias_of(client) == BIAS


def test_the_parameters_in_force_are_read_in_either_unit(client):
    for theta in (THETA_0, SPACE.high):
        client.apply(SPACE.settings(theta, per_cell=True))
        # Exactly, although a quotient may differ in the last digit
        assert np.array_equal(client.theta(per_cell=True), theta)
        assert np.array_equal(client.theta(), theta)
    client.apply(SPACE.settings(THETA_0, per_cell=True))
    assert client.theta(per_cell=False)[PATH_INDEX] == PER_METRE
    # What another client has set
    client.servers[PLANNER].values["path_distance_bias"] = 40.0
    assert client.theta(per_cell=True)[PATH_INDEX] == 2.0


def test_what_was_sent_is_compared_in_the_planners_unit(client):
    client.apply(SPACE.settings(THETA_0, per_cell=True))
    assert client.sent != SPACE.settings(THETA_0)
    client.factor = 1.0
    assert client.sent == SPACE.settings(THETA_0)


@pytest.mark.parametrize("hinder", ["nothing", "unit", "value", "request"])
def test_a_request_is_in_force_if_the_servers_have_its_values_in_the_end(client, hinder):
    """The unit may become known, and another client may set a value, during a call."""
    client.request(SPACE.settings(THETA_0, per_cell=True))
    assert client.busy
    assert client.apply(SPACE.settings(THETA_0, per_cell=True)) == ""
    if hinder == "unit":
        client.factor = 1.0
    elif hinder == "value":
        client.servers[PLANNER].values["path_distance_bias"] = 0.1
    elif hinder == "request":
        client.request(SPACE.settings(SPACE.high, per_cell=True))
    client._note_in_force()
    assert client.busy == (hinder != "nothing")


def test_an_equal_request_is_in_force_at_once(client):
    """Values count, whoever asks for them."""
    settings = SPACE.settings(THETA_0)
    client.request(settings)
    client.apply(settings)
    client.request(SPACE.settings(THETA_0.copy()))
    client._note_in_force()
    assert not client.busy
    # A restart of a server asks for the same values again.
    client.reapply()
    assert client.busy
