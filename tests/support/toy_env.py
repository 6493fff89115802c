"""A tiny task for the tests of training: go to zero on a line. No planner, no simulator, a millisecond an episode."""

import os
import time

import gymnasium
import numpy as np

from training.replay.trajectory import TransitionLayout


class Line(gymnasium.Env):
    """x' = x + .3 a, r = -|x'|, 10 steps, then truncated; terminated where |x| > 3 (never, from [-1, 1])."""

    observation_space = gymnasium.spaces.Box(-10, 10, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    layout, worlds = TransitionLayout(0, 1, 1), ["line"]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = self.np_random.uniform(-1, 1), 0
        return self._observation(), {}

    def step(self, action):
        self.x += 0.3 * float(np.clip(action[0], -1, 1))
        self.t += 1
        return self._observation(), -abs(self.x), False, self.t == 10, {}

    def _observation(self):
        return np.array([self.x], np.float32)


class Slow(Line):
    """Half a second an episode, so that a test can kill an actor in the middle."""

    def step(self, action):
        time.sleep(0.02)
        return super().step(action)


class Broken(Line):
    def step(self, action):
        raise RuntimeError("the wheels came off")


class Dying(Line):
    """Ends its process in one episode of eight."""

    def reset(self, *, seed=None, options=None):
        result = super().reset(seed=seed)
        if self.x > 0.75:
            os._exit(9)
        return result


def drive(number, seconds=0.0):
    """A call for workers: number 3 ends its process, number 4 fails, the rest say where they were executed."""
    time.sleep(seconds)
    if number == 3:
        os._exit(9)
    if number == 4:
        raise ValueError("this trial cannot be driven\nat all")
    return number, os.getpid()
