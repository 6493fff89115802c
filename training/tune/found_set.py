"""Tuned parameter set: its files, the time that each parameter saves, and trials in worlds not used in the search."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Mapping, Sequence

import numpy as np
import yaml

from applr_ros1.common.files import write_bytes, write_json
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY
from training.env.settings import CHALLENGE
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.loaded import move_base_parameters
from training.evaluate.score import AIMS, Baseline
from training.evaluate.trial import BASELINE
from training.evaluate.verdict import SET, paired_trials
from training.tune.options import TuneOptions

if TYPE_CHECKING:
    import pandas as pd

HEAD = """# Parameters of move_base for {robot}, to be loaded after the robot's own files:
#   <rosparam file="{file}" command="load" ns="move_base"/>
# The distance biases below are per {unit}.
"""
UNITS = {
    TRAJECTORY: "costmap cell, as in C++\n# with `meter_scoring: false` (docs/howto/cpp_move_base.md)",
    "DWAPlannerROS": "metre, as in C++",
}


def write_set(robot: Robot, values: Mapping[str, Any], as_json: Path, as_yaml: Path) -> None:
    """Write a parameter set {name: value} as JSON for this package, and as YAML for any move_base."""
    head = HEAD.format(robot=robot.name, file=as_yaml.name, unit=UNITS[robot.local_planner])
    write_bytes(as_yaml, (head + yaml.safe_dump(move_base_parameters(robot, values))).encode())
    write_json(as_json, {"meter_scoring": False, "parameters": dict(values)})


def driven_unseen(options: TuneOptions, worlds: str, drives: Path, monitor: str) -> pd.DataFrame:
    """Evaluate the robot's default parameters and the tuned parameter set in `worlds`, and return the paired trials.

    Args:
        options: Options of the command.
        worlds: Worlds that the search did not use.
        drives: Folder with static.json, the tuned parameter set.
        monitor: "with" or "without" the collision monitor; also the name of the trials' folder in `drives`.
    """
    robot = options.robot
    how: Dict[str, Any] = {name: getattr(options, name) for name in ("robot", "workers", "seed")}
    how.update(protocol=CHALLENGE, planner=CPP_LIKE, monitor=monitor == "with", loaded=True, trials=1)
    names = f"{BASELINE},{drives / 'static.json'}"
    results = evaluate(EvaluationOptions(**how, worlds=worlds, methods=names, out=str(drives / monitor)))
    baseline = Baseline.of([result for trial, result in results.items() if trial.method == BASELINE], robot)
    return paired_trials(results, (BASELINE, SET), partial(AIMS[options.for_].cost, robot=robot, baseline=baseline))


def changes(robot: Robot, values: Mapping[str, float], saved: Mapping[str, Sequence[float]]) -> pd.DataFrame:
    """Return a table of the changed parameters: both values, saving per course [s], and meaning.

    The saving of a parameter is the time lost per course if only this parameter is reverted to its default. A few
    failures change the mean saving and its 95 % confidence interval strongly, but not the median.

    Args:
        robot: Robot that was tuned.
        values: Tuned parameter set {name: value}.
        saved: {name: (mean, low, high, median)} of the savings (prune_parameters).
    """
    import pandas as pd

    space, servers, rows = space_of(robot), robot.servers, []
    defaults = space.as_dict(space.theta0)
    for name, value in values.items():
        target = space.targets[name][0]
        declared = servers[target.server].declared(target.name)
        assert declared is not None, "space_of refuses targets that no server declares"
        both = (f"{each:.4g} {declared.unit}".rstrip() for each in (defaults[name], value))
        rows.append((name, *both, *np.round(saved[name], 1), declared.doc))
    columns = ["parameter", "default", "tuned", "saving [s]", "95 % low", "95 % high", "median [s]", "meaning"]
    return pd.DataFrame(rows, columns=columns)
