"""Tests of train.py --seeds: shared time, selection of the best policy, comparison on other
courses.
"""

import json
from pathlib import Path

import pytest

from tests.support.runs import NO_EVALUATION, one_line, toy, toy_run
from training.evaluate.trial import Result, Trial
from training.train import __main__ as train
from training.train.learner import several
from training.train.learner.config import parse
from worlds import specs

SECONDS = {"seed_3": 9.0, "seed_4": 7.0, "dwa": 20.0, "static": 10.0, "applr": 7.5}


def fake(options):
    """Return the results of an evaluation, with the times in SECONDS."""
    worlds = specs(options.worlds)
    names = [Path(text).stem for text in options.methods.split(",")]
    assert len(worlds) == 50
    results = {}
    for index, world in enumerate(worlds):
        for name in names:
            # Not all equal, or a test of differences could not be made.
            seconds = SECONDS[name] + 0.1 * (index % 3)
            trial = Trial(world, name, 0, 1, world, name)
            results[trial] = Result(success=True, time_s=seconds)
    return results


@pytest.fixture
def evaluated(monkeypatch):
    """Replace evaluations by fake(), and return the list of their options."""
    requested = []

    def evaluate(options):
        requested.append(options)
        return fake(options)

    monkeypatch.setattr(several, "evaluate", evaluate)
    return requested


def test_the_best_of_several_seeds_is_kept_and_compared_on_other_courses(
    tmp_path, evaluated, capsys
):
    out = tmp_path / "runs"
    options = ["--total-timesteps", 40, "--seeds", 2, "--seed", 3, "--minutes", 30]
    arguments = toy(out, *options, *NO_EVALUATION)
    assert several.train(parse(arguments), toy_run) == 0

    # The runs share the time, and the faster one's policy is kept.
    for seed in (3, 4):
        config = json.loads((out / f"seed_{seed}/config.json").read_text())
        assert config["seed"] == seed
        assert config["minutes"] == 15.0
    best_policy = (out / "best.safetensors").read_bytes()
    assert best_policy == (out / "seed_4/actor.safetensors").read_bytes()

    # It was chosen on other courses than it is judged on.
    choice, verdict = evaluated
    assert choice.worlds != verdict.worlds
    assert verdict.methods == f"dwa,static,{out}/verdict/applr.safetensors"
    text = capsys.readouterr().out
    assert "seed_3 9.1 s, seed_4 7.1 s" in text
    assert "applr better: yes, " in text
    assert f"drive with: applr; best policy: {out}/best.safetensors" in text

    # Finished runs are resumed without a further step.
    checkpoint = json.loads((out / "seed_3/checkpoint.json").read_text())
    one_line(capsys, arguments, "already holds a run", train.main)
    assert several.train(parse(["--resume", "--out", str(out)]), toy_run) == 0
    resumed = json.loads((out / "seed_3/checkpoint.json").read_text())
    assert resumed["transitions"] == checkpoint["transitions"]


@pytest.mark.parametrize(
    ("seconds", "method"),
    [
        ({"applr": 7.5, "static": 5.0}, "static"),
        ({"applr": 7.5, "static": 20.0}, "applr"),
        ({"applr": 30.0, "static": 20.0}, "dwa"),
    ],
)
def test_the_policy_is_compared_with_default_and_tuned_parameters(
    seconds, method, tmp_path, evaluated, monkeypatch
):
    for name, value in seconds.items():
        monkeypatch.setitem(SECONDS, name, value)
    policy = tmp_path / "seed_3/best.safetensors"
    policy.parent.mkdir()
    policy.write_bytes(b"a policy")
    _, table, *_, last_line = several.choose(parse(toy(tmp_path, "--seeds", 2)), tmp_path, [policy])
    # Mean times, 0.1 s above those in SECONDS
    mean_times = [f"{SECONDS[name] + 0.1:.1f}" for name in ("dwa", "static", "applr")]
    assert [row.split()[4] for row in table.splitlines()[1:]] == mean_times
    assert last_line.startswith(f"drive with: {method}; ")
    assert (tmp_path / "best.safetensors").read_bytes() == b"a policy"
