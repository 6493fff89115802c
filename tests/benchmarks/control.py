"""Time of the trajectory planner's cycle (findBestPath) on scenarios of the golden set. Called by run.py.

The C++ planner's times of like scenarios stand in tests/golden/FORMAT.md: 1,620 and 15,700 us.
"""

import statistics
import time
from pathlib import Path
from types import SimpleNamespace

from applr_ros1.planner.costmap.footprint import pad
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from tests.replay_golden import load

SCENARIOS = 20
CYCLES = 30  # of each scenario; its median counts
FAST = dict(max_vel_x=2.0, max_vel_theta=3.14, min_vel_theta=-3.14, vx_samples=12, vtheta_samples=40)


def planner_cycle_default():
    """The Jackal's parameters: 6 x 20 samples."""
    return microseconds(times({}))


def planner_cycle_max():
    """12 x 40 samples at up to 2 m/s, driving at 1.6 m/s."""
    return microseconds(times(FAST, (1.6, 0.0, 0.3)))


def microseconds(seconds):
    """Median [us] of times [s], and how it is printed."""
    return 1e6 * statistics.median(seconds), "us (median of %d scenarios, %.0f to %.0f)" % (
        len(seconds),
        1e6 * min(seconds),
        1e6 * max(seconds),
    )


def times(changes, velocity=None):
    """Median time [s] of a cycle for each of the scenarios, with some parameters changed."""
    chosen = [
        scenario
        for scenario in load(Path(__file__).resolve().parents[1] / "golden")
        if scenario.kind == "dwa"
        and scenario.inputs["params"]["vx_samples"] == 6
        and scenario.inputs["params"]["vtheta_samples"] == 20
    ][:SCENARIOS]
    return [_median(scenario, changes, velocity) for scenario in chosen]


def _median(scenario, changes, velocity):
    given = scenario.inputs
    planner = TrajectoryPlanner(
        pad(given["footprint"], given["footprint_padding"]),
        dict(given["params"], **changes),
        given["sim_period"],
        bool(given["meter_scoring"]),
    )
    planner.set_plan(scenario.array("plan"))
    costmap = SimpleNamespace(cells=scenario.array("costmap"), origin=given["origin"], resolution=given["resolution"])
    pose, velocity = given["pose"], velocity or given["vel"]
    planner.find_best_path(costmap, pose, velocity)
    took = []
    for _ in range(CYCLES):
        planner.state = [0] * 10
        began = time.perf_counter()
        planner.find_best_path(costmap, pose, velocity)
        took.append(time.perf_counter() - began)
    return statistics.median(took)
