"""Damaged files of evaluations, datasets and training runs: every reader ends with one line that
begins with the name of the file.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from tests.support import ROOT
from tests.support.damages import named_pipe, written
from tests.support.refusals import refused
from tests.support.training import episode
from training.env.trajectory import TransitionLayout
from training.evaluate.periodic import PeriodicEvaluation
from training.evaluate.stored import Results
from training.evaluate.table import TrialTable, read_trace, trace_name
from training.train.learner.config import LearnerOptions, parse
from training.train.learner.learner import Learner
from training.train.replay import dataset

LAYOUT = TransitionLayout(0, 1, 1)
LEARNER_OPTIONS = LearnerOptions(net_arch=[8], batch_size=8)
TRACE = f"traces/{trace_name('w', 'm', 0)}"
EPISODES = "data/main_data.hdf5"
STATE = "learner-000001.pt"
REPLAY = "replay-000001.safetensors"


def learner(folder):
    """Return a learner that continues from the checkpoint in a folder, if there is one."""
    return Learner(LAYOUT, LEARNER_OPTIONS, folder, 50)


@pytest.fixture
def whole(tmp_path):
    """Provide a folder with the files of an evaluation, a dataset and a run."""
    for name in ("evaluation.json", "trials.csv"):
        shutil.copy(ROOT / "tests/golden/evaluation" / name, tmp_path)
    (tmp_path / "traces").mkdir()
    (tmp_path / "evaluations.jsonl").write_text('{"round": 1, "best": true}\n')
    (tmp_path / "config.json").write_text("{}")
    trajectories = [episode(LAYOUT, number, 10) for number in range(2)]
    dataset.write(tmp_path, LAYOUT, trajectories, {})
    saved_learner = learner(tmp_path)
    for trajectory in trajectories:
        saved_learner.add_trajectory(trajectory)
    saved_learner.save()
    return tmp_path


def is_read(folder):
    """Read all files of a folder but the traces and config.json."""
    results = Results(folder)
    with TrialTable(folder, {}):
        pass
    rounds = PeriodicEvaluation(folder, [], 1, 0, True).history
    episodes = list(dataset.Dataset(folder).trajectories())
    return bool(results.worlds and rounds and episodes and learner(folder).replay.written)


READERS = {
    "evaluation.json": Results,
    "trials.csv": Results,
    TRACE: lambda folder: read_trace(folder, "w", "m", 0),
    "evaluations.jsonl": lambda folder: PeriodicEvaluation(folder, [], 1, 0, True),
    "config.json": lambda folder: parse(["--resume", "--out", str(folder)]),
    "data/metadata.json": dataset.Dataset,
    EPISODES: lambda folder: list(dataset.Dataset(folder).trajectories()),
    "checkpoint.json": learner,
    STATE: learner,
    REPLAY: learner,
}


def infinite_reward(path):
    """Put an infinite reward into the rows of a replay buffer."""
    rows = safetensors.numpy.load_file(path)
    rows["reward"][0] = np.inf
    safetensors.numpy.save_file(rows, path)


@pytest.mark.parametrize(
    ("file_name", "damage", "problem"),
    [
        *((file_name, written("no\x00thing\n"), "damaged") for file_name in READERS),
        *((file_name, named_pipe, "a pipe or device") for file_name in READERS),
        ("evaluation.json", written("[1]"), "damaged"),
        ("evaluation.json", written("{}"), "cannot be read; "),
        ("trials.csv", written("world,method\na,b\n"), "damaged"),
        ("config.json", written("[1]"), "damaged"),
        ("data/metadata.json", written("{}"), "cannot be read; "),
        ("checkpoint.json", written('{"number": 1}'), "cannot be read; "),
        (REPLAY, infinite_reward, "tensor reward has NaN or infinite numbers"),
    ],
)
def test_a_damaged_file_is_one_line_that_begins_with_its_name(file_name, damage, problem, whole):
    damaged_file = Path(whole, file_name)
    damage(damaged_file)
    line = refused(lambda: READERS[file_name](whole), problem)
    assert line.startswith(f"{damaged_file}: ")
    assert line.count(str(damaged_file)) == 1


def test_whole_files_are_read(whole):
    assert is_read(whole)
