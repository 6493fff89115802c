"""Time of the DWA planner's cycle on scenarios of the golden set. Called by run.py.

The C++ planner's times of like scenarios stand in tests/golden_dwa/FORMAT_DWA.md: 1,170 us (burger), 2,103 us (waffle).
"""

import statistics
import time
from pathlib import Path

from tests import replay_dwa
from tests.benchmarks.control import microseconds
from tests.replay_golden import load

CYCLES = 60  # of each scenario; its median counts
FOLDER = Path(__file__).resolve().parents[1] / "golden_dwa"
SAMPLES = (20, 1, 40)


def dwa_planner_cycle():
    """TurtleBot3 burger as its navigation package drives it: 861 samples of 1.5 s, 3 x 3 m."""
    return microseconds(times("burger"))


def dwa_planner_cycle_waffle():
    """TurtleBot3 waffle: 861 samples of 2.0 s, 3 x 3 m."""
    return microseconds(times("waffle"))


def times(robot, folder=FOLDER):
    """Median processor time [s] of a cycle for each scenario of a robot in which a legal command is found."""
    chosen = [
        scenario
        for scenario in load(folder)
        if scenario.kind == "dwa"
        and scenario.robot == robot
        and scenario.expected["best"]["index"] >= 0
        and tuple(scenario.inputs["params"][name] for name in ("vx_samples", "vy_samples", "vth_samples")) == SAMPLES
    ]
    return [_median(scenario) for scenario in chosen]


def _median(scenario):
    given = scenario.inputs
    costmap, planner = replay_dwa.make_costmap(scenario), replay_dwa.make_planner(scenario)
    plan, flags = scenario.array("plan"), replay_dwa.flags_in(scenario)
    planner.find_best_path(costmap, plan, given["pose"], given["vel"])
    took = []
    for _ in range(CYCLES):
        planner.state = flags
        began = time.thread_time()
        planner.find_best_path(costmap, plan, given["pose"], given["vel"])
        took.append(time.thread_time() - began)
    return statistics.median(took)
