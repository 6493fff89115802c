"""The applr node beside a stand-in move_base, for the test files that share them: fixtures and small helpers."""

import pytest

from applr_ros1.policy.actor import save
from tests.support.fake_robot import Robot
from tests.support.ros_harness import session, wait_for
from tests.support.weights import make_weights

PERIOD = 0.2


@pytest.fixture(scope="module")
def ros():
    return session()


@pytest.fixture(scope="module")
def robot(ros):
    made = Robot()
    yield made
    made.close()


@pytest.fixture
def stack(ros, robot, tmp_path):
    """start(method, fake=[...], **private parameters) → (applr Child, stand-in Child, client on the stand-in)."""
    import rospy

    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient

    robot.reset()
    started = []

    def start_fake(*args):
        fake = ros.python("tests/support/fake_move_base.py", *args)
        started.append(fake)
        wait_for(lambda: "up" in fake.text or not fake.alive(), 10.0, "stand-in")
        assert fake.alive(), fake.text
        return fake

    def start(method="applr", policy="", fake=(), weights=None, ready=True, **parameters):
        move_base = start_fake(*fake) if fake is not None else None
        if method == "applr":
            save(tmp_path / "actor.safetensors", make_weights(hidden=(16,)) if weights is None else weights)
            method = "applr:%s" % (policy or tmp_path / "actor.safetensors")
        parameters = dict({"method": method, "period": PERIOD}, **parameters)
        node = ros.python("-m", "applr_ros1.scripts.applr", *[f"_{k}:={v}" for k, v in parameters.items()])
        started.append(node)
        if not ready:
            return node, move_base, None
        wait_for(lambda: robot.values or not node.alive(), 10.0, "applr node")
        assert node.alive(), node.text
        client = ReconfigureClient()
        clients.append(client)
        wait_for(lambda: not client.connect(), 5.0, "servers")
        return node, move_base, client

    clients = []
    start.fake = start_fake
    yield start
    robot.goal = None
    for client in clients:
        client.close()
    for child in reversed(started):
        child.kill()
    for name in ("/fake", "/use_sim_time"):
        if rospy.has_param(name):
            rospy.delete_param(name)


def says(robot, message, seconds=4.0):
    wait_for(lambda: robot.values.get("message") == message, seconds, "diagnostics: " + message)
