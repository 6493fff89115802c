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


def test_the_exploration_noise_goes_from_its_start_to_its_end_and_stays():
    def noise(**options):
        return [round(TrainConfig(noise_steps=100, **options).noise(n), 9) for n in (0, 50, 100, 400)]

    assert noise(noise_start=0.5, noise_end=0.1) == [0.5, 0.3, 0.1, 0.1]
    assert noise(noise_start=0.0, noise_end=0.1) == [0.0, 0.05, 0.1, 0.1]


def test_policies_that_grow_too_old_before_there_is_a_new_one_are_refused(tmp_path, capsys):
    out = tmp_path / "run"
    given = ["--actors", "1", "--max-staleness", "10"]
    one_line(capsys, toy(out, *given), 2, "--max-staleness is 10, .*: give 25 or more")
    assert not out.exists()
    assert TrainConfig(actors=0, max_staleness=10).max_staleness == 10


def test_a_run_of_which_every_episode_is_refused_ends(tmp_path, capsys):
    options = ["--capacity", "4", "--eval-worlds", "none"]  # fewer than the rows of one episode
    one_line(capsys, toy(tmp_path / "run", *options), 1, "200 episodes in a row were refused: ")


@pytest.mark.parametrize("device", ["meta", "mps"])
def test_a_device_that_nothing_is_learnt_on_is_refused(device, tmp_path, capsys):
    one_line(capsys, toy(tmp_path / "run", "--device", device), 1, "device %s: this program learns on" % device)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            ["--layer-norm"],
            "its critics were trained with layer_norm True, this run has False; give the same --layer-norm",
        ),
        (["--bins", "21"], "its critics were trained with bins 21, this run has 0; give the same --bins"),
    ],
)
def test_a_run_does_not_begin_with_critics_of_another_kind(options, line, tmp_path, capsys):
    first, few = tmp_path / "first", ["--steps", "20", "--eval-worlds", "none"]
    assert main(toy(first, *few, *options)) == 0
    one_line(capsys, toy(tmp_path / "second", *few, "--start", first), 1, line)
    assert main(toy(tmp_path / "third", *few, *options, "--start", str(first))) == 0
