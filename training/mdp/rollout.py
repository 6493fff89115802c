"""One episode in any Gymnasium environment. Actors collect experience with it."""

from __future__ import annotations

import importlib
from typing import Any, Callable, Dict, List, NamedTuple, Optional

import gymnasium
import numpy as np


class Rollout(NamedTuple):
    """An episode of T steps; terminated says that its last observation is a terminal state."""

    observations: List[np.ndarray]  # T + 1 of (n,)
    actions: List[np.ndarray]  # T of (m,)
    rewards: List[float]  # T
    terminated: bool
    info: Dict[str, Any]  # of the last step


def make_environment(name: str, options: Dict[str, Any]) -> gymnasium.Env:
    """The environment "module:Class", made with options.

    Raises:
        ImportError, AttributeError: where there is no such class.
        TypeError: where it is no environment.
    """
    module, _, attribute = name.partition(":")
    made = getattr(importlib.import_module(module), attribute)(**options)
    if not isinstance(made, gymnasium.Env):
        raise TypeError("it is no gymnasium.Env")
    return made


def roll_out(
    env: gymnasium.Env, act: Callable[[np.ndarray], np.ndarray], seed: int, options: Optional[Dict[str, Any]] = None
) -> Rollout:
    """Drives one episode with act: observation → action. seed and options go to the environment's reset."""
    observation, info = env.reset(seed=seed, options=options)
    observations, actions, rewards = [observation], [], []
    while True:
        action = act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        if terminated or truncated:
            return Rollout(observations, actions, rewards, bool(terminated), info)
