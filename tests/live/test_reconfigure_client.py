"""Tests of the parameter client with the five servers of a fake move_base."""

import time
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest
import rospy
from dynamic_reconfigure.client import Client
from dynamic_reconfigure.encoding import encode_config
from dynamic_reconfigure.msg import Config, ConfigDescription

from applr_ros1.nodes.applr import reconfigure_client
from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from tests.support.ros import LONGEST, Kept, session, wait_for

pytestmark = pytest.mark.ros
PLANNER = "/move_base/TrajectoryPlannerROS"
LAYERS = ("/move_base/local_costmap/inflater_layer", "/move_base/global_costmap/inflater_layer")
COSTMAPS = [layer.rpartition("/")[0] for layer in LAYERS]


@pytest.fixture(scope="module")
def fake():
    """Return a fake move_base for all tests of this file."""
    child = session().node("tests.support.nodes")
    child.until("all up")
    yield child
    child.thaw()
    child.kill()


@pytest.fixture(scope="module")
def connected(fake):
    """Return a client that has found all servers."""
    client = ReconfigureClient()
    wait_for(lambda: not client.connect(), "servers")
    yield client
    client.close()


@pytest.fixture
def client(connected, monkeypatch):
    """Return the client with theta_0 in force on well-behaved servers."""
    # Time for a server's parameter_updates: on a busy machine, its usual limit can pass.
    monkeypatch.setattr(reconfigure_client, "ANNOUNCED_S", 5.0)
    if rospy.has_param("/fake"):
        rospy.delete_param("/fake")
    assert applied(connected, THETA_0)
    return connected


def applied(client, theta, per_cell=False):
    """Return whether the parameter set theta comes into force, with a limit long enough for a busy
    machine.
    """
    return not client.apply(client.space.settings(theta), per_cell, LONGEST)


@contextmanager
def publishing(topic, message):
    """Publish a message on a topic of a server meanwhile."""
    publisher = rospy.Publisher(topic, type(message), queue_size=1, latch=True)
    publisher.publish(message)
    try:
        yield
    finally:
        publisher.unregister()


def set_by_another_client(server, **values):
    """Set parameters of a server as rqt_reconfigure does."""
    another = Client(server, LONGEST)
    another.update_configuration(values)
    another.close()


@contextmanager
def started(on_report=lambda error: None):
    """Provide a connected client whose thread applies requests."""
    client = ReconfigureClient(on_report=on_report)
    client.start()
    try:
        wait_for(lambda: client.connected, "servers")
        yield client
    finally:
        client.close()


def test_an_idle_client_waits_without_using_the_processor(fake):
    with started() as client:
        client.request(SPACE.settings(THETA_0))
        wait_for(lambda: not client.busy, "parameters in force")
        began = time.process_time()
        # A thread that polls would use a good part of this second.
        time.sleep(1.0)
        assert time.process_time() - began < 0.2


def test_values_are_read_back(client):
    assert client.apply(SPACE.settings(SPACE.high), seconds=LONGEST) == ""
    assert np.array_equal(client.theta(), SPACE.high)
    assert {server.name for server in client.servers.values()} == {PLANNER, *LAYERS, *COSTMAPS}
    wait_for(
        lambda: client.servers["TrajectoryPlannerROS"].values["min_vel_theta"] == -3.14,
        "the other direction",
    )


@pytest.fixture
def calls(client):
    """Provide a function that waits for the calls of a number of servers, and returns all that
    were called since its last call, as seen on parameter_updates.
    """
    updated = Counter()

    def listen(name):
        topic = name + "/parameter_updates"
        return rospy.Subscriber(topic, Config, lambda message: updated.update([name]))

    subscribers = [listen(server.name) for server in client.servers.values()]

    def poll(server_count):
        wait_for(lambda: len(updated) >= server_count, "the calls")
        # A server publishes within its call; the message of one too many takes a moment.
        time.sleep(0.2)
        called_servers = set(updated)
        updated.clear()
        return called_servers

    # The latched messages are no calls.
    poll(len(subscribers))
    yield poll
    for subscriber in subscribers:
        subscriber.unregister()


def test_a_server_whose_values_are_in_force_is_not_called(client, calls):
    theta = THETA_0.copy()
    theta[0] = 1.5
    # The second request has nothing to set.
    for expected_calls in ({PLANNER}, set()):
        assert applied(client, theta)
        assert calls(len(expected_calls)) == expected_calls
    local_costmap = client.servers["local_costmap"]
    set_by_another_client(local_costmap.name, footprint_padding=0.02)
    wait_for(
        lambda: local_costmap.values["footprint_padding"] == 0.02, "the value set by another client"
    )
    assert calls(1) == {COSTMAPS[0]}
    assert applied(client, theta)
    assert calls(1) == {COSTMAPS[0]}
    assert np.array_equal(client.theta(), theta)


def test_a_new_client_calls_no_server_whose_values_are_in_force(client, calls):
    """A C++ costmap's server would clear the costmap."""
    newcomer = ReconfigureClient()
    wait_for(lambda: not newcomer.connect(), "servers")
    assert applied(newcomer, THETA_0)
    assert calls(0) == set()
    newcomer.close()


def test_a_restarted_server_is_called_with_any_last_values(client, calls):
    local_costmap = client.servers["local_costmap"]
    topic = local_costmap.name + "/parameter_descriptions"
    description = rospy.wait_for_message(topic, ConfigDescription, LONGEST)
    # A server publishes its description at its start alone: a second one is that of a new
    # process.
    with publishing(topic, description):
        wait_for(lambda: not local_costmap.has_set({}), "the restart")
    for expected_calls in ({COSTMAPS[0]}, set()):
        assert applied(client, THETA_0)
        assert calls(len(expected_calls)) == expected_calls


@pytest.mark.parametrize("values", [{}, {"max_vel_x": "fast"}], ids=["nothing", "a text"])
def test_a_value_that_is_not_a_number_is_unknown_and_set_again(client, values):
    served_values = dict(client.servers["TrajectoryPlannerROS"].values)
    del served_values["max_vel_x"]
    config = encode_config({**served_values, **values})
    with publishing(PLANNER + "/parameter_updates", config):
        wait_for(lambda: client.theta() is None, "the message")
    assert applied(client, THETA_0)
    assert np.array_equal(client.theta(), THETA_0)


def test_an_answer_counts_when_the_server_has_published_the_values(client):
    # The values are published after the answer: an answer alone may be a lie (fault 5).
    rospy.set_param("/fake/late", [PLANNER])
    assert applied(client, SPACE.high)
    assert np.array_equal(client.theta(), SPACE.high)
    with started() as client:  # The second request comes while the first is under way.
        for theta in (SPACE.low, THETA_0):
            client.request(SPACE.settings(theta))
            time.sleep(0.05)
        wait_for(lambda: not client.busy, "both sets")
        assert np.array_equal(client.theta(), THETA_0)


def test_fault_3_a_frozen_server_is_abandoned_in_time_and_recovers(client, fake):
    fake.freeze()
    # Each call waits anew: one that was given up must not make the next one wait longer.
    for _ in range(3):
        stopwatch = Kept()
        began = time.monotonic()
        assert "does not answer" in client.apply(SPACE.settings(SPACE.low))
        # The servers are called at the same time, so that one time limit holds for all.
        assert time.monotonic() - began < 1.2 + stopwatch.waiting()
    fake.thaw()
    wait_for(lambda: applied(client, SPACE.high), "the set after the calls that were given up")
    time.sleep(0.2)
    assert np.array_equal(client.theta(), SPACE.high)  # No abandoned call was applied.


@pytest.mark.fault("2")
def test_fault_2_values_beyond_the_bounds_of_a_server_are_clipped(client):
    # If the space of parameters allows more than the servers, the servers' bounds apply.
    wide_space = replace(SPACE, low=-1e3 * SPACE.high, high=1e3 * SPACE.high)
    wide_client = ReconfigureClient(space=wide_space)
    wait_for(lambda: not wide_client.connect(), "servers")
    for theta, bound in ((wide_space.low, "min"), (wide_space.high, "max")):
        assert applied(wide_client, theta)
        planner = wide_client.servers["TrajectoryPlannerROS"]
        for parameter_name in ("max_vel_x", "vx_samples", "occdist_scale"):
            served_bound = planner.declared[parameter_name][bound]
            assert planner.values[parameter_name] == served_bound
    wide_client.close()


@pytest.mark.fault("5")
@pytest.mark.parametrize(
    ("fault", "server"), [("refuse", PLANNER), ("hold", LAYERS[1]), ("lie", PLANNER)]
)
def test_fault_5_one_refusal_is_read_back_and_the_next_attempt_sets_the_missing_values(
    client, server, fault
):
    rospy.set_param("/fake/" + fault, [server])
    error_message = client.apply(SPACE.settings(SPACE.high), seconds=LONGEST)
    assert server in error_message
    assert "\n" not in error_message
    # The others took the set; this one has what it had.
    for role, server_client in client.servers.items():
        theta = THETA_0 if server_client.name == server else SPACE.high
        assert server_client.has_set(server_client.bounded(SPACE.settings(theta)[role])), role
    rospy.delete_param("/fake/" + fault)
    assert applied(client, SPACE.high)


def test_no_text_of_a_server_is_executed(tmp_path):
    """The client of dynamic_reconfigure would evaluate the edit_method of a parameter that is set
    to a text.
    """
    # The text would write a file.
    written_file = tmp_path / "ran"
    malicious_text = f"open({str(written_file)!r}, 'w')"
    malicious = session().node("tests.support.nodes", "__name:=evil", "--text", malicious_text)
    malicious.until("all up")
    client = ReconfigureClient("/evil")
    wait_for(lambda: not client.connect(), "the servers")
    with suppress(TypeError):  # The bounds are texts.
        client.apply(SPACE.settings(SPACE.high))
    malicious.kill()
    assert not written_file.exists()


def test_dead_servers_are_named_and_the_request_is_kept(client, fake):
    reports = []
    with started(reports.append) as requester:
        fake.kill()
        requester.request(SPACE.settings(SPACE.high))
        wait_for(lambda: len(reports) >= 5, "attempts")
        assert requester.busy
    error_message = client.apply(SPACE.settings(SPACE.high))
    assert all(server in error_message for server in (PLANNER, *LAYERS))
    assert "\n" not in error_message
