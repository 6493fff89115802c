"""Task of an actor process: a training episode with exploration noise, submitted by a training."""

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

# First numbers in the seed of an episode, and in that of the choice of its world
TRAINING = 0
WORLDS = 2
INFO = ("success", "collided", "time_s")  # keys of the environment's info that a trajectory keeps


@dataclass(frozen=True)
class Collect:
    """Training episode to drive.

    Its randomness comes only from the run's seed and the episode's number.

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
    """Return an environment, made once per process.

    Args:
        env: Class of the environment.
        options: Its keyword arguments as JSON.
    """
    return env(**json.loads(options))


def policy_layers(weights: bytes) -> Layers:
    """Return the layers of a policy.

    Args:
        weights: TD3.actor_weights() as the bytes of a safetensors file.
    """
    tensors, _ = unpack(weights, "weights")
    return layers_of(tensors)


def collect(env: Callable[..., Any], options: str, task: Collect, weights: bytes) -> Trajectory:
    """Drive an episode and return its trajectory.

    Args:
        env: Class of the environment.
        options: Keyword arguments of the environment as JSON.
        task: Episode to drive.
        weights: Weights of the policy (policy_layers).
    """
    simulation = environment(env, options)
    layout = simulation.layout
    layers = policy_layers(weights)
    rng = np.random.default_rng([TRAINING, task.seed, *b"actor-0", task.episode])
    # A generator of its own: the world does not depend on how many numbers the actor draws.
    world_rng = np.random.default_rng([WORLDS, task.seed, 0, task.episode])
    world = int(world_rng.integers(len(simulation.worlds)))

    observation, info = simulation.reset(seed=int(rng.integers(2**31)), options={"world": world})
    observations = [observation]
    actions = []
    rewards = []
    terms: Counter[str] = Counter()  # sums of the reward's terms
    terminated = False
    truncated = False
    while not (terminated or truncated):
        if task.random:
            action = rng.uniform(-1.0, 1.0, layout.action).astype(np.float32)
        else:
            noise = rng.standard_normal(layout.action, dtype=np.float32) * np.float32(task.sigma)
            # The policy sees a part of the observation, the critics see all (--critics-know-more).
            policy_action = np.tanh(forward(layers, observation[: layout.seen]))
            action = np.clip(policy_action + noise, -1.0, 1.0)
        observation, reward, terminated, truncated, info = simulation.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        terms.update(info.get("reward", {}))

    summary: Dict[str, Any] = {name: info[name] for name in INFO if name in info}
    summary.update({"return": sum(rewards), "length": len(rewards), "terms": dict(terms)})
    return Trajectory.of(layout, observations, actions, rewards, terminated, summary)
