"""Converts a training run to a dataset for offline training: `python -m training.dataset RUN FOLDER`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

from applr_ros1.common.errors import run_main
from applr_ros1.common.files import read_json
from applr_ros1.policy.observation import sizes_of
from applr_ros1.robots import JACKAL, load
from training.command_line import Parser, number
from training.experience.dataset import export_replay
from training.experience.trajectory import Layout


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. Exit status 0; 1 with one line on stderr when there is no dataset."""
    parser = Parser("python -m training.dataset", description=__doc__)
    parser.add_argument("run", help="Folder of the training run, --out of train.py.")
    parser.add_argument("folder", help="Empty folder for the dataset.")
    parser.add_argument(
        "--c-switch",
        type=number(-1e6, 1e6),
        default=0.0,
        help="Cost of changing the parameters that is charged in addition to the run's own reward.",
    )
    return run_main(lambda: _export(parser.parse_args(arguments)), "dataset")


def _export(options: argparse.Namespace) -> None:
    config = Path(options.run) / "config.json"
    robot = read_json(config).get("robot", JACKAL.name) if config.exists() else JACKAL.name
    layout = Layout(*sizes_of(load(robot)))
    manifest = export_replay(options.run, options.folder, layout, options.c_switch)
    print("%d transitions in %s" % (manifest["transitions"], options.folder))


if __name__ == "__main__":
    sys.exit(main())
