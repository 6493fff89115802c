"""Stand-in for the runner of trials, for tests of evaluate.py: draws a result with the task's seed, after a short wait.

Methods named "bad..." fail.
"""

import os
import time
import zlib

import numpy as np

from training.evaluate.evaluation import EvaluationOptions, settings
from training.evaluate.trial import Result

SETTINGS = settings(
    EvaluationOptions(), [], []
)  # settings of an evaluation without worlds and methods


def drive(settings, task):
    """Return a drawn result, with the interface of training.evaluate.runner.run."""
    if os.environ.get("TOY_BROKEN"):
        raise ValueError("the toy is broken; mend it")
    rng = np.random.default_rng([task.seed, zlib.crc32(task.method.encode())])
    time.sleep(float(os.environ.get("TOY_SECONDS", "0.01")) * rng.uniform(0.2, 1.8))
    if task.method.startswith("bad"):
        raise ValueError("the toy will not; take another")
    success = rng.random() < 0.9
    seconds = rng.normal(27.0 if task.method == "dwa" else 20.0, 5.0) if success else 100.0
    result = Result(
        success=bool(success),
        collided=bool(rng.random() < 0.1),
        timeout=not success,
        time_s=float(seconds),
        decisions=int(seconds // 2) + 1,
        path_length_m=float(rng.uniform(6, 8)),
        reason="finished" if success else "time limit",
        route_m=7.0,
        min_clearance_m=float(rng.uniform(0.1, 0.5)),
        mean_jerk=8.0,
        mean_turn=1.5,
        switching=0.1,
    )
    return result, b""
