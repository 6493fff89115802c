"""A run that begins with the file of a policy in the dimensionless encoding."""

import numpy as np

from applr_ros1.policy.actor import load
from tests.support.toy_training import one_line
from training.learner.learner import begun_policy
from training.train import main

FORM = ["--observation", "dimensionless", "--net-arch", "16", "16", "--decision-period", "1"]
SHORT = ["--total-timesteps", "12", "--batch-size", "8", "--utd-ratio", "1", "--worlds", "generated:7,dynamic:100"]


def test_a_policy_stands_still_while_new_critics_learn(tmp_path, capsys):
    run, own = tmp_path / "jackal", tmp_path / "own"
    learning = [*FORM, *SHORT, "--symmetric", "--mirror", "--learning-starts", "4"]
    assert main([*learning, "--eval-worlds", "none", "--out", str(run)]) == 0
    policy = str(run / "actor.safetensors")
    assert load(policy).period == 1.0
    alone = [*learning, "--robot", "husky", "--init-from", policy]
    assert main([*alone, "--eval-worlds", "generated:1", "--eval-freq", "12", "--out", str(own)]) == 0
    before, after = begun_policy(policy), begun_policy(str(own / "actor.safetensors"))
    assert all(np.array_equal(before[name], after[name]) for name in before)  # the critics have learnt alone
    other = [*FORM, "--init-from", policy, "--net-arch", "8", "--out", tmp_path / "c"]
    one_line(capsys, other, "the same --net-arch", main)
    one_line(capsys, ["--init-from", policy, "--out", tmp_path / "d"], "needs --observation dimensionless", main)
