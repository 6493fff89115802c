"""How long it takes to change all eight parameters and have them verified, over ROS. Called by run.py.

Starts its own master and move_base and ends them.
"""

import time

import numpy as np


def reconfigure_all():
    """(95th percentile, unit) of changing all eight parameters, every value read back. For run.py."""
    return round(float(np.percentile(measure(), 95)), 2), "ms (p95)"


def measure(count=200, rate=20.0):
    """Milliseconds of `count` changes of all eight parameters, every value read back, (count,) float64.

    rate: changes a second (they come between control cycles as in driving). The servers are those of our move_base
    node, idle.
    """
    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
    from applr_ros1.policy.parameter_space import SPACE
    from tests.support.ros_harness import session, wait_for

    ros = session()
    node = ros.node("move_base", "cmd_vel:=/cmd_vel")
    client = ReconfigureClient()
    try:
        wait_for(lambda: client.connected or not node.alive() or not client.connect(), 120.0, "parameter servers")
        assert node.alive(), node.text
        rng = np.random.default_rng(0)
        took = np.empty(count)
        for i in range(count):
            began = time.monotonic()
            report = client.apply(SPACE.to_theta(rng.uniform(-1.0, 1.0, len(SPACE))))
            assert report.ok, report.error
            took[i] = 1e3 * (time.monotonic() - began)
            time.sleep(max(0.0, 1.0 / rate - (time.monotonic() - began)))
        return took
    finally:
        client.close()
        node.end()
