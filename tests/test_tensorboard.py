"""TensorBoard events of a training run: the terms of the reward by episode and the hyper-parameters, also resumed."""

import json

import pytest
from test_train import TOY
from toy_env import Line

from training.experience.journal import Journal
from training.experience.trajectory import Trajectory, TrajectoryError
from training.train import main

events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")


class TwoTerms(Line):
    """A line whose reward consists of two terms."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return (
            observation,
            reward,
            terminated,
            truncated,
            dict(info, reward={"near": 0.25 * reward, "far": 0.75 * reward}),
        )


def test_terms_of_the_reward_and_hyper_parameters(tmp_path):
    out = tmp_path / "run"
    options = [word for word in TOY if word != "--no-tensorboard"]
    options[options.index("tests.toy_env:Line")] = "tests.test_tensorboard:TwoTerms"
    assert main([*options, "--eval-worlds", "none", "--out", str(out), "--steps", "100"]) == 0
    assert main(["--resume", "--out", str(out), "--steps", "140"]) == 0
    written = events.EventAccumulator(str(out / "tensorboard"), size_guidance={"scalars": 0}).Reload()
    near, far, total = (written.Scalars(tag) for tag in ("reward/near", "reward/far", "episode/return"))
    trajectories = [Trajectory.unpack(blob) for blob in Journal(out / "journal").read()]
    assert len(near) == len(total) == len(trajectories)
    for a, b, c, trajectory in zip(near, far, total, trajectories):
        assert a.value == pytest.approx(0.25 * trajectory.reward.sum(), abs=1e-4)
        assert a.value + b.value == pytest.approx(c.value, abs=1e-4)
    assert total[-1].step >= 140
    data = written.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    for name in (b"critic_lr", b"n_step", b"hidden"):
        assert name in data
    assert str(tmp_path).encode() not in data
    sessions = json.loads((out / "config.json").read_text())["provenance"]
    assert len(sessions) == 2
    assert {"date", "commit", "versions", "cpu", "seed", "command"} <= set(sessions[0])


@pytest.mark.parametrize("terms", [[1.0], {"a": "b"}, {"a\n": 1.0}, {str(n): 1.0 for n in range(101)}])
def test_terms_that_cannot_be_are_refused(terms):
    with pytest.raises(TrajectoryError, match="terms") as error:
        Trajectory(None, None, None, None, True, {"actor": "a", "episode": 0, "terms": terms}).check_info()
    assert "\n" not in str(error.value)
