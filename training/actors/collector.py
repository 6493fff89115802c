"""What an actor does in an environment: training episodes with exploration noise.

Workers make this runner (training/actors/worker.py); learner/prepare.py names it.
"""

from __future__ import annotations

from typing import Any, Dict, Optional

import gymnasium
import numpy as np

from training.actors.tasks import Answer, Collect
from training.actors.worker import PolicyWeights
from training.env.rollout import make_environment, roll_out
from training.replay.trajectory import Trajectory, TransitionLayout

TRAINING = 0  # first number of the seeds of training episodes


class Collector:
    """Runner of Collect tasks: an episode each, as a packed trajectory.

    Args:
        env: "module:Class" of the environment.
        options: its keyword arguments.
    """

    def __init__(self, env: str, options: Dict[str, Any]):
        self.env = make_environment(env, options)
        self.layout = layout_of(self.env)

    def run(self, task: Collect, policy: Optional[PolicyWeights]) -> Answer:
        """Drives the episode; all of its randomness comes from the task's seed, actor and episode."""
        rng = np.random.default_rng([TRAINING, task.seed, *task.actor.encode(), task.episode])
        size = self.layout.action

        def act(observation: np.ndarray) -> np.ndarray:
            if policy is None or task.random:
                return rng.uniform(-1.0, 1.0, size).astype(np.float32)
            noise = rng.standard_normal(size, dtype=np.float32) * np.float32(task.sigma)
            return np.clip(policy(observation[: self.layout.seen]) + noise, -1.0, 1.0)

        options = None if task.world is None else {"world": task.world}
        episode = roll_out(self.env, act, int(rng.integers(2**31)), options)
        info: Dict[str, Any] = {"return": float(sum(episode.rewards)), "length": len(episode.rewards)}
        for name in ("world", "success", "collided", "timeout", "aborted", "flipped", "time_s"):
            if name in episode.info:
                value = episode.info[name]
                info[name] = value.item() if isinstance(value, np.generic) else value
        if episode.terms:
            info["terms"] = episode.terms
        info.update(actor=task.actor, episode=task.episode, version=task.version, sigma=task.sigma)
        trajectory = Trajectory.of(
            self.layout, episode.observations, episode.actions, episode.rewards, episode.terminated, info
        )
        return Answer(task, data=trajectory.pack())


def layout_of(env: gymnasium.Env) -> TransitionLayout:
    """How an environment's observations are stored: its `scan_beams` first numbers as a scan, if it has that.

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
    return TransitionLayout(
        beams,
        observation - beams,
        action,
        getattr(env, "scans", 1),
        getattr(env, "odd", (0,)),
        getattr(env, "hidden", 0),
    )
