"""How long it takes to change all eight parameters and have them verified, over ROS. For run.py."""

import time

import numpy as np

COUNT = 200
RATE = 20.0  # changes a second: they come between control cycles, as in driving


def reconfigure_all():
    """95th percentile of changing all eight parameters of our idle move_base node, every value read back."""
    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
    from applr_ros1.policy.parameter_space import SPACE
    from tests.support.ros_harness import session, wait_for

    ros = session()
    node = ros.node("move_base", "cmd_vel:=/cmd_vel")
    client = ReconfigureClient()
    try:
        wait_for(lambda: client.connected or not node.alive() or not client.connect(), "parameter servers")
        assert node.alive(), node.text
        rng = np.random.default_rng(0)
        took = np.empty(COUNT)
        for i in range(COUNT):
            began = time.monotonic()
            error = client.apply(SPACE.to_theta(rng.uniform(-1.0, 1.0, len(SPACE))))
            assert not error, error
            took[i] = 1e3 * (time.monotonic() - began)
            time.sleep(max(0.0, 1.0 / RATE - (time.monotonic() - began)))
        return round(float(np.percentile(took, 95)), 2), "ms (p95)"
    finally:
        client.close()
        node.end()
