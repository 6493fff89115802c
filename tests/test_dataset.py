"""training.dataset: a training run becomes a dataset for offline training."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

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
    without_torch = "import sys; sys.modules['torch'] = None; from training.dataset import main; sys.exit(main())"
    command = [sys.executable, "-c", without_torch, str(tmp_path / "run"), str(tmp_path / "dear")]
    done = subprocess.run([*command, "--c-switch", "0.5"], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert "9 transitions" in done.stdout, done.stderr
    for mine, theirs in zip(Dataset(tmp_path / "dear"), episodes):
        price = 0.5 * np.abs(theirs.action - theirs.rest[:-1, 1:]).mean(1)
        np.testing.assert_allclose(mine.reward, theirs.reward - price, atol=1e-6)
        np.testing.assert_array_equal(mine.action, theirs.action)
    assert dataset.main([str(tmp_path), str(tmp_path / "none")]) == 1
    assert capsys.readouterr().err.strip() == "dataset: %s: no training run (no journal in it)" % tmp_path
    segment = tmp_path / "run" / "journal" / "000000.segment"
    segment.write_bytes(b"x" + segment.read_bytes()[1:])
    assert dataset.main([str(tmp_path / "run"), str(tmp_path / "none")]) == 1
    assert "000000.segment: its beginning is damaged" in capsys.readouterr().err
    assert segment.stat().st_size > 1000
    assert not (tmp_path / "none" / "manifest.json").exists()


@pytest.mark.parametrize("env", [None, "tests.toy_env:Line"])
def test_a_run_as_a_dataset_of_its_own_layout_says_what_it_was_driven_with(env, tmp_path, capsys):
    run, layout = tmp_path / "run", Layout(0, 1, 1) if env else Layout()
    zeros = np.zeros((3, layout.size)), np.zeros((2, layout.action)), np.zeros(2)
    (run / "journal").mkdir(parents=True)
    config = {"period": 0.5, "weights": "per_metre", "robot": "jackal", **({"env": env} if env else {})}
    (run / "config.json").write_text(json.dumps(config))
    assert dataset.main([str(run), str(tmp_path / "data")]) == 1
    assert capsys.readouterr().err == "dataset: %s: no episode is in its journal; train first\n" % run
    journal = Journal(run / "journal")
    journal.append(Trajectory.of(layout, *zeros, True, {"actor": "a", "episode": 0}).pack(), {})
    journal.sync()
    assert dataset.main([str(run), str(tmp_path / "data")]) == 0
    found = Dataset(tmp_path / "data", layout).check()
    known = {name: found.source.get(name) for name in ("period", "weights", "robot")}
    assert known == ({"period": 0.5, "weights": None, "robot": None} if env else config)
    if env:
        assert dataset.main([str(run), str(tmp_path / "dear"), "--c-switch", "1"]) == 1
        assert "--c-switch is for runs of the navigation task" in capsys.readouterr().err
