"""Parameters on five servers, all or none, within a deadline: the client and its worker beside a stand-in
move_base.
"""

import time

import numpy as np
import pytest

from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.nodes.applr.reconfigure_worker import ReconfigureWorker
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from tests.support.ros_harness import session, slowness, wait_for

pytestmark = pytest.mark.ros
PLANNER = "/move_base/TrajectoryPlannerROS"
LAYERS = ("/move_base/local_costmap/inflater_layer", "/move_base/global_costmap/inflater_layer")
COSTMAPS = [layer.rpartition("/")[0] for layer in LAYERS]


@pytest.fixture(scope="module")
def fake():
    child = session().python("tests/support/fake_move_base.py")
    wait_for(lambda: "up" in child.text or not child.alive(), 10.0, "stand-in")
    yield child
    child.thaw()
    child.kill()


@pytest.fixture(scope="module")
def connected(fake):
    client = ReconfigureClient()
    wait_for(lambda: not client.connect(), 10.0, "servers")
    yield client
    client.close()


@pytest.fixture
def client(connected):
    import rospy

    if rospy.has_param("/fake"):
        rospy.delete_param("/fake")
    assert connected.apply(THETA_0).ok
    return connected


def test_values_are_read_back(client):
    report = client.apply(SPACE.high)
    assert report.ok
    assert report.error == ""
    assert np.array_equal(client.theta(), SPACE.high)
    assert set(client.servers.values()) == {PLANNER, *LAYERS, *COSTMAPS}
    wait_for(
        lambda: client._servers["TrajectoryPlannerROS"].values["min_vel_theta"] == -3.14, 1.0, "the other direction"
    )


def test_fault_3_a_frozen_server_is_abandoned_in_time_and_recovers(client, fake):
    fake.freeze()
    for _ in range(3):
        began = time.monotonic()
        report = client.apply(SPACE.low)
        assert not report.ok
        assert "does not answer" in report.error
        assert time.monotonic() - began < 1.2 * slowness()
    fake.thaw()
    began = time.monotonic()
    assert client.apply(SPACE.high).ok
    assert time.monotonic() - began < 0.5 * slowness()
    time.sleep(0.2)
    assert np.array_equal(client.theta(), SPACE.high)  # none of the abandoned calls came through


@pytest.mark.fault("2")
def test_fault_2_values_beyond_bounds_are_clipped_and_rounded(client):
    report = client.apply(np.full(len(SPACE), 1e9))
    assert report.ok
    assert np.array_equal(client.theta(), SPACE.high)
    report = client.apply(np.array([-1e9, 0.5, 6.9, 20.4, 0.1, 0.75, 1.0, 0.3, 2.0, 0.3, 0.1]))
    assert report.ok
    assert client.theta()[:4].tolist() == [0.2, 0.5, 7, 20]


def test_fault_3_a_call_that_was_given_up_never_undoes_a_newer_one(client, fake):
    reports = []
    worker = ReconfigureWorker(client, reports.append, reports.append)
    worker.start()
    fake.freeze()
    worker.request(SPACE.low)
    wait_for(lambda: reports and reports[-1].unanswered, 3.0, "a call that is given up")
    worker.request(SPACE.high)
    time.sleep(0.3)
    fake.thaw()
    wait_for(lambda: not worker.busy, 3.0, "the newer set")
    time.sleep(0.3)
    assert np.array_equal(client.theta(), SPACE.high)
    worker.stop()


@pytest.mark.fault("5")
@pytest.mark.parametrize(("fault", "server"), [("refuse", PLANNER), ("hold", LAYERS[1]), ("lie", PLANNER)])
def test_fault_5_one_refusal_puts_the_others_back(client, server, fault):
    import rospy

    rospy.set_param("/fake/" + fault, [server])
    report = client.apply(SPACE.high)
    assert not report.ok
    assert server in report.error
    assert "\n" not in report.error
    assert len(report.put_back) >= 2
    for role, values, settings in ((role, s.values, s.settings) for role, s in client._servers.items()):
        for i, sign, name in settings:
            assert values[name] == sign * THETA_0[i], (role, name)
    rospy.delete_param("/fake/" + fault)
    assert client.apply(SPACE.high).ok


def test_a_node_without_servers_is_a_move_base_that_starts(connected):
    """This test's own node has none; nobody is called /nobody."""
    import rospy

    for namespace, starting in ((rospy.get_name(), True), ("/nobody", False), ("/move_base", False)):
        client = connected if namespace == connected.namespace else ReconfigureClient(namespace)
        client.connect()
        assert client.starting == starting, namespace


def test_servers_that_are_gone_are_named(client, fake):
    fake.kill()
    report = client.apply(SPACE.high)
    assert not report.ok
    assert all(server in report.error for server in (PLANNER, *LAYERS))
    assert "\n" not in report.error
