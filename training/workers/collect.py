"""Work of an actor in an environment: a training episode with exploration noise. train.py submits them.

Trials of the policy that is being learnt drive with PolicyWeights, too (training/evaluation/runner.py).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pkgutil import resolve_name
from typing import Any, Dict, Optional

import gymnasium
import numpy as np

from applr_ros1.common.tensors import unpack
from applr_ros1.policy.actor import forward, layers_of
from training.replay.trajectory import Trajectory, TransitionLayout

NAVIGATION = "training.env.env:ApplrEnv"  # the navigation task
TRAINING, WORLDS = 0, 2  # first numbers of the seeds of training episodes, and of the worlds drawn for them
INFO = ("world", "success", "collided", "timeout", "aborted", "flipped", "time_s")  # what a trajectory keeps


@dataclass(frozen=True)
class Collect:
    """A training episode to be driven. All of its randomness comes from the run's seed and the episode's number.

    sigma is the standard deviation of the noise, random asks for uniform actions instead of the policy's; world is an
    index, None leaves the choice to the environment. version is the policy's, in gradient steps.
    """

    episode: int
    seed: int
    sigma: float
    random: bool
    world: Optional[int] = None
    version: int = -1


def draw_world(seed: int, episode: int, worlds: Optional[int]) -> Optional[int]:
    """The index of an episode's world among so many; None where the environment chooses."""
    return int(np.random.default_rng([WORLDS, seed, 0, episode]).integers(worlds)) if worlds else None


@lru_cache(maxsize=1)
def environment(env: str, options: str) -> gymnasium.Env:
    """The environment "module:Class", made once in a process; options: its keyword arguments as JSON."""
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
    layout, policy = layout_of(made), PolicyWeights(weights)
    rng = np.random.default_rng([TRAINING, task.seed, *b"actor-0", task.episode])

    def act(observation: np.ndarray) -> np.ndarray:
        if task.random:
            return rng.uniform(-1.0, 1.0, layout.action).astype(np.float32)
        noise = rng.standard_normal(layout.action, dtype=np.float32) * np.float32(task.sigma)
        return np.clip(policy(observation[: layout.seen]) + noise, -1.0, 1.0)

    begin = None if task.world is None else {"world": task.world}
    observation, last = made.reset(seed=int(rng.integers(2**31)), options=begin)
    observations, actions, rewards = [observation], [], []
    terms: Dict[str, float] = {}  # of the reward, summed, where the environment names them
    ended = terminated = False
    while not ended:
        actions.append(act(observation))
        observation, reward, terminated, truncated, last = made.step(actions[-1])
        observations.append(observation)
        rewards.append(float(reward))
        named = last.get("reward")
        for name, value in named.items() if isinstance(named, dict) else ():
            terms[name] = terms.get(name, 0.0) + float(value)
        ended = terminated or truncated
    info: Dict[str, Any] = {"return": float(sum(rewards)), "length": len(rewards)}
    for name in INFO:
        if name in last:
            value = last[name]
            info[name] = value.item() if isinstance(value, np.generic) else value
    if terms:
        info["terms"] = terms
    info.update(version=task.version, sigma=task.sigma)
    return Trajectory.of(layout, observations, actions, rewards, terminated, info)


def layout_of(env: gymnasium.Env) -> TransitionLayout:
    """Return the layout of an environment's observations: its `scan_beams` first numbers as a scan, if it has that.

    `scans` and `odd` say what exchanging left and right does to them, `hidden` how many of the last ones are for the
    critics alone, as TransitionLayout describes it.

    Raises:
        ValueError: for observations or actions that are no vectors.
    """
    env = env.unwrapped
    shapes = env.observation_space.shape, env.action_space.shape
    if any(shape is None or len(shape) != 1 for shape in shapes):
        raise ValueError(f"observations and actions must be vectors, these have the shapes {shapes[0]} and {shapes[1]}")
    (observation,), (action,) = shapes  # type: ignore[misc]
    beams = getattr(env, "scan_beams", 0)
    more = getattr(env, "scans", 1), getattr(env, "odd", (0,)), getattr(env, "hidden", 0)
    return TransitionLayout(beams, observation - beams, action, *more)


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
