"""How long it takes to change all eight parameters and have them verified, over ROS. Called by run.py.

By itself: python tests/benchmarks/reconfigure.py [--stand-in]. Starts its own master and move_base and ends them.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]


def reconfigure_all():
    """(95th percentile, unit) of changing all eight parameters, every value read back. For run.py."""
    return round(float(np.percentile(measure(), 95)), 2), "ms (p95)"


def measure(count=200, rate=20.0, stand_in=False):
    """Milliseconds of `count` changes of all eight parameters, every value read back, (count,) float64.

    rate: changes a second (they come between control cycles as in driving). The servers are those of our move_base
    node, idle; stand_in: of dynamic_reconfigure's own Python library.
    """
    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
    from applr_ros1.policy.parameter_space import SPACE
    from tests.support.ros_harness import session, wait_for

    ros = session()
    if stand_in:
        node = ros.python("tests/support/fake_move_base.py")
    else:
        node = ros.python("-m", "applr_ros1.scripts.move_base", "cmd_vel:=/cmd_vel")
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
            took[i] = 1e3 * report.seconds
            time.sleep(max(0.0, 1.0 / rate - (time.monotonic() - began)))
        return took
    finally:
        client.close()
        node.end()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stand-in", action="store_true", help="dynamic_reconfigure's own servers, not move_base's")
    took = measure(stand_in=parser.parse_args().stand_in)
    print(
        json.dumps(
            {
                "reconfigure_all": {"value": round(float(np.percentile(took, 95)), 2), "unit": "ms (p95)"},
                "median": round(float(np.median(took)), 2),
                "worst": round(float(took.max()), 2),
            }
        )
    )


if __name__ == "__main__":
    main()
