"""Training with one command: `python -m training.train`, or `rosrun applr_ros1 train.py`.

Online, actors drive episodes and one learner learns from them (the paper's Gorila architecture). Offline, the learner
learns from a dataset. The run's folder holds config.json, checkpoint.json with learner-*.safetensors, journal/ with all
trajectories, actor.safetensors and best.safetensors, episodes.csv, evaluations.jsonl, curves.png and tensorboard/; with
--partner also partner/ and mean.safetensors, with --refine refined.safetensors and refinement/. docs/training.md
describes all of it.
"""

from __future__ import annotations

import sys
from typing import List, Optional

from applr_ros1.common.errors import run_main
from training.afterwards import last_policy, partner_of, refine, what_follows
from training.gorila.config import TrainConfig, parse
from training.gorila.run import TrainingRun


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. 0: done; 1: a run could not go on; 2: options that cannot be; 130: stopped and saved."""
    return run_main(lambda: train(parse(arguments)), "train.py")


def train(config: TrainConfig) -> int:
    """Trains, with a partner and a refinement where they are asked for. Returns the exit status."""
    partner = partner_of(config)
    if following := what_follows(config, partner):
        print(following, flush=True)
    status = TrainingRun(config).run()
    if status == 0 and partner:
        print("training the partner: %s" % partner.out, flush=True)
        status = TrainingRun(partner).run()
    if status == 0:
        policy = last_policy(config, partner)
        if config.refine:
            refine(config, policy)
    return status


if __name__ == "__main__":
    sys.exit(main())
