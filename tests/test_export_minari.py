"""Experience as a Minari dataset: what was collected comes back from Minari, and mistakes are one line."""

import json

import numpy as np
import pytest

from training import export_minari
from training.experience.dataset import FORMAT, export_replay
from training.experience.journal import Journal
from training.experience.trajectory import Layout, Trajectory

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")


@pytest.fixture
def run(tmp_path):
    """A run of three episodes, of which the second one was truncated."""
    rng = np.random.default_rng(0)
    journal = Journal(tmp_path / "run" / "journal")
    for i in range(3):
        t, info = 2 + i, {"actor": "a", "episode": i}
        observations, actions = rng.uniform(-1, 1, (t + 1, 729)), rng.uniform(-1, 1, (t, 8))
        journal.append(Trajectory.of(Layout(), observations, actions, rng.uniform(-1, 0, t), i != 1, info).pack(), {})
    journal.sync()
    return tmp_path / "run"


def test_what_was_collected_comes_back(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export_minari, "AT_ONCE", 2)
    root = ["--root", str(tmp_path / "minari")]
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # restored afterwards
    assert export_minari.main([str(run), "jackal/applr-v0", *root]) == 0
    assert "jackal/applr-v0: 3 episodes, 9 steps" in capsys.readouterr().out
    export_replay(run, tmp_path / "data")
    assert export_minari.main([str(tmp_path / "data"), "jackal/copy-v1", *root]) == 0
    taken = [Trajectory.unpack(blob) for blob in Journal(run / "journal").read()]
    for name in ("jackal/applr-v0", "jackal/copy-v1"):
        dataset = minari.load_dataset(name)
        assert dataset.observation_space.shape == (729,)
        assert dataset.action_space.shape == (8,)
        episodes = list(dataset.iterate_episodes())
        assert [e.id for e in episodes] == [0, 1, 2]
        for episode, trajectory in zip(episodes, taken):
            np.testing.assert_array_equal(episode.observations, Layout().restore(trajectory.scan, trajectory.rest))
            np.testing.assert_array_equal(episode.actions, trajectory.action)
            np.testing.assert_allclose(episode.rewards, trajectory.reward)
            assert not episode.terminations[:-1].any()
            assert not episode.truncations[:-1].any()
            assert (bool(episode.terminations[-1]), bool(episode.truncations[-1])) == (
                trajectory.terminated,
                not trajectory.terminated,
            )
    spoilt = tmp_path / "spoilt"
    spoilt.mkdir()
    manifest = {"format": FORMAT, "layout": {"scan": "many", "rest": 9, "action": 8}}
    (spoilt / "manifest.json").write_text(json.dumps(manifest))
    for folder, name, words in (
        (run, "jackal/applr-v0", "already exist"),
        (run, "no name", "no name"),
        (tmp_path, "a-v0", "no dataset"),
        (spoilt, "a-v0", "whole numbers"),
    ):
        capsys.readouterr()
        assert export_minari.main([str(folder), name, *root]) == 1
        line = capsys.readouterr().err
        assert words in line
        assert line.count("\n") == 1


def test_another_robots_experience_has_its_own_layout(tmp_path, monkeypatch, capsys):
    """Of a run as of a dataset, whose layout is stated in it."""
    layout = Layout(360, 8, 7)
    trajectory = Trajectory.of(
        layout, np.zeros((3, 368)), np.full((2, 7), 0.5), np.zeros(2), True, {"actor": "a", "episode": 0}
    )
    journal = Journal(tmp_path / "run" / "journal")
    journal.append(trajectory.pack(), {})
    journal.sync()
    export_replay(tmp_path / "run", tmp_path / "data", layout)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # restored afterwards
    for source in ("run", "data"):
        words = [str(tmp_path / source), "burger/%s-v0" % source, "--root", str(tmp_path / "minari")]
        assert export_minari.main(words) == 0, capsys.readouterr().err
        dataset = minari.load_dataset("burger/%s-v0" % source)
        assert (dataset.observation_space.shape, dataset.action_space.shape) == ((368,), (7,))
        np.testing.assert_array_equal(dataset[0].actions, trajectory.action)
