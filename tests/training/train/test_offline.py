"""Tests of offline learning: datasets that fit or are refused, Minari, resumed runs."""

import functools
import json
from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest
import safetensors.numpy

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods
from tests.support.runs import main, one_line, toy
from tests.support.training import Broken, Line, episode
from training.env.reward import Reward
from training.env.trajectory import TransitionLayout
from training.train.learner.config import TrainConfig, recipe
from training.train.learner.learner import Learner
from training.train.learner.prepare import dataset_of
from training.train.replay import dataset
from training.workers.collect import Collect, collect

LAYOUT = TransitionLayout(0, 1, 1)


def write(folder, source=None, episodes=40, layout=LAYOUT, made=None):
    """Write a dataset with ten transitions per episode, and return its folder."""
    folder.mkdir(exist_ok=True)
    dataset.write(
        folder,
        layout,
        made or [episode(layout, number, 10) for number in range(episodes)],
        source or {},
    )
    return str(folder)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Dataset of 400 transitions."""
    return write(tmp_path_factory.mktemp("dataset") / "data")


def test_td3bc_learns_from_a_dataset_and_is_resumed(tmp_path):
    """The policy learns from random drives."""
    weights = safetensors.numpy.save(
        {"0.weight": np.zeros((1, 1), np.float32), "0.bias": np.zeros(1, np.float32)}
    )
    random = [collect(Line, "{}", Collect(number, 0, 0.0, True), weights) for number in range(80)]
    data = write(tmp_path / "data", made=random)
    run = tmp_path / "run"
    offline = ["--dataset", data, "--bc-alpha", "2.5", "--eval-freq", "100"]
    assert main(toy(run, *offline, "--gradient-steps", "150")) == 0
    assert main(["--resume", "--out", str(run), "--gradient-steps", "400"]) == 0
    assert Learner.saved(run)["updates"] == 400
    assert not list(run.glob("replay-*"))  # The dataset is not copied.
    # The metadata contains no folders.
    assert str(tmp_path).encode() not in (run / "actor.safetensors").read_bytes()
    rounds = [json.loads(line) for line in (run / "evaluations.jsonl").read_text().splitlines()]
    # The first policy stands still.
    assert rounds[-1]["return"] > rounds[0]["return"] + 1.0


def test_minari_reads_a_dataset(tmp_path, monkeypatch):
    layout = TransitionLayout(4, 2, 2)
    episodes = [episode(layout, number, 3, number % 2 == 0) for number in range(5)]
    write(tmp_path / "mine", {"robot": "jackal"}, layout=layout, made=episodes)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    loaded = minari.load_dataset("mine")
    assert (loaded.total_episodes, loaded.total_steps) == (5, 15)
    for theirs, ours, back in zip(
        loaded, episodes, dataset.Dataset(tmp_path / "mine").trajectories(), strict=True
    ):
        np.testing.assert_array_equal(theirs.observations, layout.restore(ours.scan, ours.rest))
        np.testing.assert_array_equal(theirs.actions, ours.action)
        np.testing.assert_array_equal(theirs.rewards, ours.reward)
        assert theirs.terminations.tolist() == [False, False, ours.terminated]
        assert theirs.truncations.tolist() == [False, False, not ours.terminated]
        for name in ("scan", "rest", "action", "reward", "terminated"):
            np.testing.assert_array_equal(getattr(back, name), getattr(ours, name))


def test_the_environment_named_by_a_dataset_is_not_made(tmp_path):
    """If the metadata lack the spaces, Minari creates the environment, which may run any code. Our
    reader must not.
    """
    path = Path(write(tmp_path / "mine")) / "data/metadata.json"
    about = json.loads(path.read_text())
    del about["observation_space"], about["action_space"]
    ran = {"entry_point": "os:mkdir", "kwargs": {"path": str(tmp_path / "ran")}}
    path.write_text(
        json.dumps(
            {**about, "env_spec": gymnasium.envs.registration.EnvSpec("A-v0", **ran).to_json()}
        )
    )
    assert len(list(dataset.Dataset(tmp_path / "mine").trajectories())) == 40
    assert not (tmp_path / "ran").exists()


@pytest.mark.fault("18b")
def test_a_dataset_driven_with_other_settings_is_refused(tmp_path, capsys):
    layout = TransitionLayout()
    for number, (source, line) in enumerate(
        (
            (
                {"decision_period": 1.0},
                "decision_period is 2.0, but the dataset .* driven with 1.0",
            ),
            ({"robot": "husky"}, "robot is jackal, but the dataset .* driven with husky"),
            (
                {"observation": "dimensionless"},
                "observation is paper, but the dataset .* with dimensionless",
            ),
            ({"exact_time": True}, "exact_time is False, but the dataset .* with True"),
            ({"c_c": 0.06}, "c_c is 0.05, but the dataset .* with 0.06"),
            ({"decision_period": 2, "robot": "jackal", **Reward().model_dump(), "bags": ["a"]}, ""),
        )
    ):
        config = TrainConfig(dataset=write(tmp_path / str(number), source, 1, layout=layout))
        if line:
            with pytest.raises(ApplrError, match=line):
                dataset_of(config)
        else:
            assert dataset_of(config).transitions == 10
    toys = write(tmp_path / "toys", {"decision_period": 1.0})
    one_line(capsys, toy(tmp_path / "run", "--dataset", toys), "decision_period is 0.5, but")
    assert not (tmp_path / "run").exists()
    one_line(
        capsys,
        toy(tmp_path / "run", "--dataset", tmp_path / "absent"),
        "metadata.json: cannot be read",
    )


def test_a_trial_that_fails_ends_a_run_after_saving_it(data, tmp_path, capsys):
    arguments = toy(tmp_path / "run", "--dataset", data, "--gradient-steps", "60")
    broken = functools.partial(main, env=Broken)
    one_line(
        capsys,
        arguments,
        "trial 0 of dwa in environment failed: RuntimeError: the wheels came off",
        broken,
    )
    assert main(["--resume", "--out", str(tmp_path / "run")]) == 0


@pytest.mark.parametrize(
    ("name", "around"), [("jackal", "static"), ("turtlebot3_burger", "dwa")]
)  # not tuned
def test_the_method_explore_fits_the_recipe_offline(name, around, monkeypatch):
    monkeypatch.setattr("applr_ros1.policy.methods.EXPLORED", 0.0)
    robot = robots.load(name)
    method = methods.make("explore", robot)
    centre = methods.make(around, robot)
    assert method.theta(None) == pytest.approx(centre.theta(None))
    # Whether the distance biases are per cell.
    assert method.per_cell == centre.per_cell
    assert method.period == recipe("offline")["decision_period"]
