"""Small environment for tests of training: move to zero on a line, without planner and simulator (1
ms per episode).

The workers of a pool import this file, so it imports little. Runs in the environment are in
runs.py.
"""

import os
import time

import gymnasium
import numpy as np

from training.env.trajectory import Trajectory, TransitionLayout


class Line(gymnasium.Env):
    """Environment with x' = x + .3 a and r = -|x'|, truncated after 10 steps and never
    terminated.
    """

    observation_space = gymnasium.spaces.Box(-10, 10, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    layout = TransitionLayout(0, 1, 1)
    worlds = ["line"]

    def reset(self, *, seed=None, options=None):
        """Begin at a random place."""
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-1, 1)
        self.t = 0
        return self._observation(), {}

    def step(self, action):
        """Move by the action."""
        self.x += 0.3 * float(np.clip(action[0], -1, 1))
        self.t += 1
        return self._observation(), -abs(self.x), False, self.t == 10, {}

    def _observation(self):
        return np.array([self.x], np.float32)


class Slow(Line):
    """Environment that takes 0.2 s per episode, so that a test can kill an actor during an
    episode.
    """

    def step(self, action):
        time.sleep(0.02)
        return super().step(action)


class Broken(Line):
    """Environment that fails in its first step."""

    def step(self, action):
        raise RuntimeError("the wheels came off")


class Dying(Line):
    """Environment that ends its process in one of eight episodes."""

    def reset(self, *, seed=None, options=None):
        result = super().reset(seed=seed)
        if self.x > 0.75:
            os._exit(9)
        return result


def answer(number, seconds=0.0):
    """Task for workers: 3 ends the worker process, 4 raises, any other number returns (number,
    process id).
    """
    time.sleep(seconds)
    if number == 3:
        os._exit(9)
    if number == 4:
        raise ValueError("this trial cannot be driven\nat all")
    return number, os.getpid()


def episode(layout, number, length=3, terminated=False, **info):
    """Return an episode of t transitions in a layout, drawn with the seed `number`."""
    rng = np.random.default_rng(number)
    observations = rng.uniform(-1, 1, (length + 1, layout.size))
    actions = rng.uniform(-1, 1, (length, layout.action))
    return Trajectory.of(layout, observations, actions, rng.normal(size=length), terminated, info)
