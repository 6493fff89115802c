"""Tests of the reconfigure client without ROS: the unit of settings, and when they are in force."""

from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.nodes.applr.node import ApplrNode
from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from applr_ros1.policy.pilot import BY_HAND, DEFAULTS, METHOD, STALL, Choice, Pilot
from applr_ros1.robots import JACKAL
from tests.support.contexts import Chooses
from tests.support.ros import wait_for
from tests.support.servers import running_servers

PLANNER = "TrajectoryPlannerROS"
CELL_M = 0.05  # edge of a cell of the local costmap [m]
PATH_INDEX = SPACE.names.index("pdist_scale")
BIAS = THETA_0[PATH_INDEX]
PER_METRE = BIAS / CELL_M


def client_of_running_servers(**options):
    """Return a client of running servers, whose planner counts per metre."""
    client = ReconfigureClient(**options)
    client.servers = running_servers(SPACE, SPACE.settings(SPACE.low))
    client.factor = CELL_M
    return client


@pytest.fixture
def client():
    """Return such a client, whose thread has not started."""
    return client_of_running_servers()


def bias_of(client):
    """Return the planner's path distance bias."""
    return client.servers[PLANNER].values["path_distance_bias"]


def test_settings_per_cell_are_converted_and_others_are_sent_as_they_are(client):
    assert client.apply(SPACE.settings(THETA_0), per_cell=True) == ""
    assert bias_of(client) == PER_METRE
    assert client.multipliers[PATH_INDEX] == 20.0
    assert client.apply(SPACE.settings(THETA_0)) == ""
    assert bias_of(client) == BIAS
    assert client.multipliers[PATH_INDEX] == 1.0

    # Until the planner's unit is known, and for a planner that counts per cell
    for factor in (None, 1.0):
        client.factor = factor
        assert client.apply(SPACE.settings(THETA_0), per_cell=True) == ""
        assert bias_of(client) == BIAS


def test_the_parameters_in_force_are_read_in_either_unit(client):
    for theta in (THETA_0, SPACE.high):
        client.apply(SPACE.settings(theta), per_cell=True)
        # Exactly, although a quotient may differ in the last digit
        assert np.array_equal(client.theta(per_cell=True), theta)
        assert np.array_equal(client.theta(), theta)
    client.apply(SPACE.settings(THETA_0), per_cell=True)
    assert client.theta(per_cell=False)[PATH_INDEX] == PER_METRE
    # What another client has set
    client.servers[PLANNER].values["path_distance_bias"] = 40.0
    assert client.theta(per_cell=True)[PATH_INDEX] == 2.0


def test_what_was_sent_is_compared_in_the_planners_unit(client):
    client.apply(SPACE.settings(THETA_0), per_cell=True)
    assert client.sent != SPACE.settings(THETA_0)
    client.factor = 1.0
    assert client.sent == SPACE.settings(THETA_0)


def test_methods_choose_per_cell_and_people_in_the_unit_that_is_in_force():
    client = client_of_running_servers()
    pilot = Pilot(Chooses(), JACKAL)
    node = SimpleNamespace(client=client, supervisor=SimpleNamespace(pilot=pilot))
    units = []
    for why in (BY_HAND, METHOD, BY_HAND, STALL, DEFAULTS, BY_HAND):
        ApplrNode._request(node, Choice(THETA_0, False, why))
        units.append(client.is_per_cell)
    assert units == [False, True, True, True, False, False]


@pytest.mark.parametrize(
    ("hinder", "is_in_force"),
    [
        ("nothing", True),
        ("unit", False),
        ("value", False),
        ("request", False),
        ("equal request", True),
    ],
)
def test_a_request_is_in_force_if_the_servers_have_its_values_in_the_end(
    hinder, is_in_force, monkeypatch
):
    """The unit may become known, and another client may set a value, during a call."""
    # Given: a client, and what happens at the end of its first call
    busy = []  # whether a request is open at each report
    client = client_of_running_servers(on_report=lambda error: busy.append(client.busy))
    apply = client.apply

    def hindered(settings, per_cell):
        """Apply settings, and hinder the first ones."""
        error = apply(settings, per_cell)
        if busy:
            return error
        if hinder == "unit":
            client.factor = 1.0
        elif hinder == "value":
            client.servers[PLANNER].values["path_distance_bias"] = 0.1
        elif hinder == "request":
            client.request(SPACE.settings(SPACE.high), per_cell=True)
        elif hinder == "equal request":
            client.request(SPACE.settings(THETA_0.copy()), per_cell=True)
        return error

    monkeypatch.setattr(client, "apply", hindered)
    client.request(SPACE.settings(THETA_0), per_cell=True)
    assert client.busy

    # When: it puts a request in force
    client.start()
    wait_for(lambda: busy and not client.busy, "the request")
    client.stop()

    # Then: what hinders it is made good by another call
    assert busy == ([False] if is_in_force else [True, False])
    # A restart of a server asks for the same values again.
    client.reapply()
    assert client.busy
