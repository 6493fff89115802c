"""Processor time of one choice of a velocity (findBestPath) on scenarios of the golden sets. Called by run.py.

The C++ planners' times of like scenarios stand in tests/golden/FORMAT.md (1,620 and 15,700 us) and
tests/golden_dwa/FORMAT_DWA.md (1,170 us).
"""

import statistics
import time
from pathlib import Path

from tests import replay_dwa, replay_golden

SETS = Path(__file__).resolve().parents[1]
SCENARIOS = 20
CYCLES = 30  # of each scenario; its median counts
FAST = dict(max_vel_x=2.0, max_vel_theta=3.14, min_vel_theta=-3.14, vx_samples=12, vtheta_samples=40)


def planner_cycle_default():
    """The Jackal's parameters: 6 x 20 samples."""
    return _trajectory_planner({})


def planner_cycle_max():
    """12 x 40 samples at up to 2 m/s, driving at 1.6 m/s."""
    return _trajectory_planner(FAST, (1.6, 0.0, 0.3))


def dwa_planner_cycle():
    """TurtleBot3 burger as its navigation package drives it: 861 samples of 1.5 s, 3 x 3 m."""
    times = []
    for scenario in _of_samples("golden_dwa", vx_samples=20, vy_samples=1, vth_samples=40):
        if scenario.robot == "burger" and scenario.expected["best"]["index"] >= 0:  # a legal command is found
            costmap, planner = replay_dwa.make_costmap(scenario), replay_dwa.make_planner(scenario)
            scene = costmap, scenario.array("plan"), scenario.inputs["pose"], scenario.inputs["vel"]
            times.append(_median(planner, replay_dwa.flags_in(scenario), scene))
    return _microseconds(times)


def _of_samples(name, **samples):
    """The scenarios of a set with so many samples."""
    found = [scenario for scenario in replay_golden.load(SETS / name) if scenario.kind == "dwa"]
    return [scenario for scenario in found if samples.items() <= scenario.inputs["params"].items()]


def _trajectory_planner(changes, velocity=None):
    times = []
    for scenario in _of_samples("golden", vx_samples=6, vtheta_samples=20)[:SCENARIOS]:
        costmap = replay_golden.make_costmap(scenario)
        planner = replay_golden.make_planner(scenario, costmap)
        planner.reconfigure(changes)
        planner.set_plan(scenario.array("plan"))
        scene = costmap, scenario.inputs["pose"], velocity or scenario.inputs["vel"]
        times.append(_median(planner, [0] * 10, scene))
    return _microseconds(times)


def _median(planner, state, scene):
    planner.find_best_path(*scene)
    took = []
    for _ in range(CYCLES):
        planner.state = state
        began = time.thread_time()
        planner.find_best_path(*scene)
        took.append(time.thread_time() - began)
    return 1e6 * statistics.median(took)


def _microseconds(times):
    """Their median, and how it is printed."""
    return statistics.median(times), "us (median of %d scenarios, %.0f to %.0f)" % (len(times), min(times), max(times))
