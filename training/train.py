"""Training with one command: `python -m training.train`, or `rosrun applr_ros1 train.py`.

Online, actors drive episodes and one learner learns from them (the paper's Gorila architecture). Offline, the learner
learns from a dataset. The run's folder holds config.json, checkpoint.json with learner-*.safetensors, replay.sqlite
with all trajectories, actor.safetensors and best.safetensors, evaluations.jsonl, curves.png and tensorboard/; with
--refine also refined.safetensors and refinement/. docs/howto/training.md describes all of it.
"""

from __future__ import annotations

import os
import shlex
import sys
from typing import List, Optional

from applr_ros1.common.errors import run_main
from training import refine_policy
from training.common.command_line import end_at_sigterm
from training.learner.config import TrainConfig, parse
from training.learner.run import TrainingRun


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. 0: done; 1: a mistake, or a run that could not go on; 130: stopped and saved."""
    return run_main(lambda: train(parse(arguments)), "train.py")


def train(config: TrainConfig) -> int:
    """Trains, and refines the policy where that is asked for. Returns the exit status."""
    status = TrainingRun(config).run()
    if status == 0 and config.refine:
        refine(config)
    return status


def refine(config: TrainConfig) -> None:
    """Refines the last policy of the run with training.refine_policy, and says with which command.

    Raises:
        ApplrError: with one line; what was driven so far is kept.
    """
    out, workers = config.out, max(1, config.actors)
    if config.ray_address:  # the actors may be a cluster's, the refinement drives on this machine alone
        workers = min(workers, len(os.sched_getaffinity(0)))
    arguments = [
        *(out + "/actor.safetensors", "--out", out + "/refined.safetensors", "--results", out + "/refinement"),
        *("--steps", str(config.refine), "--workers", str(workers), "--seed", str(config.seed)),
        *("--robot", config.robot, "--simulator", config.simulator, "--planner", config.eval_planner),
        *["--monitor"] * config.monitor,
    ]
    print(f"refining: python -m training.refine_policy {shlex.join(arguments)}", flush=True)
    end_at_sigterm()
    try:
        refine_policy.run(arguments)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; --resume continues the refinement") from None


if __name__ == "__main__":
    sys.exit(main())
