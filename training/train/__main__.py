"""Trains a policy with one command: `./applr train`.

`rosrun applr_ros1 train.py` and `python -m training.train` are the same.

Online, actors drive episodes and one learner learns from them (the paper's Gorila architecture).
Offline, the learner learns from a dataset. See docs/howto/training.md for the command, and
training/train/learner/run.py for the run.
"""

from __future__ import annotations

import sys
from typing import List, Optional

from applr_ros1.common.errors import run_main
from training.train.learner.config import parse


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the command.

    Returns:
        The exit status: 0 if done, 1 after a one-line error, 130 if the run was stopped and saved.
    """

    def run() -> int:
        config = parse(arguments)
        # Imported here, because --help must not wait for torch.
        from training.train.learner import several
        from training.train.learner.run import TrainingRun

        if config.seeds > 1:
            return several.train(config, TrainingRun)
        return TrainingRun(config).run()

    return run_main(run, "./applr train")


if __name__ == "__main__":
    sys.exit(main())
