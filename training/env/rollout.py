"""One episode in any Gymnasium environment, and the policy that drives it. Actors collect experience with them."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, NamedTuple, Optional

import gymnasium
import numpy as np

from applr_ros1.common.tensors import unpack
from applr_ros1.policy.network import forward, layers_of

NAVIGATION = "training.env.env:ApplrEnv"  # the navigation task


class PolicyWeights:
    """The learnt policy in numpy, of any size, without noise: observation → action.

    Args:
        weights: safetensors of "0.weight" (out, in), "0.bias" (out,), "1.weight", ... in float32, or of several such
            networks side by side (applr_ros1/policy/network.py).
    """

    def __init__(self, weights: bytes):
        arrays, _ = unpack(weights, "weights")
        count = len(arrays) // 2
        ends = arrays["0.weight"].shape[-1], arrays[f"{count - 1}.weight"].shape[-2]
        self.layers = layers_of(arrays, *ends, "weights")

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Observation (n,) → action (m,) float32 in [-1, 1]."""
        return np.tanh(forward(self.layers, observation))


class Rollout(NamedTuple):
    """An episode of T steps.

    terminated says that its last observation is a terminal state; terms are the sums of what info["reward"] named at
    each step, where the environment names the terms of its reward there.
    """

    observations: List[np.ndarray]  # T + 1 of (n,)
    actions: List[np.ndarray]  # T of (m,)
    rewards: List[float]  # T
    terminated: bool
    info: Dict[str, Any]  # of the last step
    terms: Dict[str, float]


def roll_out(
    env: gymnasium.Env, act: Callable[[np.ndarray], np.ndarray], seed: int, options: Optional[Dict[str, Any]] = None
) -> Rollout:
    """Drives one episode with act: observation → action. seed and options go to the environment's reset."""
    observation, info = env.reset(seed=seed, options=options)
    observations, actions, rewards = [observation], [], []
    terms: Dict[str, float] = {}
    while True:
        action = act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        named = info.get("reward")
        for name, value in named.items() if isinstance(named, dict) else ():
            terms[name] = terms.get(name, 0.0) + float(value)
        if terminated or truncated:
            return Rollout(observations, actions, rewards, bool(terminated), info, terms)
