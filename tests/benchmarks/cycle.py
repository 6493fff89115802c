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
SECONDS = 20  # of each course that are simulated at most


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
        _drive(make_episode("kinematic", move_base), lambda episode, random: SPACE.theta0)
        means.append(np.mean(took))
    return 1e3 * min(means), "ms (mean over %d cycles)" % len(took)


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
