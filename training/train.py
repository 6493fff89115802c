"""Training with one command: `python -m training.train`, or `rosrun applr_ros1 train.py`.

Online, actors drive episodes and one learner learns from them (the paper's Gorila architecture). Offline, the learner
learns from a dataset. The run's folder holds config.json, checkpoint.json with learner-*.safetensors, replay.sqlite
with all trajectories, actor.safetensors and best.safetensors, evaluations.jsonl, curves.png and tensorboard/.
docs/howto/training.md describes all of it.
"""

from __future__ import annotations

import sys
from typing import List, Optional

from applr_ros1.common.errors import run_main
from applr_ros1.common.extras import extra

with extra(__name__):
    from training.learner.config import parse
    from training.learner.run import TrainingRun


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. 0: done; 1: a mistake, or a run that could not go on; 130: stopped and saved."""
    return run_main(lambda: TrainingRun(parse(arguments)).run(), "train.py")


if __name__ == "__main__":
    sys.exit(main())
