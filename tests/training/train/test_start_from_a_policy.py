"""Test of a run that starts from the file of a dimensionless policy."""

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.policy.actor import load, save
from applr_ros1.policy.encoding import PaperEncoding
from tests.support.runs import one_line
from training.train.__main__ import main
from training.train.learner.learner import policy_network

ENCODING = ["--observation", "dimensionless", "--net-arch", "16", "16", "--decision-period", "1"]
SHORT = ["--total-timesteps", "12", "--batch-size", "8", "--utd-ratio", "1"]
WORLDS = ["--worlds", "generated:7,dynamic:100"]


@pytest.mark.slow
def test_a_policy_is_frozen_during_the_warm_up_of_new_critics(tmp_path, capsys):
    run = tmp_path / "jackal"
    other_run = tmp_path / "husky"
    learning = [
        *ENCODING,
        *SHORT,
        *WORLDS,
        "--symmetric",
        "--mirror",
        "--learning-starts",
        "4",
    ]
    assert main([*learning, "--eval-worlds", "none", "--out", str(run)]) == 0
    policy = str(run / "actor.safetensors")
    assert load(policy).period == 1.0

    # A run of 12 steps is shorter than the warm-up: only the critics change.
    warm_up = [*learning, "--robot", "husky", "--init-from", policy]
    evaluation = ["--eval-worlds", "generated:1", "--eval-freq", "12"]
    assert main([*warm_up, *evaluation, "--out", str(other_run)]) == 0
    network_before = policy_network(policy, robots.load("jackal"))
    husky_policy = str(other_run / "actor.safetensors")
    network_after = policy_network(husky_policy, robots.load("husky"))
    for layer_name, weights in network_before.items():
        assert np.array_equal(weights, network_after[layer_name]), layer_name

    # Networks of another size, and of another encoding
    smaller = ["--init-from", policy, "--net-arch", "8", "--decision-period", "1"]
    other_size = ["--observation", "dimensionless", *smaller, "--out", tmp_path / "c"]
    one_line(capsys, other_size, "the same --net-arch", main)
    other_encoding = [*smaller, "--out", tmp_path / "d"]
    one_line(capsys, other_encoding, "the same --net-arch, --observation, ", main)


def test_a_policy_of_another_robot_in_the_papers_encoding_is_refused(tmp_path, capsys):
    encoding = PaperEncoding(robots.load("jackal"))
    weights = {
        "0.weight": np.zeros((8, encoding.size), np.float32),
        "0.bias": np.zeros(8, np.float32),
        "1.weight": np.zeros((encoding.actions, 8), np.float32),
        "1.bias": np.zeros(encoding.actions, np.float32),
    }
    policy = tmp_path / "jackal.safetensors"
    save(policy, weights, encoding=encoding)
    assert policy_network(str(policy), robots.load("jackal"))
    options = ["--robot", "turtlebot3_burger", "--init-from", str(policy), "--net-arch", "8"]
    refusal = "made for the robot jackal: this robot is turtlebot3_burger"
    one_line(capsys, [*options, *WORLDS, "--out", tmp_path / "run"], refusal, main)
