"""Work of an actor: a training episode with exploration noise, submitted by train.py.

PolicyWeights also drives the evaluation trials of the policy in training (training/evaluation/runner.py).
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

NAVIGATION = "training.env.env:ApplrEnv"  # "module:Class" of the navigation environment
TRAINING, WORLDS = 0, 2  # first number of the seeds of training episodes, and of their worlds
INFO = ("success", "collided", "time_s")  # keys of the environment's info that a trajectory keeps


@dataclass(frozen=True)
class Collect:
    """Order for a training episode, whose randomness comes only from the run's seed and the episode's number.

    Attributes:
        episode: Number of the episode.
        seed: Seed of the run.
        sigma: Standard deviation of the exploration noise.
        random: Whether uniformly random actions replace those of the policy.
        version: Number of gradient steps of the policy.
    """

    episode: int
    seed: int
    sigma: float
    random: bool
    version: int = -1


def draw_world(seed: int, episode: int, worlds: int) -> int:
    """Return the index of an episode's world among `worlds` worlds."""
    return int(np.random.default_rng([WORLDS, seed, 0, episode]).integers(worlds))


@lru_cache(maxsize=1)
def environment(env: str, options: str) -> Any:
    """Return the environment "module:Class", made once per process with `options`, keyword arguments as JSON."""
    return resolve_name(env)(**json.loads(options))


def collect(env: str, options: str, task: Collect, weights: bytes) -> Trajectory:
    """Drive an episode and return its trajectory.

    Args:
        env: "module:Class" of the environment.
        options: keyword arguments of the environment as JSON.
        task: episode to drive.
        weights: weights of the policy for PolicyWeights.
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
    """Learnt policy of any size in numpy, without noise.

    Args:
        weights: safetensors of "0.weight" (out, in), "0.bias" (out,), "1.weight", ... in float32, or of several
            networks stacked along the first axis (applr_ros1/policy/actor.py).
    """

    def __init__(self, weights: bytes):
        arrays, _ = unpack(weights, "weights")
        self.layers = layers_of(arrays)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the action (m,) float32 in [-1, 1] for an observation (n,)."""
        return np.tanh(forward(self.layers, observation))
