"""Experience as a Minari dataset: what was collected comes back from Minari, and mistakes are one line."""

import numpy as np
import pytest

from training import export_minari
from training.replay.store import NAME, Store
from training.replay.trajectory import Layout, Trajectory

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")


@pytest.fixture
def run(tmp_path):
    """A run of three episodes, of which the second one was truncated."""
    rng, folder = np.random.default_rng(0), tmp_path / "run"
    folder.mkdir()
    store = Store(folder / NAME, Layout())
    for i in range(3):
        t, info = 2 + i, {"actor": "a", "episode": i}
        observations, actions = rng.uniform(-1, 1, (t + 1, 729)), rng.uniform(-1, 1, (t, 8))
        store.append(Trajectory.of(Layout(), observations, actions, rng.uniform(-1, 0, t), i != 1, info))
    store.close()
    return folder


def test_what_was_collected_comes_back(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export_minari, "AT_ONCE", 2)
    root = ["--root", str(tmp_path / "minari")]
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # restored afterwards
    assert export_minari.main([str(run), "jackal/applr-v0", *root]) == 0
    assert "jackal/applr-v0: 3 episodes, 9 steps" in capsys.readouterr().out
    dataset = minari.load_dataset("jackal/applr-v0")
    assert dataset.observation_space.shape == (729,)
    assert dataset.action_space.shape == (8,)
    episodes = list(dataset.iterate_episodes())
    assert [e.id for e in episodes] == [0, 1, 2]
    for episode, (_, trajectory) in zip(episodes, Store(run).trajectories()):
        np.testing.assert_array_equal(episode.observations, Layout().restore(trajectory.scan, trajectory.rest))
        np.testing.assert_array_equal(episode.actions, trajectory.action)
        np.testing.assert_allclose(episode.rewards, trajectory.reward)
        assert not episode.terminations[:-1].any()
        assert not episode.truncations[:-1].any()
        assert bool(episode.terminations[-1]) == trajectory.terminated != bool(episode.truncations[-1])
    for folder, name, words in (
        (run, "jackal/applr-v0", "already exist"),
        (run, "no name", "no name"),
        (tmp_path, "a-v0", "holds no trajectories"),
    ):
        capsys.readouterr()
        assert export_minari.main([str(folder), name, *root]) == 1
        line = capsys.readouterr().err
        assert words in line
        assert line.count("\n") == 1
