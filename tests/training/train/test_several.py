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
    return {
        Trial(world, name, 0, 1, world, name): Result(
            success=True, time_s=SECONDS[name] + 0.1 * (index % 3)
        )
        for index, world in enumerate(worlds)
        for name in names
    }


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
    arguments = toy(
        out, "--total-timesteps", 40, "--seeds", 2, "--seed", 3, "--minutes", 30, *NO_EVALUATION
    )
    assert several.train(parse(arguments), toy_run) == 0
    configs = [json.loads((out / f"seed_{seed}/config.json").read_text()) for seed in (3, 4)]
    assert [(config["seed"], config["minutes"]) for config in configs] == [(3, 15.0), (4, 15.0)]
    assert (out / "best.safetensors").read_bytes() == (
        out / "seed_4/actor.safetensors"
    ).read_bytes()
    choice, judged = evaluated
    assert choice.worlds != judged.worlds
    assert judged.methods == f"dwa,static,{out}/verdict/applr.safetensors"
    text = capsys.readouterr().out
    assert "seed_3 9.1 s, seed_4 7.1 s" in text
    assert "applr better: yes, " in text
    assert f"drive with: applr; best policy: {out}/best.safetensors" in text
    before = (out / "seed_3/checkpoint.json").read_bytes()
    one_line(capsys, arguments, "already holds a run", train.main)
    assert several.train(parse(["--resume", "--out", str(out)]), toy_run) == 0
    assert (
        json.loads((out / "seed_3/checkpoint.json").read_text())["transitions"]
        == json.loads(before)["transitions"]
    )


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
    _, table, *_, last = several.choose(parse(toy(tmp_path, "--seeds", 2)), tmp_path, [policy])
    ends = [f"{seconds.get(name, SECONDS[name]) + 0.1:.1f}" for name in ("dwa", "static", "applr")]
    assert [row.split()[4] for row in table.splitlines()[1:]] == ends
    assert last.startswith(f"drive with: {method}; ")
    assert (tmp_path / "best.safetensors").read_bytes() == b"a policy"
