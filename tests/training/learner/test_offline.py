"""Learning from a dataset without driving: what fits, and runs that are resumed."""

import json
import shutil

import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods
from tests.support.episodes import episode
from tests.support.kills import Killed
from tests.support.toy_env import Line
from tests.support.toy_training import NO_EVALUATION, main, one_line, state_of, toy, toy_run
from training.env.reward import Reward
from training.learner.config import TrainConfig, parse, recipe
from training.learner.learner import Learner
from training.learner.prepare import dataset_of
from training.replay.store import NAME, TrajectoryStore
from training.replay.trajectory import TransitionLayout
from training.train import MANY_ERRORS, TrainingRun

LAYOUT = TransitionLayout(0, 1, 1)


def write(folder, source=None, episodes=40, seed=0, layout=LAYOUT):
    """A dataset of ten transitions an episode; its folder as text."""
    folder.mkdir(exist_ok=True)
    store = TrajectoryStore(folder / NAME, layout)
    for number in range(episodes):
        store.append(episode(layout, 1000 * seed + number, 10, "another"))
    store.note("source", source or {})
    store.close()
    return str(folder)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A dataset of 400 transitions."""
    return write(tmp_path_factory.mktemp("dataset") / "data")


def test_a_run_is_a_dataset_that_td3bc_learns_from(tmp_path):
    """TD3+BC on what a run collected drives better than the data; resumed half-way it ends the same."""
    assert main(toy(tmp_path / "run", "--total-timesteps", "800", *NO_EVALUATION)) == 0
    offline = ["--dataset", tmp_path / "run", "--bc-alpha", "2.5", "--eval-freq", "100"]
    assert main(toy(tmp_path / "a", *offline, "--gradient-steps", "400")) == 0
    assert main(toy(tmp_path / "b", *offline, "--gradient-steps", "150")) == 0
    assert main(["--resume", "--out", str(tmp_path / "b"), "--gradient-steps", "400"]) == 0
    assert state_of(tmp_path / "a") == state_of(tmp_path / "b")
    assert TrajectoryStore(tmp_path / "a").last == 0  # the dataset is not copied
    assert str(tmp_path).encode() not in (tmp_path / "a" / "actor.safetensors").read_bytes()  # names no folders
    rounds = [json.loads(line) for line in (tmp_path / "a" / "evaluations.jsonl").read_text().splitlines()]
    assert rounds[-1]["return"] > rounds[0]["return"] + 1.0  # standing still


@pytest.mark.parametrize("killed", [False, True])
def test_an_offline_run_that_is_resumed_makes_no_step_beyond_its_own(data, tmp_path, killed, monkeypatch):
    """Finished, or killed before its first checkpoint."""
    options = ["--dataset", data, "--gradient-steps", "20", *NO_EVALUATION]
    assert main(toy(tmp_path / "whole", *options)) == 0
    out = tmp_path / "run"
    if killed:

        def die(run):
            raise Killed

        with monkeypatch.context() as patch:
            patch.setattr(TrainingRun, "save", die)
            with pytest.raises(Killed):
                toy_run(parse(toy(out, *options))).run()
    else:
        assert main(toy(out, *options)) == 0
    assert main(["--resume", "--out", str(out)]) == 0
    assert Learner.saved(out)["updates"] == 20
    assert state_of(out) == state_of(tmp_path / "whole")


@pytest.mark.fault("18b")
def test_a_dataset_that_was_driven_otherwise_is_refused(tmp_path, capsys):
    layout = TransitionLayout()
    for number, (source, line) in enumerate(
        (
            ({"decision_period": 1.0}, "decision_period is 2.0, but the dataset .* driven with 1.0"),
            ({"robot": "husky"}, "robot is jackal, but the dataset .* driven with husky"),
            ({"observation": "dimensionless"}, "observation is paper, but the dataset .* with dimensionless"),
            ({"exact_time": True}, "exact_time is False, but the dataset .* with True"),
            ({"c_c": 0.06}, "c_c is 0.05, but the dataset .* with 0.06"),
            ({"decision_period": 2, "robot": "jackal", **Reward().model_dump(), "bags": ["a"]}, ""),
        )
    ):
        config = TrainConfig(dataset=write(tmp_path / str(number), source, 1, layout=layout))
        if line:
            with pytest.raises(ApplrError, match=line):
                dataset_of(config, layout)
        else:
            assert dataset_of(config, layout).transitions == 10
    toys = write(tmp_path / "toys", {"decision_period": 1.0})
    one_line(capsys, toy(tmp_path / "run", "--dataset", toys), "decision_period is 0.5, but")
    assert not (tmp_path / "run").exists()
    with pytest.raises(ApplrError, match="its layout is .*, this training has"):
        dataset_of(TrainConfig(dataset=write(tmp_path / "other")), layout)
    with pytest.raises(ApplrError, match="holds no transitions"):
        dataset_of(TrainConfig(dataset=write(tmp_path / "empty", {}, 0, layout=layout)), layout)


def test_a_run_is_not_resumed_with_another_dataset(data, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(toy(out, "--dataset", data, "--gradient-steps", "20", *NO_EVALUATION)) == 0
    other = write(tmp_path / "other", seed=1)
    again = ["--resume", "--out", str(out), "--gradient-steps", "40"]
    one_line(capsys, [*again, "--dataset", other], "other: the run in .*run was begun with another dataset")
    assert json.loads((out / "config.json").read_text())["dataset"] == data
    moved = shutil.copytree(data, tmp_path / "moved")
    assert main([*again, "--dataset", str(moved)]) == 0
    assert Learner.saved(out)["updates"] == 40
    one_line(capsys, toy(moved), "holds a dataset; give another --out")


class Uneven(Line):
    """Fails in one trial of ten."""

    def reset(self, *, seed=None, options=None):
        result = super().reset(seed=seed)
        if self.np_random.uniform() < 0.1:
            raise RuntimeError("the wheels came off")
        return result


def test_failures_in_a_row_are_counted_from_the_last_success(data, tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--dataset", data, "--gradient-steps", "60", "--eval-freq", "10"]
    assert main(toy(out, *options, "--n-eval-episodes", "150"), "test_offline:Uneven") == 0, capsys.readouterr().err
    rounds = [json.loads(line) for line in (out / "evaluations.jsonl").read_text().splitlines()]
    assert sum(150 - r["trials"] for r in rounds) > MANY_ERRORS
    assert not any(r["best"] for r in rounds if r["trials"] < 150)  # what failed may have been the hard ones


@pytest.mark.parametrize(("name", "around"), [("jackal", "static"), ("turtlebot3_burger", "dwa")])  # it has no set
def test_exploration_is_what_the_recipe_offline_learns_from(name, around, monkeypatch):
    monkeypatch.setattr("applr_ros1.policy.methods.included.EXPLORED", 0.0)
    robot = robots.load(name)
    method, centre = methods.make("explore", robot), methods.make(around, robot)
    assert method.theta(None) == pytest.approx(centre.theta(None))
    assert method.per_cell == centre.per_cell  # whether its distance weights are per cell
    assert method.period == recipe("offline")["decision_period"]
