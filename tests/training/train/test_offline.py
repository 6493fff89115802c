"""Tests of offline learning: datasets that fit or are refused, Minari, resumed runs."""

import functools
import json
from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest
import safetensors.numpy
import torch

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods
from tests.support.runs import NO_EVALUATION, main, one_line, toy
from tests.support.training import Broken, Line, episode
from training.env.reward import Reward
from training.env.trajectory import TransitionLayout
from training.train.learner.config import TrainConfig, recipe
from training.train.learner.learner import Learner
from training.train.learner.prepare import dataset_of
from training.train.replay import dataset
from training.workers.collect import Collect, collect

LAYOUT = TransitionLayout(0, 1, 1)


def write(folder, source=None, episodes=40, layout=LAYOUT, trajectories=None):
    """Write a dataset with ten transitions per episode, and return its folder."""
    folder.mkdir(exist_ok=True)
    if trajectories is None:
        trajectories = [episode(layout, number, 10) for number in range(episodes)]
    dataset.write(folder, layout, trajectories, source or {})
    return str(folder)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Dataset of 400 transitions."""
    return write(tmp_path_factory.mktemp("dataset") / "data")


def test_an_offline_run_has_no_actors(data, tmp_path):
    """Its option --actors counts those of the verdict alone."""
    threads = torch.get_num_threads()
    actors = ["--actors", "2", "--ray-address", "local"]
    options = ["--dataset", data, "--gradient-steps", "10", *NO_EVALUATION, *actors]
    assert main(toy(tmp_path / "run", *options)) == 0
    assert torch.get_num_threads() == threads


def test_td3bc_learns_from_a_dataset_and_is_resumed(tmp_path):
    """The policy learns from random drives."""
    # Given: a dataset of random drives
    stands_still = {
        "0.weight": np.zeros((1, 1), np.float32),
        "0.bias": np.zeros(1, np.float32),
    }
    weights = safetensors.numpy.save(stands_still)
    random_drives = []
    for number in range(80):
        task = Collect(number, 0, 0.0, True)
        random_drives.append(collect(Line, "{}", task, weights))
    dataset_folder = write(tmp_path / "data", trajectories=random_drives)

    # When: a run learns from it in two sessions
    run = tmp_path / "run"
    offline = ["--dataset", dataset_folder, "--bc-alpha", "2.5", "--eval-freq", "100"]
    assert main(toy(run, *offline, "--gradient-steps", "150")) == 0
    assert main(["--resume", "--out", str(run), "--gradient-steps", "400"]) == 0

    # Then: it neither copies the dataset nor names its folder
    assert Learner.saved(run)["updates"] == 400
    assert not list(run.glob("replay-*"))
    policy_file = run / "actor.safetensors"
    assert str(tmp_path).encode() not in policy_file.read_bytes()
    # The first policy stands still, and the last one is better.
    first_round, *_, last_round = (run / "evaluations.jsonl").read_text().splitlines()
    first_return = json.loads(first_round)["return"]
    last_return = json.loads(last_round)["return"]
    assert last_return > first_return + 1.0


def test_minari_reads_a_dataset(tmp_path, monkeypatch):
    layout = TransitionLayout(4, 2, 2)
    episodes = [episode(layout, number, 3, number % 2 == 0) for number in range(5)]
    write(tmp_path / "mine", {"robot": "jackal"}, layout=layout, trajectories=episodes)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))

    minaris_dataset = minari.load_dataset("mine")
    our_dataset = dataset.Dataset(tmp_path / "mine")

    assert minaris_dataset.total_episodes == 5
    assert minaris_dataset.total_steps == 15
    for written, by_minari, by_us in zip(
        episodes,
        minaris_dataset,
        our_dataset.trajectories(),
        strict=True,
    ):
        observations = layout.restore(written.scan, written.rest)
        np.testing.assert_array_equal(by_minari.observations, observations)
        np.testing.assert_array_equal(by_minari.actions, written.action)
        np.testing.assert_array_equal(by_minari.rewards, written.reward)
        assert by_minari.terminations.tolist() == [False, False, written.terminated]
        assert by_minari.truncations.tolist() == [False, False, not written.terminated]
        for field_name in ("scan", "rest", "action", "reward", "terminated"):
            values = getattr(by_us, field_name)
            np.testing.assert_array_equal(values, getattr(written, field_name))


def test_the_environment_named_by_a_dataset_is_not_made(tmp_path):
    """If the metadata lack the spaces, Minari creates the environment, which may run any code. Our
    reader must not.
    """
    # Given: a dataset that names an environment whose constructor makes a folder
    metadata_file = Path(write(tmp_path / "mine")) / "data/metadata.json"
    metadata = json.loads(metadata_file.read_text())
    del metadata["observation_space"]
    del metadata["action_space"]
    spec = gymnasium.envs.registration.EnvSpec(
        "A-v0",
        entry_point="os:mkdir",
        kwargs={"path": str(tmp_path / "ran")},
    )
    metadata["env_spec"] = spec.to_json()
    metadata_file.write_text(json.dumps(metadata))

    # Then: reading it does not make the folder
    our_dataset = dataset.Dataset(tmp_path / "mine")
    assert len(list(our_dataset.trajectories())) == 40
    assert not (tmp_path / "ran").exists()


@pytest.mark.fault("18b")
@pytest.mark.parametrize(
    ("source", "line"),
    [
        ({"decision_period": 1.0}, "decision_period is 2.0, but the dataset .* driven with 1.0"),
        ({"robot": "husky"}, "robot is jackal, but the dataset .* driven with husky"),
        ({"observation": "dimensionless"}, "observation is paper, .* with dimensionless"),
        ({"exact_time": True}, "exact_time is False, but the dataset .* with True"),
        ({"c_c": 0.06}, "c_c is 0.05, but the dataset .* with 0.06"),
    ],
)
def test_a_dataset_driven_with_other_settings_is_refused(source, line, tmp_path):
    data = write(tmp_path / "data", source, episodes=1, layout=TransitionLayout())
    config = TrainConfig(dataset=data)
    with pytest.raises(ApplrError, match=line):
        dataset_of(config)


@pytest.mark.fault("18b")
def test_a_dataset_driven_with_the_same_settings_is_taken(tmp_path):
    source = {
        "decision_period": 2,
        "robot": "jackal",
        **Reward().model_dump(),
        "bags": ["a"],
    }
    data = write(tmp_path / "data", source, episodes=20, layout=TransitionLayout())
    config = TrainConfig(dataset=data)
    assert dataset_of(config).transitions == 200


def test_a_dataset_from_which_nothing_can_be_learnt_is_refused_before_the_run(tmp_path, capsys):
    data = write(tmp_path / "data", episodes=19)
    arguments = toy(tmp_path / "run", "--dataset", data)
    one_line(capsys, arguments, "has 190 transitions, from which no policy learns: record .* 200")
    assert not (tmp_path / "run").exists()


def test_an_offline_run_says_how_much_was_driven_and_shows_no_empty_figures(
    data, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("training.train.learner.run.STATUS_SECONDS", 0.0)
    arguments = toy(tmp_path / "run", "--dataset", data, "--gradient-steps", "40", *NO_EVALUATION)
    assert main(arguments) == 0

    printed = capsys.readouterr()
    assert f"{data}: 400 transitions in 0.056 h of driving\n" in printed.out
    assert "updates=40" in printed.err
    # Without an evaluation, there is no best policy.
    judged = f"--robot jackal --methods dwa,{tmp_path}/run/actor.safetensors --worlds "
    assert f"\nto judge the policy: ./applr evaluate {judged}" in printed.out
    # An offline run drives no episodes.
    assert "nan" not in printed.err
    assert "actors" not in printed.err


def test_a_trial_that_fails_ends_a_run_after_saving_it(data, tmp_path, capsys):
    arguments = toy(tmp_path / "run", "--dataset", data, "--gradient-steps", "60")
    broken = functools.partial(main, env=Broken)
    problem = "trial 0 of dwa in environment failed: RuntimeError: the wheels came off"
    one_line(capsys, arguments, problem, broken)
    assert main(["--resume", "--out", str(tmp_path / "run")]) == 0


# The Jackal has a tuned set; the Burger does not, so that its defaults are explored.
@pytest.mark.parametrize(
    ("name", "around"),
    [
        ("jackal", "static"),
        ("turtlebot3_burger", "dwa"),
    ],
)
def test_the_method_explore_fits_the_recipe_offline(name, around, monkeypatch):
    # Without its random part, the method sets the centre of what it explores.
    monkeypatch.setattr("applr_ros1.policy.methods.EXPLORED", 0.0)
    robot = robots.load(name)
    explore = methods.make("explore", robot)
    centre = methods.make(around, robot)
    assert explore.theta(None) == pytest.approx(centre.theta(None))
    assert explore.period == recipe("offline")["decision_period"]
