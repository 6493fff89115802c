"""The comparison of learning variants: equal time, resumable, a row for each variant."""

import csv
import dataclasses
import json
import subprocess
import sys
import time

import pytest

pytest.importorskip("torch")

from applr_ros1.common.errors import ApplrError
from training import compare_variants
from training.evaluation.run import evaluate
from training.gorila.learner import Learner
from training.storage import Lock

TINY = """
seeds: [3]
minutes: 5
options: {env: "tests.toy_env:Line", steps: 40, hidden: "8", batch_size: 4, eval_worlds: none, tensorboard: false,
  robot: husky}
variants:
  plain: {}
  quick_0.5: {updates_per_transition: 0.5}
"""


def test_each_variant_is_trained_judged_and_gets_a_row(tmp_path, monkeypatch, capsys):
    """The toy environment's policies cannot drive: the toy runner stands in for the trials."""
    file, out = tmp_path / "tiny.yaml", tmp_path / "out"
    file.write_text(TINY)

    robots = []

    def drive(options):
        robots.append(options.robot.name)
        evaluate(dataclasses.replace(options, methods="dwa", runner="tests.toy_runner:ToyRunner", workers=0))

    monkeypatch.setattr(compare_variants, "evaluate", drive)
    command = [str(file), "--out", str(out), "--worlds", "generated:0,generated:1", "--trials", "2", "--parallel", "2"]
    assert compare_variants.main(command) == 0, capsys.readouterr().err
    assert robots == ["husky", "husky"]
    assert "5 minutes of training" in capsys.readouterr().out
    rows = list(csv.DictReader((out / "tiny.csv").open()))
    assert [(row["variant"], row["seeds"], float(row["transitions"])) for row in rows] == [
        ("plain", "1", 40.0),
        ("quick_0.5", "1", 40.0),
    ]
    assert [float(row["updates"]) for row in rows] == [4.0, 20.0]
    assert rows[0]["score"] == rows[1]["score"]  # the same toy trials
    assert "| quick_0.5 | 1 |" in (out / "tiny.md").read_text()
    assert (out / "tiny.png").read_bytes().startswith(b"\x89PNG")
    config = json.loads((out / "plain-3" / "config.json").read_text())
    del config["bf16"]  # as of a run that is older than this option
    (out / "plain-3" / "config.json").write_text(json.dumps(config))
    assert compare_variants.main(command) == 0
    assert "minutes of training" not in capsys.readouterr().out  # nothing is left to do
    policy = out / "plain-3" / "actor.safetensors"
    assert compare_variants.trials_of(out / "plain-3").is_dir()
    policy.write_bytes((out / "quick_0.5-3" / "actor.safetensors").read_bytes())  # as after longer training
    assert not compare_variants.trials_of(out / "plain-3").exists()
    assert compare_variants.main(command) == 0  # judges the other policy
    file.write_text(TINY.replace("n: 0.5", "n: 0.7"))
    assert compare_variants.main(command) == 1
    assert "updates_per_transition 0.5, not 0.7" in capsys.readouterr().err


def test_runs_at_the_same_time_have_equal_shares_of_the_cores():
    assert compare_variants.shares([0, 1, 2, 3, 4], 2) == [[0, 1], [2, 3]]
    assert compare_variants.shares([4, 6], 1) == [[4, 6]]
    assert compare_variants.shares([0, 1], 3) == [[0, 1]] * 3


def test_sigterm_saves_and_ends_the_runs_too(tmp_path):
    file, run = tmp_path / "slow.yaml", tmp_path / "out" / "plain-3"
    file.write_text(TINY.replace("toy_env:Line", "toy_env:Slow").replace("steps: 40", "steps: 100000"))
    command = [sys.executable, "-m", "training.compare_variants", str(file), "--out", str(tmp_path / "out")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as comparison:
        until = time.monotonic() + 60.0
        while not (run / "config.json").exists() and time.monotonic() < until:
            time.sleep(0.1)
        comparison.terminate()
        _, errors = comparison.communicate(timeout=60)
    assert comparison.returncode == 130
    assert errors.splitlines()[-1] == "compare_variants: stopped; the same command continues"
    assert Learner.saved(run) is not None
    Lock(run).close()  # nobody works in it any more


def test_a_run_ends_when_its_time_is_up(tmp_path):
    from training import train

    arguments = ["--env", "tests.toy_env:Slow", "--hidden", "8", "--eval-worlds", "none", "--no-tensorboard"]
    arguments += ["--steps", "100000", "--minutes", "0.05", "--out", str(tmp_path / "run")]
    assert train.main(arguments) == 0
    saved = Learner.saved(tmp_path / "run")
    assert saved["transitions"] < 100_000
    assert saved["extra"]["elapsed"] >= 3.0


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("variants: {a: {}}", "minutes"),
        ("minutes: 1\nvariants: {}", "variants"),
        ("minutes: 1\nvariants: [1]", "variants"),
        ("minutes: 1\nvariants: {a: {batchsize: 3}}", "batchsize"),
        ("minutes: 1\nvariants: {a: {batch_size: 0}}", "batch-size"),
        ("minutes: 1\nvariants: {../a: {}}", "'../a'"),
        ("minutes: 1\nvariants: {a: {refine: 2}}", "variant a: refine"),
        ("minutes: soon\nvariants: {a: {}}", "minutes"),
        ("minutes: 1\nrecipe: nothing\nvariants: {a: {}}", "nothing"),
        ("{", "YAML"),
    ],
)
def test_a_file_that_cannot_be_meant_is_one_line(text, word, tmp_path):
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ApplrError, match=word) as error:
        compare_variants.read(str(file))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("file", sorted(compare_variants.VARIANTS.glob("*.yaml")), ids=lambda file: file.stem)
def test_an_included_comparison_compares_what_its_recipe_begins_with(file):
    found = compare_variants.read(str(file))
    first = next(iter(found.variants))
    runs = {name: found.of(name, found.seeds[0]) for name in found.variants}
    assert all(runs[name] != runs[first] for name in runs if name != first)
    assert all(set(found.variants[name]).isdisjoint(found.options) for name in runs)  # nothing common is overruled


def test_what_a_comparison_gives_each_run():
    found = compare_variants.read(str(compare_variants.VARIANTS / "learning.yaml"))
    assert len(found.runs()) == 3 * len(found.variants)
    assert found.of("applr", 0)["bins"] == 101
    assert found.of("regressing_critics", 0)["bins"] == 0
    found = dataclasses.replace(found, recipe="applr", options={})
    assert (found.of("applr", 0)["partner"], found.of("applr", 0)["refine"]) == ("", 0)  # no part of an equal wall time
    assert (
        compare_variants.read(str(compare_variants.VARIANTS / "smoothness.yaml")).of("switch_5", 0)["c_switch"] == 5.0
    )
