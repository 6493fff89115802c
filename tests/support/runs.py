"""Runs for tests: trainings in the environment of training.py, and a runner of trials that draws
its results.
"""

import json
import os
import re
import time
import zlib
from functools import partial

import numpy as np
import safetensors.numpy

from applr_ros1.common.errors import run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.policy.actor import forward
from tests.support import lines_with
from tests.support.training import Line
from training.evaluate.evaluation import EvaluationOptions, settings
from training.evaluate.trial import POLICY, Result
from training.train.learner.config import parse
from training.train.learner.prepare import Preparation
from training.train.learner.run import TrainingRun
from training.workers.collect import collect, environment, policy_layers

# A small network that learns in seconds, and an evaluation every 200 steps
TOY = [
    *("--net-arch", "32", "32", "--batch-size", "32", "--utd-ratio", "0.5"),
    *("--eval-freq", "200", "--decision-period=0.5"),
]
NO_EVALUATION = ["--eval-worlds", "none"]


def network(weights):
    """Return the policy in safetensors bytes as a function of the observation."""
    return lambda observation: np.tanh(forward(policy_layers(weights), observation))


def drive_line(env, task, weights):
    """Drive one episode. Only the learned policy moves; all other methods stand still."""

    def stands_still(observation):
        return np.zeros(1, np.float32)

    policy = network(weights) if task.method_spec == POLICY else stands_still
    line = environment(env, "{}")
    total_reward = 0.0
    is_over = False
    observation, _ = line.reset(seed=task.seed)
    while not is_over:
        observation, reward, terminated, truncated, _ = line.step(policy(observation))
        total_reward += float(reward)
        is_over = terminated or truncated
    result = Result(
        success=True,
        # The better the policy, the shorter the time.
        time_s=-total_reward,
        decisions=10,
        route_m=1.0,
        total_reward=total_reward,
    )
    return result, b""


def toy_run(config, env=Line):
    """Return a training run in a toy environment."""

    class ToyRun(TrainingRun):
        @staticmethod
        def prepare(config):
            held_out = [] if config.eval_worlds == "none" else [("environment", "")]
            layout = environment(env, "{}").layout
            drive = partial(drive_line, env)
            return Preparation(partial(collect, env, "{}"), drive, held_out, layout)

        def write_policy(self, path, weights, metadata):
            # The toy's network has another shape than those of robots, which save() checks.
            texts = {name: json.dumps(value) for name, value in metadata.items()}
            write_bytes(path, safetensors.numpy.save(weights, texts))

    # No policy of the toy is one of a robot, whose values and range a run takes over.
    vars(config).update(own_policy=None, policy_taken_over=None)
    return ToyRun(config)


def main(arguments=None, env=Line):
    """Run ./applr train in a toy environment."""
    return run_main(lambda: toy_run(parse(arguments), env).run(), "./applr train")


def toy(out, *more):
    """Return the arguments of a run in the toy environment."""
    return [*TOY, "--out", str(out), *map(str, more)]


def one_line(capsys, arguments, pattern, main=main):
    """Assert that the command ends with one line on stderr that matches the pattern."""
    capsys.readouterr()
    assert main(list(map(str, arguments))) > 0
    error_lines = lines_with(capsys.readouterr().err, "./applr train: ")
    assert len(error_lines) == 1, error_lines
    assert re.search(pattern, error_lines[0]), error_lines[0]


# Trials of evaluate.py

# Settings of an evaluation without worlds and methods.
SETTINGS = settings(EvaluationOptions(), [], [])


def draw_result(settings, task):
    """Return a drawn result, with the interface of training.evaluate.runner.run."""
    if os.environ.get("TOY_BROKEN"):
        raise ValueError("the toy is broken; mend it")
    # The result depends on the trial alone, in whatever order or process it is driven.
    rng = np.random.default_rng([task.seed, zlib.crc32(task.method.encode())])
    time.sleep(float(os.environ.get("TOY_SECONDS", "0.01")) * rng.uniform(0.2, 1.8))
    if task.method.startswith("bad"):
        raise ValueError("the toy will not; take another")
    success = rng.random() < 0.9
    seconds = rng.normal(27.0 if task.method == "dwa" else 20.0, 5.0) if success else 100.0
    result = Result(
        success=bool(success),
        collided=bool(rng.random() < 0.1),
        timeout=not success,
        time_s=float(seconds),
        decisions=int(seconds // 2) + 1,
        path_length_m=float(rng.uniform(6, 8)),
        reason="finished" if success else "time limit",
        route_m=7.0,
        min_clearance_m=float(rng.uniform(0.1, 0.5)),
        mean_jerk=8.0,
        mean_turn=1.5,
        switching=0.1,
    )
    return result, b""
