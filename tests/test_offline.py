"""Learning from a dataset, alone or beside driving: what counts, and runs that are resumed."""

import csv

import numpy as np
import pytest
from test_train import one_line, state_of, toy

from training.experience.dataset import Writer
from training.experience.trajectory import Layout, Trajectory
from training.gorila.config import ConfigError, TrainConfig, parse
from training.gorila.learner import Learner
from training.gorila.preparation import dataset_of
from training.gorila.run import TrainingRun
from training.train import main

LAYOUT = Layout(0, 1, 1)
NO_EVALUATION = ["--eval-worlds", "none"]


def write(folder, source=None, episodes=40):
    """A dataset of ten transitions an episode; its folder as text."""
    rng = np.random.default_rng(0)
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
        ({"period": 2.0, "weights": "per_cell", "robot": "jackal"}, ""),
    ],
)
def test_a_dataset_of_other_weights_or_of_another_robot_is_refused(source, line, tmp_path):
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
