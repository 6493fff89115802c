"""What follows a training: a partner, the mean of the two policies, and the refinement; one command does it all."""

import os

import numpy as np
import pytest

pytest.importorskip("torch")

from applr_ros1.common.files import sha256
from applr_ros1.policy.actor import Actor
from training import refine_policy, train
from training.afterwards import partner_of, refine, what_follows
from training.gorila.config import ConfigError, parse

OPTIONS = ["--steps", "12", "--hidden", "8", "--worlds", "generated:0", "--eval-worlds", "none", "--period", "1"]
OPTIONS += ["--weights", "per_metre", "--no-tensorboard"]
PARTNER = """
steps: 12
hidden: "6"
worlds: generated:1
eval_worlds: none
period: 1.0
weights: per_metre
refine: 3
"""


@pytest.fixture
def short(monkeypatch):
    """Refinements drive a few pairs."""

    def run(arguments):
        return command([*arguments, "--pairs", "2", "--components", "0", "--worlds", "fresh:7-12", "--workers", "0"])

    command = refine_policy.run
    monkeypatch.setattr(refine_policy, "WATCHED", 2)
    monkeypatch.setattr(refine_policy, "run", run)


@pytest.fixture
def partner(tmp_path):
    """partner(text): the path of a recipe with this text."""

    def write(text=PARTNER):
        path = tmp_path / "other.yaml"
        path.write_text(text)
        return str(path)

    return write


def test_a_training_run_refines_its_last_policy(tmp_path, monkeypatch, capsys, short):
    out = tmp_path / "run"
    assert train.main([*OPTIONS, "--refine", "1", "--out", str(out)]) == 0, capsys.readouterr().err
    said = capsys.readouterr().out
    assert "refining: python -m training.refine_policy %s/actor.safetensors" % out in said
    assert said.index("after this training: a refinement of 1 step") < said.index("refining:")
    refined = Actor.load(out / "refined.safetensors")
    told = refined.metadata["training"]["refined"]
    assert (told["step"], told["weights"], told["simulator"]) == (1, "per_metre", "kinematic")
    assert (refined.period, refined.metadata["training"]["options"]["period"]) == (1.0, 1.0)
    assert told["start"] == sha256((out / "actor.safetensors").read_bytes())

    assert train.main(["--resume", "--out", str(out), "--refine", "2"]) == 0
    assert Actor.load(out / "refined.safetensors").metadata["training"]["refined"]["step"] == 2
    assert (out / "refinement" / "trials.jsonl").read_bytes().count(b"\n") == 8

    def interrupted(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(refine_policy, "run", interrupted)
    assert train.main(["--resume", "--out", str(out)]) == 130
    assert "--resume continues the refinement" in capsys.readouterr().err


def test_a_partner_is_trained_and_the_mean_refined(tmp_path, capsys, short, partner):
    out = tmp_path / "run"
    options = [*OPTIONS, "--symmetric", "--seed", "4", "--partner", partner(), "--refine", "1", "--out", str(out)]
    assert train.main(options) == 0, capsys.readouterr().err
    files = [out / "actor.safetensors", out / "partner" / "actor.safetensors", out / "mean.safetensors"]
    first, second, mean = (Actor.load(path) for path in files)
    assert [part["seed"] for part in mean.metadata["training"]["mean_of"]] == [4, 5]
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 729)).astype(np.float32)
    both = np.arctanh([policy.action(seen).astype(np.float64) for policy in (first, second)])
    np.testing.assert_allclose(mean.action(seen), np.tanh(both.mean(axis=0)), atol=1e-5)
    refined = Actor.load(out / "refined.safetensors").metadata["training"]
    assert refined["refined"]["start"] == sha256(files[2].read_bytes())
    assert refined["mean_of"] == mean.metadata["training"]["mean_of"]

    driven = (out / "refinement" / "trials.jsonl").read_bytes()
    assert train.main(["--resume", "--out", str(out)]) == 0  # nothing is left to do
    assert (out / "refinement" / "trials.jsonl").read_bytes() == driven


def test_a_partner_that_does_not_fit_is_refused_before_the_training(tmp_path, capsys, partner):
    for text, words in (
        (PARTNER.replace("period: 1.0", "period: 2.0"), "decision period is 2.0, that of this run 1.0"),
        (PARTNER.replace('"6"', '"6,6"'), "2 hidden layers, those of this run 1"),
        (PARTNER.replace("per_metre", "per_cell"), "kind of distance weights is per_cell"),
        ("batchsize: 4", "batchsize"),
        (PARTNER + "env: tests.toy_env:Line", "environment is tests.toy_env:Line"),
        (PARTNER + "scan_pool: 7", "scan_pool is 7"),
        (PARTNER.replace("generated:1", "nowhere.world"), "nowhere.world"),
    ):
        assert train.main([*OPTIONS, "--partner", partner(text), "--out", str(tmp_path / "run")]) in (1, 2)
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_the_recipe_of_the_included_policy_and_its_partner_fit(tmp_path):
    config = parse(["--recipe", "applr", "--out", str(tmp_path / "run")])
    found = partner_of(config)
    assert (found.period, found.symmetric, found.seed, found.refine) == (config.period, True, config.seed + 1, 0)
    assert "with the recipe applr_first_form (44 min), then a refinement of 8 steps" in what_follows(config, found)
    assert what_follows(parse(["--out", str(tmp_path / "run")]), None) == ""


@pytest.mark.parametrize(("address", "workers"), [([], "500"), (["--ray-address", "auto"], "2")])
def test_a_clusters_actors_do_not_count_where_the_refinement_drives(tmp_path, monkeypatch, address, workers):
    asked = []
    monkeypatch.setattr(refine_policy, "run", asked.extend)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    options = ["--actors", "500", "--refine", "8", "--pool", "ray", "--out", str(tmp_path), *address]
    refine(parse(options), "actor.safetensors")
    assert asked[asked.index("--workers") + 1] == workers


def test_a_resumed_partner_takes_over_what_concerns_the_machine_and_keeps_its_recipe(tmp_path, partner, capsys):
    out = tmp_path / "run"
    options = [*OPTIONS, "--partner", partner(), "--out", str(out)]
    assert train.main(options) == 0, capsys.readouterr().err
    resumed = ["--resume", "--out", str(out), "--actors", "2", "--threads", "1"]
    found = partner_of(parse(resumed))
    assert (found.actors, found.threads, found.hidden, found.seed) == (2, 1, "6", 1)
    with pytest.raises(ConfigError, match="was begun with the recipe .*other.yaml, which cannot be changed"):
        partner_of(parse([*resumed, "--partner", "paper"]))
