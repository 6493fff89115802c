"""Task of an actor process: a training episode with exploration noise, submitted by train.py."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Callable, Dict

import numpy as np

from applr_ros1.common.tensors import unpack
from applr_ros1.policy.actor import Layers, forward, layers_of
from training.env.trajectory import Trajectory

TRAINING, WORLDS = (
    0,
    2,
)  # first number in the seed of an episode, and in that of the choice of its world
INFO = ("success", "collided", "time_s")  # keys of the environment's info that a trajectory keeps


@dataclass(frozen=True)
class Collect:
    """Training episode to drive. Its randomness comes only from the run's seed and the episode's number.

    Attributes:
        episode: Number of the episode.
        seed: Seed of the run.
        sigma: Standard deviation of the exploration noise.
        random: Whether uniformly random actions replace those of the policy.
    """

    episode: int
    seed: int
    sigma: float
    random: bool


@lru_cache(maxsize=1)
def environment(env: Callable[..., Any], options: str) -> Any:
    """Return an environment of the class `env` with `options` (keyword arguments as JSON), made once per process."""
    return env(**json.loads(options))


def policy_layers(weights: bytes) -> Layers:
    """Return the layers of a policy. weights: TD3.actor_weights() as the bytes of a safetensors file."""
    return layers_of(unpack(weights, "weights")[0])


def collect(env: Callable[..., Any], options: str, task: Collect, weights: bytes) -> Trajectory:
    """Drive an episode and return its trajectory.

    Args:
        env: Class of the environment.
        options: Keyword arguments of the environment as JSON.
        task: Episode to drive.
        weights: Weights of the policy (policy_layers).
    """
    made = environment(env, options)
    layout, layers = made.layout, policy_layers(weights)
    rng = np.random.default_rng([TRAINING, task.seed, *b"actor-0", task.episode])
    world = int(
        np.random.default_rng([WORLDS, task.seed, 0, task.episode]).integers(len(made.worlds))
    )
    observation, last = made.reset(seed=int(rng.integers(2**31)), options={"world": world})
    observations, actions, rewards = [observation], [], []
    terms: Counter[str] = Counter()  # sums of the reward's terms
    terminated = truncated = False
    while not (terminated or truncated):
        if task.random:
            action = rng.uniform(-1.0, 1.0, layout.action).astype(np.float32)
        else:
            noise = rng.standard_normal(layout.action, dtype=np.float32) * np.float32(task.sigma)
            action = np.clip(
                np.tanh(forward(layers, observation[: layout.seen])) + noise, -1.0, 1.0
            )
        observation, reward, terminated, truncated, last = made.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        terms.update(last.get("reward", {}))
    info: Dict[str, Any] = {name: last[name] for name in INFO if name in last}
    info.update({"return": sum(rewards), "length": len(rewards), "terms": dict(terms)})
    return Trajectory.of(layout, observations, actions, rewards, terminated, info)
