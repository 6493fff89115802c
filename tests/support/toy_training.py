"""Training runs of the toy environment (toy_env.py), and checks of their files and one-line errors."""

import json
import re
from functools import partial

import numpy as np
import safetensors.numpy
import torch

from applr_ros1.common.errors import run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.policy.actor import forward
from tests.support.toy_env import Line
from training.evaluate.trial import POLICY, Result
from training.train.learner.config import parse
from training.train.learner.learner import Learner
from training.train.learner.prepare import Preparation
from training.train.learner.run import TrainingRun
from training.workers.collect import collect, environment, policy_layers

TOY = [
    *("--net-arch", "32", "32", "--batch-size", "32", "--utd-ratio", "0.5"),
    *("--eval-freq", "200", "--decision-period=0.5"),
]
NO_EVALUATION = ["--eval-worlds", "none"]


def network(weights):
    """Return the policy in safetensors bytes as a function of the observation."""
    return lambda observation: np.tanh(forward(policy_layers(weights), observation))


def drive(env, task, weights):
    """Drive one episode. Only the learned policy moves; all other methods stand still."""
    policy = (
        network(weights)
        if task.method_spec == POLICY
        else lambda observation: np.zeros(1, np.float32)
    )
    made, total, ended = environment(env, "{}"), 0.0, False
    observation, _ = made.reset(seed=task.seed)
    while not ended:
        observation, reward, terminated, truncated, _ = made.step(policy(observation))
        total, ended = total + float(reward), terminated or truncated
    return Result(True, time_s=-total, decisions=10, route_m=1.0, total_reward=total), b""


def toy_run(config, env=Line):
    """Return a training run in a toy environment."""

    class ToyRun(TrainingRun):
        @staticmethod
        def prepare(config):
            held_out = [("environment", "")] * (config.eval_worlds != "none")
            layout = environment(env, "{}").layout
            return Preparation(partial(collect, env, "{}"), partial(drive, env), held_out, layout)

        def write_policy(self, path, weights, metadata):
            write_bytes(
                path,
                safetensors.numpy.save(weights, {k: json.dumps(v) for k, v in metadata.items()}),
            )

    return ToyRun(config)


def main(arguments=None, env=Line):
    """Run train.py in a toy environment."""
    return run_main(lambda: toy_run(parse(arguments), env).run(), "train.py")


def toy(out, *more):
    """Return the arguments of a run in the toy environment."""
    return [*TOY, "--out", str(out), *map(str, more)]


def networks_of(folder):
    """Return the networks of a run's checkpoint as bytes."""
    state = torch.load(folder / Learner.saved(folder)["learner"], weights_only=True)
    return {name: tensor.numpy().tobytes() for name, tensor in state["networks"].items()}


def one_line(capsys, arguments, pattern, main=main):
    """Assert that train.py ends with one line on stderr that matches the pattern."""
    capsys.readouterr()
    assert main([str(a) for a in arguments]) > 0
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("train.py: ")]
    assert len(lines) == 1, lines
    assert re.search(pattern, lines[0]), lines[0]
