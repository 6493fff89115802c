"""The whole planner on courses like BARN's: time of one control cycle, and how much faster than time the simulators
with the planner run on one core. Called by run.py.

All of it runs in one thread, and its processor time is taken: what a clock shows on a machine that does nothing else.
"""

from time import process_time

import numpy as np

import sim_bridge
import worlds
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.warm_up import warm_up
from applr_ros1.policy.parameter_space import SPACE
from tests.support.jackal import JACKAL
from training.env.episode import Episode

COURSES = (3, 60, 140, 250)  # of the built-in worlds, from sparse to dense
DECISIONS = 10  # of each course, 20 simulated seconds


def control_cycle():
    """Mean time of MoveBase.step with scan, both costmaps, plan and control, at the Jackal's parameters."""
    warm_up()
    move_base = MoveBase(JACKAL)
    step, took = move_base.step, []

    def timed(*arguments):
        began = process_time()
        cycle = step(*arguments)
        if cycle.controlled:
            took.append(process_time() - began)
        return cycle

    move_base.step = timed
    means = []
    for _ in range(3):
        took.clear()
        _drive("kinematic", move_base, lambda random: SPACE.theta0)
        means.append(np.mean(took))
    return 1e3 * min(means), "ms (mean over %d cycles)" % len(took)


def sim_speed_kinematic():
    return _speed("kinematic")


def sim_speed_pybullet():
    return _speed("pybullet")


def reset_pybullet():
    """Time to build a world of 227 cylinders and the robot anew, as before each trial."""
    simulator, world = sim_bridge.make("pybullet"), worlds.load("generated:140")
    best = np.inf
    for seed in range(10):
        began = process_time()
        simulator.reset(world, seed)
        best = min(best, process_time() - began)
    simulator.close()
    return 1e3 * best, "ms"


def _speed(simulator):
    """Simulated seconds per wall second on one core, with new random parameters every two seconds, resets included."""
    warm_up()
    move_base = MoveBase(dict(JACKAL, planner_frequency=20.0))
    _drive(simulator, move_base, _random, decisions=1)
    best = 0.0
    for _ in range(3):
        began = process_time()
        simulated = _drive(simulator, move_base, _random)
        best = max(best, simulated / (process_time() - began))
    return best, "simulated s per wall s and core"


def _random(generator):
    return SPACE.to_theta(generator.uniform(-1.0, 1.0, len(SPACE)))


def _drive(simulator, move_base, theta, decisions=DECISIONS):
    """Drive the courses; returns simulated seconds."""
    episode = Episode(sim_bridge.make(simulator), move_base, period=2.0)
    generator, simulated = np.random.default_rng(0), 0.0
    for number in COURSES:
        episode.reset(worlds.load("generated:%d" % number), seed=number)
        for _ in range(decisions):
            outcome = episode.decide(theta(generator))
            simulated += outcome.seconds
            if outcome.over:
                break
    return simulated
