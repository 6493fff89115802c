"""Training runs of the toy environment (toy_env.py), what they leave, and the one line with which they refuse."""

import re

from applr_ros1.common.tensors import unpack
from training.learner.learner import Learner
from training.replay.store import TrajectoryStore
from training.train import main

TOY = [
    *("--env", "tests.support.toy_env:Line", "--net-arch", "32", "32", "--batch-size", "32", "--utd-ratio", "0.5"),
    *("--eval-freq", "200", "--device=cpu", "--actor-lr=1e-3", "--decision-period=0.5"),
]
NO_EVALUATION = ["--eval-worlds", "none"]


def toy(out, *more):
    """Arguments of a run in the toy environment."""
    return [*TOY, "--out", str(out), *map(str, more)]


def state_of(folder):
    """Everything that learning goes on from, bit for bit, and every trajectory."""
    checkpoint = Learner.saved(folder)
    arrays, header = unpack((folder / checkpoint["learner"]["file"]).read_bytes(), "state")
    data = {name: array.tobytes() for name, array in arrays.items()}
    keys = ("transitions", "updates", "episodes", "rng", "pace")
    taken = [
        (number, t.info, t.terminated, *(array.tobytes() for array in (t.scan, t.rest, t.action, t.reward)))
        for number, t in TrajectoryStore(folder).trajectories()
    ]
    return data, header, {key: checkpoint[key] for key in keys}, taken


def one_line(capsys, arguments, pattern):
    """Asserts that train.py ends with one line on stderr that matches the pattern."""
    capsys.readouterr()
    assert main([str(a) for a in arguments]) > 0
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("train.py: ")]
    assert len(lines) == 1, lines
    assert re.search(pattern, lines[0]), lines[0]
