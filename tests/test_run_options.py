"""Options of a training run that are refused before its folder is made, and those that a resumed run keeps or needs."""

import json

import numpy as np
import pytest
from test_offline import Killed, die
from test_train import one_line, state_of, toy

from applr_ros1.common.tensors import unpack
from training.gorila.config import TrainConfig, parse
from training.gorila.preparation import prepare
from training.gorila.run import TrainingRun
from training.td3.td3 import LearnerError
from training.train import main


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--period", "0.33"], "decision period of 0.33 s: give a multiple of 0.05 s"),
        (["--simulator", "nosuch:Class"], "simulator nosuch:Class cannot be imported"),
        (["--eval-simulator", "nosuch:Class"], "simulator nosuch:Class cannot be imported"),
    ],
)
@pytest.mark.parametrize("actors", ["0", "1"])
def test_a_period_or_simulator_that_cannot_be_leaves_no_folder(arguments, pattern, actors, tmp_path, capsys):
    given = ["--worlds", "generated:0", "--eval-worlds", "generated:1", "--actors", actors, "--out", tmp_path / "run"]
    one_line(capsys, [*given, *arguments], 1, pattern)
    assert not (tmp_path / "run").exists()


def test_a_simulator_of_evaluations_that_are_switched_off_is_not_made():
    prepare(TrainConfig(worlds="generated:0", eval_worlds="none", eval_simulator="nosuch:Class"))


def test_mirroring_is_for_our_own_observations(tmp_path, capsys):
    one_line(capsys, toy(tmp_path / "run", "--mirror"), 2, "--mirror is for the observations of the navigation task")
    assert not (tmp_path / "run").exists()
    assert TrainConfig(mirror=True).learner().mirror


def test_a_run_that_began_at_a_set_goes_on_without_its_file(tmp_path, capsys):
    given = tmp_path / "set.json"
    given.write_text('{"max_vel_x": 1.0}')
    assert len(parse(["--start", str(given), "--out", str(tmp_path)]).start_action()) == 8
    given.unlink()
    (tmp_path / "config.json").write_text(json.dumps({"start": str(given), "out": str(tmp_path)}))
    one_line(capsys, ["--resume", "--out", tmp_path], 1, "set.json: cannot be read")  # killed before a checkpoint
    (tmp_path / "checkpoint.json").write_text("{}")
    assert parse(["--resume", "--out", str(tmp_path)]).learner().start == ()


def test_a_recipe_beside_resume_must_be_one(tmp_path, capsys):
    (tmp_path / "config.json").write_text('{"steps": 20}')
    one_line(capsys, ["--resume", "--recipe", "nosuch", "--out", tmp_path], 2, "--recipe nosuch is unknown: give")
    assert parse(["--resume", "--recipe", "paper", "--out", str(tmp_path)]).steps == 20


def test_a_best_policy_that_was_not_kept_is_driven_again(tmp_path, monkeypatch):
    """Killed between the round's line and its policy; and the file of an older best one does not pass for it."""
    monkeypatch.setattr("training.gorila.run.draw_curves", lambda *arguments: None)  # a second each
    options = ["--steps", "400"]
    whole = tmp_path / "whole"
    assert main(toy(whole, *options)) == 0
    best = [r for r in map(json.loads, (whole / "evaluations.jsonl").read_text().splitlines()) if r["best"]]
    assert len(best) == 2
    export, exported = TrainingRun.export, []

    def killed(self, path, weights, result):
        if result:
            exported.append(result)
            if len(exported) == number:
                die()
        export(self, path, weights, result)

    for number in (1, 2):
        out = tmp_path / str(number)
        exported.clear()
        with monkeypatch.context() as patch:
            patch.setattr(TrainingRun, "export", killed)
            with pytest.raises(Killed):
                TrainingRun(parse(toy(out, *options))).run()
        assert (out / "best.safetensors").exists() == (number > 1)
        assert main(["--resume", "--out", str(out)]) == 0
        assert (out / "evaluations.jsonl").read_text() == (whole / "evaluations.jsonl").read_text()
        weights, header = unpack((out / "best.safetensors").read_bytes(), "best", LearnerError)
        theirs, expected = unpack((whole / "best.safetensors").read_bytes(), "best", LearnerError)
        assert json.loads(header["result"]) == json.loads(expected["result"]) == best[-1]
        assert all(np.array_equal(weights[name], theirs[name]) for name in theirs)
        assert state_of(out) == state_of(whole)
