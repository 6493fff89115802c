"""Converts a training run to a dataset for offline training: `python -m training.dataset RUN FOLDER`."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any, Dict, List, Optional

from applr_ros1.common.errors import UsageError, run_main
from applr_ros1.common.files import read_json
from applr_ros1.robots import JACKAL, load
from training.command_line import Parser, number
from training.experience.dataset import DatasetError, export_replay
from training.mdp.reward import Reward
from training.mdp.rollout import NAVIGATION


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. Exit status 0; 1 with one line on stderr when there is no dataset."""
    parser = Parser("python -m training.dataset", description=__doc__)
    parser.add_argument("run", help="Folder of the training run, --out of train.py.")
    parser.add_argument("folder", help="Empty folder for the dataset.")
    parser.add_argument(
        "--c-switch",
        type=number(-1e6, 1e6),
        default=0.0,
        help="Cost of changing the parameters that is charged in addition to the run's own reward. Default: 0.",
    )
    return run_main(lambda: _export(parser.parse_args(arguments)), "dataset")


def _export(options: argparse.Namespace) -> None:
    path = Path(options.run) / "config.json"
    config = read_json(path) if path.exists() else {}
    if not isinstance(config, dict):
        raise DatasetError("%s: not an options file" % path)
    ours = config.get("env", NAVIGATION) == NAVIGATION
    if options.c_switch and not ours:
        raise UsageError(
            "--c-switch is for runs of the navigation task, this one is of %s: leave it out" % config["env"]
        )
    manifest = export_replay(
        options.run, options.folder, c_switch=options.c_switch, driven=_driven(config, ours) if config else None
    )
    print("%d transitions in %s" % (manifest["transitions"], options.folder))


def _driven(config: Dict[str, Any], ours: bool) -> Dict[str, Any]:
    """What a run's options say about its driving: of an environment that is not ours no more than the period."""
    found = {name: config[name] for name in ("period", *["weights"] * ours) if name in config}
    if not ours:
        return found
    reward = {f.name: config[f.name] for f in fields(Reward) if f.name in config}
    return {**found, "robot": load(config.get("robot", JACKAL.name)).name, "reward": reward}


if __name__ == "__main__":
    sys.exit(main())
