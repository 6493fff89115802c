"""A training run as a dataset for offline training: python -m training.dataset RUN FOLDER. --help lists the options."""

from __future__ import annotations

import argparse
import sys
from typing import List, Optional

from training.experience.dataset import DatasetError, export_replay
from training.experience.trajectory import TrajectoryError
from training.storage import StorageError


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. Exit status 0; 1 with one line on stderr when there is no dataset."""
    parser = argparse.ArgumentParser(prog="python -m training.dataset", description=__doc__)
    parser.add_argument("run", help="folder of the training run, --out of train.py")
    parser.add_argument("folder", help="empty folder for the dataset")
    parser.add_argument(
        "--c-switch",
        type=float,
        default=0.0,
        help="what changing the parameters costs in the dataset beyond what it cost in the run, in reward per mean "
        "change of an action unit (default: 0)",
    )
    options = parser.parse_args(arguments)
    try:
        manifest = export_replay(options.run, options.folder, c_switch=options.c_switch)
    except (DatasetError, StorageError, TrajectoryError) as error:
        print("error: %s" % error, file=sys.stderr)
        return 1
    print("%d transitions in %s" % (manifest["transitions"], options.folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
