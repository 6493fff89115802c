"""Learning from a dataset, alone or beside driving: what counts, and runs that are resumed."""

import csv
import json
import shutil
from dataclasses import asdict

import numpy as np
import pytest
from test_train import one_line, state_of, toy
from toy_env import Line

from training.experience.dataset import Writer
from training.experience.trajectory import Layout, Trajectory
from training.gorila.config import ConfigError, TrainConfig, parse
from training.gorila.learner import Learner
from training.gorila.preparation import dataset_of
from training.gorila.run import MANY_ERRORS, TrainingRun
from training.mdp.reward import Reward
from training.train import main

LAYOUT = Layout(0, 1, 1)
NO_EVALUATION = ["--eval-worlds", "none"]


def write(folder, source=None, episodes=40, seed=0):
    """A dataset of ten transitions an episode; its folder as text."""
    rng = np.random.default_rng(seed)
    writer = Writer(folder, LAYOUT, source)
    for number in range(episodes):
        observations, actions = rng.uniform(-1, 1, (11, 1)), rng.uniform(-1, 1, (10, 1))
        info = {"actor": "another", "episode": number}
        writer.add(Trajectory.of(LAYOUT, observations, actions, rng.normal(size=10), False, info))
    writer.close()
    return str(folder)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A dataset of 400 transitions."""
    return write(tmp_path_factory.mktemp("dataset") / "data")


@pytest.fixture(scope="module")
def mixed(data, tmp_path_factory):
    """The options of a run of 200 transitions beside the dataset, and the folder of one that was never killed."""
    out = tmp_path_factory.mktemp("mixed") / "run"
    options = ["--dataset", data, "--mix", "--steps", "200", "--checkpoint-every", "1000", *NO_EVALUATION]
    assert main(toy(out, *options)) == 0
    return options, out


@pytest.fixture(autouse=True)
def no_curves(monkeypatch):
    """Drawing the learning curves takes a second each time."""
    monkeypatch.setattr("training.gorila.run.draw_curves", lambda *arguments: None)


@pytest.mark.parametrize("killed", [False, True])
def test_an_offline_run_that_is_resumed_makes_no_step_beyond_its_updates(data, tmp_path, killed, monkeypatch):
    """Finished, or killed before its first checkpoint."""
    options = ["--dataset", data, "--updates", "20", *NO_EVALUATION]
    assert main(toy(tmp_path / "whole", *options)) == 0
    out = tmp_path / "run"
    if killed:
        with monkeypatch.context() as patch:
            patch.setattr(TrainingRun, "save", die)
            with pytest.raises(Killed):
                TrainingRun(parse(toy(out, *options))).run()
    else:
        assert main(toy(out, *options)) == 0
    assert main(["--resume", "--out", str(out)]) == 0
    assert Learner.saved(out)["updates"] == 20
    assert state_of(out) == state_of(tmp_path / "whole")


def test_a_dataset_beside_driving_counts_neither_as_steps_nor_as_warm_up(data, tmp_path):
    out = tmp_path / "run"
    options = ["--dataset", data, "--mix", "--steps", "300", "--warmup", "100", "--noise-steps", "300", *NO_EVALUATION]
    assert main(toy(out, *options, "--eval-every", "1000000")) == 0
    saved = Learner.saved(out)
    assert (saved["transitions"], saved["given"]) == (700, 400)
    assert saved["updates"] == (400 + 300 - 100) * 0.5
    with open(out / "episodes.csv") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["transitions"]) for row in rows] == list(range(10, 301, 10))
    assert {int(row["version"]) for row in rows[:10]} == {200}  # no gradient step before the warm-up's end
    assert int(rows[-1]["version"]) > 200
    assert float(rows[0]["sigma"]) == 0.5
    run = TrainingRun(parse(["--resume", "--out", str(out)]))
    assert (run.steps, run.scheduler.transitions, run.finished) == (300, 300, True)
    assert run.run() == 0


class Killed(BaseException):
    """What a SIGKILL does: nothing is saved any more."""


def die(*arguments, **options):
    raise Killed


@pytest.mark.parametrize("calls", [25, 75, 300])
def test_a_mixed_run_that_is_killed_ends_as_one_that_was_not(mixed, tmp_path, calls, monkeypatch):
    """Killed while it takes the dataset, while it learns from it, and while it drives."""
    options, whole = mixed
    taken = []

    def counted(real):
        def call(*arguments):
            taken.append(1)
            return real(*arguments) if len(taken) <= calls else die()

        return call

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(Learner, "take", counted(Learner.take))
        patch.setattr(Learner, "update", counted(Learner.update))
        with pytest.raises(Killed):
            TrainingRun(parse(toy(out, *options))).run()
    assert main(["--resume", "--out", str(out)]) == 0
    assert state_of(out) == state_of(whole)
    assert (out / "episodes.csv").read_text() == (whole / "episodes.csv").read_text()


@pytest.mark.parametrize(
    ("source", "given", "line"),
    [
        ({"period": 1.0}, [], "--period is 0.5, but the dataset .* was driven with 1.0: give --period 1.0"),
        ({"weights": "per_metre"}, [], ""),  # of an environment of one's own nothing but the period is known
        ({"period": 1}, ["--period", "1"], ""),
        ({"period": 0.6000000000000001}, ["--period", "0.6"], ""),
        ({}, [], ""),
        (["bags"], [], ""),
    ],
)
def test_a_dataset_of_another_period_is_refused(source, given, line, tmp_path, capsys):
    options = ["--dataset", write(tmp_path / "data", source, 4), "--updates", "2", *NO_EVALUATION, *given]
    if not line:
        assert main(toy(tmp_path / "run", *options)) == 0
        return
    one_line(capsys, toy(tmp_path / "run", *options), 2, line)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ({"weights": "per_metre"}, "--weights is per_cell, but the dataset .* driven with per_metre: give --weights"),
        ({"robot": "husky"}, "--robot is jackal, but the dataset .* driven with husky: give --robot husky"),
        (
            {"reward": {"exact_time": True}},
            "--exact-time is False, but the .* with True: give --exact-time, or",
        ),
        ({"reward": {"c_c": 0.06}}, "--c-c is 0.05, but the rewards of the dataset .* with 0.06: give --c-c 0.06, or"),
        ({"reward": "unknown"}, ""),
        ({"period": 2.0, "weights": "per_cell", "robot": "jackal", "reward": asdict(Reward())}, ""),
    ],
)
def test_a_dataset_of_other_weights_or_rewards_or_of_another_robot_is_refused(source, line, tmp_path):
    layout = Layout()
    writer = Writer(tmp_path, layout, source)
    zeros = np.zeros((3, layout.size)), np.zeros((2, layout.action)), np.zeros(2)
    writer.add(Trajectory.of(layout, *zeros, False, {"actor": "a", "episode": 0}))
    writer.close()
    config = TrainConfig(dataset=str(tmp_path))
    if line:
        with pytest.raises(ConfigError, match=line):
            dataset_of(config, layout)
    else:
        assert dataset_of(config, layout).transitions == 2


def test_a_run_is_not_resumed_with_another_dataset(data, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(toy(out, "--dataset", data, "--updates", "20", *NO_EVALUATION)) == 0
    other = write(tmp_path / "other", seed=1)
    again = ["--resume", "--out", str(out), "--updates", "40"]
    one_line(capsys, [*again, "--dataset", other], 2, "other: the run in .*run was begun with another dataset")
    assert json.loads((out / "config.json").read_text())["dataset"] == data
    moved = shutil.copytree(data, tmp_path / "moved")
    assert main([*again, "--dataset", str(moved)]) == 0
    assert Learner.saved(out)["updates"] == 40


def test_the_gradient_steps_for_a_dataset_obey_time_and_checkpoints(data, tmp_path, monkeypatch):
    """They may take hours: --minutes ends them, they are saved now and then, and a resumed run makes the rest."""
    out = tmp_path / "run"
    options = ["--dataset", data, "--mix", "--steps", "20", "--updates-per-transition", "10", "--checkpoint-every", "0"]
    saved = []
    with monkeypatch.context() as patch:
        patch.setattr(TrainingRun, "save", lambda run: saved.append(run.learner.td3.updates) or save(run))
        patch.setattr(TrainingRun, "elapsed", property(lambda run: 60.0 * (run.learner.td3.updates >= 100)))
        assert main(toy(out, *options, "--minutes", "0.5", *NO_EVALUATION)) == 0
    assert saved[:4] == [0, 10, 20, 30]
    assert Learner.saved(out)["updates"] == 100
    run = TrainingRun(parse(["--resume", "--out", str(out), "--minutes", "0"]))
    assert (run.learner.td3.updates, run.learner.updates_due) == (100, 3900)  # made in run(), which signals reach
    run.pool.close()
    run.lock.close()


save = TrainingRun.save


class Uneven(Line):
    """Fails in one trial of ten."""

    def reset(self, *, seed=None, options=None):
        result = super().reset(seed=seed)
        if self.np_random.uniform() < 0.1:
            raise RuntimeError("the wheels came off")
        return result


def test_failures_in_a_row_are_counted_from_the_last_success(data, tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--env", "test_offline:Uneven", "--dataset", data, "--updates", "60", "--eval-every", "10"]
    assert main(toy(out, *options, "--eval-trials", "150")) == 0, capsys.readouterr().err
    rounds = [json.loads(line) for line in (out / "evaluations.jsonl").read_text().splitlines()]
    assert sum(150 - r["trials"] for r in rounds) > MANY_ERRORS
    assert not any(r["best"] for r in rounds if r["trials"] < 150)  # what failed may have been the hard ones
