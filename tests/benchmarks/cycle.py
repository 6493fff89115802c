"""The whole planner on courses like BARN's: time of one control cycle and of its maps, and how much faster than time
the simulators with the planner run on one core. Called by run.py.

All of it runs in one thread, and its processor time is taken: what a clock shows on a machine that does nothing else.
FORMAT.md of the golden set has C++ figures: inflation of 200 x 200 cells 179 us, navfn on 800 x 800 cells 1,076 us.
"""

from time import process_time
from unittest.mock import patch

import numpy as np

import sim_bridge
import worlds
from applr_ros1.planner.costmap.inflation_layer import InflationLayer
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.navfn.navfn import Navfn
from applr_ros1.planner.warm_up import warm_up
from applr_ros1.policy.parameter_space import SPACE
from tests.support.jackal import JACKAL
from training.env.episode import Episode

COURSES = (3, 60, 140, 250)  # of the built-in worlds, from sparse to dense
SECONDS = 20  # of each course that are simulated at most


def control_cycle():
    """Mean time of MoveBase.step with scan, both costmaps, plan and control, at the Jackal's parameters."""
    mean, count = _time_in_drives(MoveBase, "step", lambda _, cycle: cycle.controlled)
    return 1e3 * mean, "ms (mean over %d cycles)" % count


def inflation():
    """One update of the inflation layer of the local map, 200 x 200 cells, r = .30, while driving."""
    mean, count = _time_in_drives(InflationLayer, "update", lambda layer, _: layer._nx == 200)
    return 1e6 * mean, "us (mean over %d updates)" % count


def navfn():
    """One plan on the global map, 800 x 800 cells, from the driving robot to the goal, the map changing meanwhile."""
    mean, count = _time_in_drives(Navfn, "plan", lambda *_: True, planner_frequency=20.0)
    return 1e6 * mean, "us (mean over %d plans)" % count


def _time_in_drives(kind, name, counts, **parameters):
    """Mean time [s] of a method's calls that count, and their number, in the best of three drives of the courses."""
    warm_up()
    method, took, means = getattr(kind, name), [], []

    def timed(made, *arguments):
        began = process_time()
        result = method(made, *arguments)
        if counts(made, result):
            took.append(process_time() - began)
        return result

    with patch.object(kind, name, timed):
        for _ in range(3):
            took.clear()
            _drive(make_episode("kinematic", MoveBase({**JACKAL, **parameters})), lambda *_: SPACE.theta0)
            means.append(np.mean(took))
    return min(means), len(took)


def sim_speed_kinematic():
    return _speed(make_episode("kinematic"))


def sim_speed_pybullet():
    return _speed(make_episode("pybullet"))


def _speed(episode):
    """Simulated seconds per wall second on one core with random parameters, see _drive(), resets included."""
    warm_up()
    _drive(episode, _random, seconds=2)
    best = 0.0
    for _ in range(3):
        began = process_time()
        simulated = _drive(episode, _random)
        best = max(best, simulated / (process_time() - began))
    return best, "simulated s per wall s and core"


def _random(episode, random):
    """Other random parameters at each decision."""
    return SPACE.to_theta(random.uniform(-1.0, 1.0, len(SPACE)))


def make_episode(simulator, move_base=None, period=2.0, **options):
    move_base = move_base or MoveBase(dict(JACKAL, planner_frequency=20.0))
    return Episode(sim_bridge.make(simulator), move_base, period=period, **options)


def _drive(episode, theta, seconds=SECONDS):
    """Drive the courses with theta(episode, random generator) at each decision; returns simulated seconds."""
    random, simulated = np.random.default_rng(0), 0.0
    for number in COURSES:
        episode.reset(worlds.load("generated:%d" % number), seed=number)
        for _ in range(round(seconds / episode.period)):
            outcome = episode.decide(theta(episode, random))
            simulated += outcome.seconds
            if outcome.over:
                break
    return simulated
