"""Tests of train.py --seeds: shared time, selection of the best policy, comparison on other
courses.
"""

import json
import os
from pathlib import Path

import pytest

from applr_ros1.common.errors import ApplrError
from tests.support.refusals import refused
from tests.support.runs import NO_EVALUATION, one_line, toy, toy_run
from training.evaluate.trial import Result, Trial
from training.train import __main__ as train
from training.train.learner import several
from training.train.learner.config import parse
from worlds import specs

# Mean times of the methods in all worlds [s], about
SECONDS = {
    "seed_3": 9.0,
    "seed_4": 7.0,
    "dwa": 20.0,
    "static": 10.0,
    "applr": 7.5,
}


def fake(options):
    """Return the results of an evaluation, with the times in SECONDS."""
    worlds = specs(options.worlds)
    assert len(worlds) == 50
    results = {}
    for index, world in enumerate(worlds):
        for method_spec in options.methods.split(","):
            method_name = Path(method_spec).stem
            # Not all equal, or a test of differences could not be made.
            seconds = SECONDS[method_name] + 0.1 * (index % 3)
            trial = Trial(world, method_name, 0, 1, world, method_name)
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
    runs = tmp_path / "runs"
    options = ["--total-timesteps", 40, "--seeds", 2, "--seed", 3, "--minutes", 30]
    arguments = toy(runs, *options, *NO_EVALUATION)
    assert several.train(parse(arguments), toy_run) == 0

    # The runs share the time, and the faster one's policy is kept.
    for seed in (3, 4):
        config = json.loads((runs / f"seed_{seed}/config.json").read_text())
        assert config["seed"] == seed
        assert config["minutes"] == 15.0
    best_policy = (runs / "best.safetensors").read_bytes()
    assert best_policy == (runs / "seed_4/actor.safetensors").read_bytes()

    # It was chosen on other courses than it is judged on.
    choice, verdict = evaluated
    assert choice.worlds != verdict.worlds
    assert verdict.methods == f"dwa,static,{runs}/verdict/applr.safetensors"
    printed = capsys.readouterr().out
    assert "seed_3 9.1 s, seed_4 7.1 s" in printed
    assert "applr better: yes, " in printed
    assert f"drive with: applr; best policy: {runs}/best.safetensors" in printed

    # Finished runs are resumed without a further step.
    checkpoint_file = runs / "seed_3/checkpoint.json"
    checkpoint = json.loads(checkpoint_file.read_text())
    one_line(capsys, arguments, "already holds a run", train.main)
    assert several.train(parse(["--resume", "--out", str(runs)]), toy_run) == 0
    resumed_checkpoint = json.loads(checkpoint_file.read_text())
    assert resumed_checkpoint["transitions"] == checkpoint["transitions"]


def test_worlds_that_judge_a_policy_are_not_for_training(tmp_path):
    config = parse(
        ["--seeds", "2", "--out", str(tmp_path), "--worlds", "generated:0,fresh:0-22000"]
    )
    # All worlds of the choice, and one of the verdict
    problem = "--worlds contains fresh:21000, in which the result is judged: leave out 51 such"
    with pytest.raises(ApplrError, match=problem):
        several.train(config, None)


def test_the_run_of_one_seed_is_continued_alone_or_with_the_others(tmp_path):
    run_folder = tmp_path / "seed_2"
    run_folder.mkdir()
    (run_folder / "checkpoint.json").write_text("{}")
    config = parse(["--seeds", "3", "--out", str(run_folder)])
    refused(lambda: several.train(config, None), "continue it with --resume --seeds 1")
    (tmp_path / "config.json").write_text("{}")
    remedy = f"give --resume --out {tmp_path}, which continues all"
    refused(lambda: several.train(config, None), remedy)


def test_policies_are_compared_on_this_machine_alone(tmp_path, evaluated):
    """Actors may be many on a cluster, which does not have the policies' files."""
    policy_file = tmp_path / "seed_3/best.safetensors"
    policy_file.parent.mkdir()
    policy_file.write_bytes(b"a policy")
    options = ["--seeds", 2, "--actors", 2000, "--ray-address", "head:6379"]
    several.choose(parse(toy(tmp_path, *options)), tmp_path, [policy_file])
    for requested in evaluated:
        assert 0 < requested.workers <= (os.cpu_count() or 1)
        assert requested.ray_address == ""
