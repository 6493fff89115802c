"""The choice between several policies and their mean."""

import csv
import json

import numpy as np
import pytest

pytest.importorskip("torch")

from applr_ros1.policy.actor import Actor, save
from applr_ros1.robots import JACKAL
from training import choose_policy
from training.policy_file import weights_of
from training.td3.averaging import mirrored, side_by_side

PARAMETERS = 8
METADATA = {"period_s": 1.0, "weights": "per_cell", "default": None}


def policy(path, action, **changes):
    """A policy file that answers every observation with one action."""
    before = np.arctanh(np.full(PARAMETERS, action))
    weights = {
        "0.weight": np.zeros((4, 729)),
        "0.bias": np.ones(4),
        "1.weight": np.zeros((PARAMETERS, 4)),
        "1.bias": before,
    }
    training = {"transitions": 10, "updates": 5, "steps": 10, "options": {"seed": int(action * 10)}}
    save(path, weights, {**METADATA, "training": training, **changes})
    return str(path)


def test_the_best_is_written_with_its_result(tmp_path, capsys):
    slow, fast = policy(tmp_path / "slow.safetensors", -0.9), policy(tmp_path / "fast.safetensors", 0.1)
    command = [slow, fast, "--out", str(tmp_path / "best.safetensors"), "--results", str(tmp_path / "choice")]
    command += ["--worlds", "generated:14,generated:34", "--simulator", "kinematic", "--trials", "1", "--workers", "0"]
    assert choose_policy.main(command) == 0, capsys.readouterr().err
    printed = capsys.readouterr().out
    assert printed.count("| 2 |") == 3
    assert "| mean of them | 2 |" in printed
    best = Actor.load(tmp_path / "best.safetensors")
    assert (best.period, best.weights) == (1.0, "per_cell")
    assert best.metadata["result"]["trials"] == 2
    assert best.metadata["result"]["success"] == 1.0
    scores = {}
    for row in csv.DictReader((tmp_path / "choice" / "trials.csv").open()):
        assert row["success"] == "True"
        scores[row["method"]] = scores.get(row["method"], 0.0) + float(row["time_s"])
    assert len(set(scores.values())) == 3
    answers = {"policy1": -0.9, "policy2": 0.1, "mean": np.tanh((np.arctanh(-0.9) + np.arctanh(0.1)) / 2)}
    np.testing.assert_allclose(best.action(np.zeros(729)), answers[min(scores, key=scores.get)], atol=1e-6)
    assert best.metadata["result"]["time_s"] == pytest.approx(min(scores.values()) / 2)
    average = Actor.load(tmp_path / "choice" / "mean.safetensors")
    np.testing.assert_allclose(average.action(np.zeros(729)), answers["mean"], atol=1e-6)
    assert average.metadata["training"]["transitions"] == 20
    assert [run["seed"] for run in average.metadata["training"]["mean_of"]] == [-9, 1]
    before = (tmp_path / "choice" / "trials.csv").read_bytes()
    assert choose_policy.main(command) == 0  # nothing is left to do
    capsys.readouterr()
    assert choose_policy.main([*command, "--worlds", "generated:14"]) == 1
    error = capsys.readouterr().err
    assert "was begun with another worlds" in error
    assert "give another --results" in error
    assert "--out" not in error
    assert (tmp_path / "choice" / "trials.csv").read_bytes() == before


def test_one_policy_alone_gets_its_result(tmp_path, capsys):
    alone = policy(tmp_path / "alone.safetensors", 0.1)
    command = [alone, "--out", str(tmp_path / "best.safetensors"), "--results", str(tmp_path / "choice")]
    command += ["--worlds", "generated:14", "--simulator", "kinematic", "--trials", "1", "--workers", "0"]
    assert choose_policy.main(command) == 0, capsys.readouterr().err
    assert json.dumps(Actor.load(tmp_path / "best.safetensors").metadata["result"])
    assert not (tmp_path / "choice" / "mean.safetensors").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"period_s": 2.0}, "decision period is 2.0, not 1.0"),
        ({"weights": "per_metre"}, "is per_metre, not per_cell"),
        (None, "its number of layers is 3, not 2"),
    ],
)
def test_policies_that_are_not_alike_are_refused(changes, words, tmp_path, capsys):
    paths = [policy(tmp_path / "a.safetensors", 0.1), policy(tmp_path / "b.safetensors", 0.2, **(changes or {}))]
    if changes is None:
        weights = weights_of(Actor.load(paths[1]))
        weights.update({"2.weight": np.eye(PARAMETERS), "2.bias": np.zeros(PARAMETERS)})
        save(paths[1], weights, METADATA)
    assert choose_policy.main([*paths, "--out", str(tmp_path / "o"), "--results", str(tmp_path / "choice")]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_the_mean_of_policies_of_other_widths_and_numbers(tmp_path):
    """One network of 4 hidden units and, in one file, two of 6: the mean of all three before tanh."""
    random, networks, actors = np.random.default_rng(0), [], []
    for width in (4, 6):
        networks.append(
            {
                "0.weight": random.normal(size=(width, 729)) / 27.0,
                "0.bias": random.normal(size=width),
                "1.weight": random.normal(size=(PARAMETERS, width)),
                "1.bias": random.normal(size=PARAMETERS),
            }
        )
    networks.append(mirrored(networks[1], 720))
    for network in networks:
        path = tmp_path / ("%d.safetensors" % len(actors))
        save(path, network, {**METADATA, "training": {}})
        actors.append(Actor.load(path))
    save(tmp_path / "pair.safetensors", side_by_side(networks[1:]), {**METADATA, "training": {}})
    both = [str(tmp_path / "0.safetensors"), str(tmp_path / "pair.safetensors")]
    choose_policy.write_mean(str(tmp_path / "mean.safetensors"), both, JACKAL)
    mean = Actor.load(tmp_path / "mean.safetensors")
    assert [weight.shape for weight, _ in mean.layers] == [(3, 6, 729), (3, PARAMETERS, 6)]
    for observation in random.uniform(-1.0, 1.0, (5, 729)):
        before = np.mean([np.arctanh(actor.action(observation)) for actor in actors], axis=0)
        np.testing.assert_allclose(mean.action(observation), np.tanh(before), atol=1e-5)
