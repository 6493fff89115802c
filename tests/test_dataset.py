"""training.dataset: a training run becomes a dataset for offline training."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from training import dataset
from training.experience.dataset import Dataset
from training.experience.journal import Journal
from training.experience.trajectory import Layout, Trajectory

ROOT = Path(__file__).resolve().parents[1]


def test_a_run_as_a_dataset_with_another_price_on_changes(tmp_path, capsys):
    rng = np.random.default_rng(0)
    journal, episodes = Journal(tmp_path / "run" / "journal"), []
    for i in range(3):
        t = 2 + i
        episodes.append(
            Trajectory.of(
                Layout(),
                rng.uniform(-1, 1, (t + 1, 729)),
                rng.uniform(-1, 1, (t, 8)),
                rng.uniform(-1, 0, t),
                True,
                {"actor": "a", "episode": i},
            )
        )
        journal.append(episodes[-1].pack(), {})
    journal.sync()
    command = [sys.executable, "-m", "training.dataset", str(tmp_path / "run"), str(tmp_path / "dear")]
    done = subprocess.run([*command, "--c-switch", "0.5"], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert "9 transitions" in done.stdout, done.stderr
    for mine, theirs in zip(Dataset(tmp_path / "dear"), episodes):
        price = 0.5 * np.abs(theirs.action - theirs.rest[:-1, 1:]).mean(1)
        np.testing.assert_allclose(mine.reward, theirs.reward - price, atol=1e-6)
        np.testing.assert_array_equal(mine.action, theirs.action)
    assert dataset.main([str(tmp_path), str(tmp_path / "none")]) == 1
    assert capsys.readouterr().err.strip() == "dataset: %s: no training run (no journal in it)" % tmp_path
