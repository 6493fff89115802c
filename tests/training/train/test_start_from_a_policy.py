"""Test of a run that starts from the file of a dimensionless policy."""

import numpy as np

from applr_ros1.policy.actor import load
from tests.support.runs import one_line
from training.train.__main__ import main
from training.train.learner.learner import policy_network

ENCODING = ["--observation", "dimensionless", "--net-arch", "16", "16", "--decision-period", "1"]
SHORT = ["--total-timesteps", "12", "--batch-size", "8", "--utd-ratio", "1"]
WORLDS = ["--worlds", "generated:7,dynamic:100"]


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
    network_before = policy_network(policy)
    network_after = policy_network(str(other_run / "actor.safetensors"))
    for layer_name, weights in network_before.items():
        assert np.array_equal(weights, network_after[layer_name]), layer_name

    # Networks of another size, and of another encoding
    smaller = ["--init-from", policy, "--net-arch", "8", "--decision-period", "1"]
    other_size = ["--observation", "dimensionless", *smaller, "--out", tmp_path / "c"]
    one_line(capsys, other_size, "the same --net-arch", main)
    other_encoding = [*smaller, "--out", tmp_path / "d"]
    one_line(capsys, other_encoding, "the same --net-arch and --observation", main)
