"""Training with one command: `python -m training.train`, or `rosrun applr_ros1 train.py`.

Online, actors drive episodes and one learner learns from them (the paper's Gorila architecture). Offline, the learner
learns from a dataset. The run's folder holds config.json, checkpoint.json with learner-*.safetensors, journal/ with all
trajectories, actor.safetensors and best.safetensors, episodes.csv, evaluations.jsonl, curves.png and tensorboard/; with
--refine also refined.safetensors and refinement/. docs/training.md describes all of it.
"""

from __future__ import annotations

import shlex
import sys
from typing import List, Optional

from applr_ros1.common.errors import run_main
from training import refine_policy
from training.command_line import end_at_sigterm
from training.gorila.config import TrainConfig, parse
from training.gorila.run import TrainingRun


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. 0: done; 1: a run could not go on; 2: options that cannot be; 130: stopped and saved."""
    return run_main(lambda: train(parse(arguments)), "train.py")


def train(config: TrainConfig) -> int:
    """Trains, and refines the last policy when the training is finished. Returns the exit status."""
    status = TrainingRun(config).run()
    if status == 0 and config.refine:
        refine(refinement(config))
    return status


def refinement(config: TrainConfig) -> List[str]:
    """The arguments of training.refine_policy for the last policy of a run."""
    out, driven = config.out, config.evaluation()
    return [
        *(out + "/actor.safetensors", "--out", out + "/refined.safetensors", "--results", out + "/refinement"),
        *("--steps", str(config.refine), "--workers", str(max(1, config.actors)), "--seed", str(config.seed)),
        *("--robot", config.robot, "--simulator", driven["simulator"]),
        *("--weights", driven["weights"], "--planner", driven["planner"]),
        *("--contact-seconds", str(config.contact_seconds), *["--monitor"] * config.monitor),
    ]


def refine(arguments: List[str]) -> None:
    """Refines, and says with which command."""
    print("refining: python -m training.refine_policy %s" % shlex.join(arguments), flush=True)
    end_at_sigterm()
    try:
        refine_policy.run(arguments)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; --resume continues the refinement") from None


if __name__ == "__main__":
    sys.exit(main())
