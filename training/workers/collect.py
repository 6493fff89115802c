"""Work of an actor in an environment: a training episode with exploration noise. train.py submits them.

Trials of the policy that is being learnt drive with PolicyWeights, too (training/evaluation/runner.py).
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pkgutil import resolve_name
from typing import Any, Dict

import numpy as np

from applr_ros1.common.tensors import unpack
from applr_ros1.policy.actor import forward, layers_of
from training.replay.trajectory import Trajectory

NAVIGATION = "training.env.env:ApplrEnv"  # the navigation task
TRAINING, WORLDS = 0, 2  # first numbers of the seeds of training episodes, and of the worlds drawn for them
INFO = ("success", "collided", "time_s")  # entries of the environment's info that a trajectory keeps


@dataclass(frozen=True)
class Collect:
    """A training episode to be driven. All of its randomness comes from the run's seed and the episode's number.

    sigma is the standard deviation of the noise, random asks for uniform actions instead of the policy's; version is
    the policy's, in gradient steps.
    """

    episode: int
    seed: int
    sigma: float
    random: bool
    version: int = -1


def draw_world(seed: int, episode: int, worlds: int) -> int:
    """Return the index of an episode's world among so many."""
    return int(np.random.default_rng([WORLDS, seed, 0, episode]).integers(worlds))


@lru_cache(maxsize=1)
def environment(env: str, options: str) -> Any:
    """Return the environment "module:Class", made once in a process; options: its keyword arguments as JSON."""
    return resolve_name(env)(**json.loads(options))


def collect(env: str, options: str, task: Collect, weights: bytes) -> Trajectory:
    """Drive an episode and return its trajectory.

    Args:
        env: "module:Class" of the environment.
        options: its keyword arguments as JSON.
        task: what to drive.
        weights: the policy's, as PolicyWeights reads them.
    """
    made = environment(env, options)
    layout, policy = made.layout, PolicyWeights(weights)
    rng = np.random.default_rng([TRAINING, task.seed, *b"actor-0", task.episode])
    world = draw_world(task.seed, task.episode, len(made.worlds))
    observation, last = made.reset(seed=int(rng.integers(2**31)), options={"world": world})
    observations, actions, rewards = [observation], [], []
    terms: Counter[str] = Counter()  # sums of the reward's terms
    terminated = truncated = False
    while not (terminated or truncated):
        if task.random:
            action = rng.uniform(-1.0, 1.0, layout.action).astype(np.float32)
        else:
            noise = rng.standard_normal(layout.action, dtype=np.float32) * np.float32(task.sigma)
            action = np.clip(policy(observation[: layout.seen]) + noise, -1.0, 1.0)
        observation, reward, terminated, truncated, last = made.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        terms.update(last.get("reward", {}))
    info: Dict[str, Any] = {name: last[name] for name in INFO if name in last}
    info.update({"return": sum(rewards), "length": len(rewards), "terms": dict(terms), "version": task.version})
    return Trajectory.of(layout, observations, actions, rewards, terminated, info)


class PolicyWeights:
    """The learnt policy in numpy, of any size, without noise: observation → action.

    Args:
        weights: safetensors of "0.weight" (out, in), "0.bias" (out,), "1.weight", ... in float32, or of several such
            networks side by side (applr_ros1/policy/actor.py).
    """

    def __init__(self, weights: bytes):
        arrays, _ = unpack(weights, "weights")
        self.layers = layers_of(arrays)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Observation (n,) → action (m,) float32 in [-1, 1]."""
        return np.tanh(forward(self.layers, observation))
