"""What one actor does: drive an episode when told, with the newest policy, and hand it back as bytes.

actor_pool.py runs it in this process, in processes of its own (python -m training.gorila.worker FD), or as Ray actors. It
needs no torch. Messages are bytes: a task is JSON and perhaps weights (safetensors), an answer is "T" and a packed
trajectory, "R" and an evaluation's JSON result, or "E" and a JSON error. Nothing is unpickled.
"""  # noqa: E501

from __future__ import annotations

import importlib
import json
import os
import signal
import struct
import sys
from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.common.tensors import unpack
from applr_ros1.policy.network import forward, layers_of
from training.experience.trajectory import Layout, Trajectory, TrajectoryError

TRAJECTORY, RESULT, ERROR = b"T", b"R", b"E"
TRAINING, EVALUATION = 0, 1  # first numbers of the seeds


class Worker:
    """settings: {"env": "module:callable", "train": its arguments, "evaluate": its arguments}."""

    def __init__(self, settings: Dict[str, Any]):
        self.settings, self.environments, self.policy = settings, {}, None

    def run(self, task: Dict[str, Any], weights: Optional[bytes] = None) -> bytes:
        """Do a task. Errors come back as an answer, so that one bad episode ends no actor."""
        try:
            if weights:
                self.policy = PolicyWeights(weights)
            return self.evaluate(task) if task["kind"] == "evaluate" else self.train(task)
        except Exception as error:  # whatever went wrong, the learner must hear of it in one line
            text = "%s: %s" % (type(error).__name__, (str(error).splitlines() or [""])[0])
            return ERROR + json.dumps({"error": text, "task": task}).encode()

    def train(self, task) -> bytes:
        """task: actor, episode, seed, world (index or None), sigma, random (uniform actions), version."""
        rng = np.random.default_rng([TRAINING, task["seed"], *task["actor"].encode(), task["episode"]])
        env = self.environment("train")
        layout = layout_of(env)
        policy = None if task.get("random") else self.policy

        def act(observation):
            if policy is None:
                return rng.uniform(-1.0, 1.0, layout.action).astype(np.float32)
            noise = rng.standard_normal(layout.action, dtype=np.float32) * np.float32(task["sigma"])
            return np.clip(policy(observation) + noise, -1.0, 1.0)

        observations, actions, rewards, terminated, info = roll_out(env, act, rng, task.get("world"))
        info = dict(
            summary(rewards, info),
            actor=task["actor"],
            episode=task["episode"],
            version=task["version"],
            sigma=task["sigma"],
        )
        return TRAJECTORY + Trajectory.of(layout, observations, actions, rewards, terminated, info).pack()

    def evaluate(self, task) -> bytes:
        """task: world, trial, seed; and theta0 (drive the planner's default) or action (drive this set), instead of the
        policy. No noise.
        """
        rng = np.random.default_rng([EVALUATION, task["seed"], task["world"], task["trial"]])
        env = self.environment("evaluate")
        if task.get("theta0") or "action" in task:
            space = env.unwrapped.space
            constant = np.asarray(task.get("action", space.to_action(space.theta0)), np.float32)
            act = lambda observation: constant  # noqa: E731
        else:
            act = self.policy
        _, _, rewards, _, info = roll_out(env, act, rng, task["world"])
        return RESULT + json.dumps(dict(summary(rewards, info), task=task)).encode()

    def environment(self, which):
        if which not in self.environments:
            module, _, name = self.settings["env"].partition(":")
            self.environments[which] = getattr(importlib.import_module(module), name)(**self.settings[which])
        return self.environments[which]


class PolicyWeights:
    """The newest policy's weights, of any layout: observation → action."""

    def __init__(self, blob: bytes):
        arrays, _ = unpack(blob, "weights", TrajectoryError)
        count = len(arrays) // 2
        ends = arrays["0.weight"].shape[1], arrays["%d.weight" % (count - 1)].shape[0]
        self.layers = layers_of(arrays, *ends, "weights", TrajectoryError)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return np.tanh(forward(self.layers, observation))


def roll_out(env, act, rng, world=None):
    """One episode: (observations (T+1, n), actions (T, m), rewards (T,), terminated, last info)."""
    options = None if world is None else {"world": world}
    observation, info = env.reset(seed=int(rng.integers(2**31)), options=options)
    observations, actions, rewards = [observation], [], []
    while True:
        action = act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        if terminated or truncated:
            return observations, actions, rewards, terminated, info


def summary(rewards, info) -> Dict[str, Any]:
    """What of an episode is worth a line: JSON values."""
    result = {"return": float(sum(rewards)), "length": len(rewards)}
    for name in ("world", "success", "collided", "timeout", "aborted", "flipped", "time_s"):
        if name in info:
            result[name] = info[name] if isinstance(info[name], str) else type(info[name])(info[name])
    return result


def layout_of(env) -> Layout:
    """How an environment's observations are stored: its `scan_beams` first numbers as a scan, if it has that."""
    env = env.unwrapped
    beams = getattr(env, "scan_beams", 0)
    return Layout(beams, env.observation_space.shape[0] - beams, env.action_space.shape[0])


# -- as a process of its own -------------------------------------------------------------------------------------------
def frame(task: Dict[str, Any], weights: bytes = b"") -> bytes:
    text = json.dumps(task).encode()
    return struct.pack("<I", len(text)) + text + weights


def unframe(message: bytes):
    (length,) = struct.unpack("<I", message[:4])
    return json.loads(message[4 : 4 + length]), message[4 + length :]


def main(descriptor: int) -> None:
    """Serve tasks that arrive on a socket until the other end is gone."""
    from multiprocessing.connection import Connection

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Connection(descriptor) as connection:
        try:
            worker = Worker(json.loads(connection.recv_bytes()))
            while True:
                connection.send_bytes(worker.run(*unframe(connection.recv_bytes())))
        except (EOFError, ConnectionError):
            return  # the learner is gone


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main(int(sys.argv[1]))
