"""Tuned parameter set: its files, the effect of each parameter, and its verdicts."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Mapping, NamedTuple, Sequence

import numpy as np
import yaml

from applr_ros1.common.files import write_bytes, write_json
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters import obstacle_range
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.parameter_space import declaration
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY
from training.attempts.candidates import search_space
from training.attempts.loaded import move_base_parameters
from training.common.command_line import robot_name
from training.env.settings import CHALLENGE
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.runner import TrialWorld
from training.evaluate.score import AIMS, Baseline
from training.evaluate.trial import BASELINE
from training.evaluate.verdict import SET, ComparisonVerdict, paired_trials, verdict
from training.tune.options import TuneOptions
from training.tune.search import Effect
from worlds.world import clearance

if TYPE_CHECKING:
    import pandas as pd

# What to do if no file was written. The same command would find all of its trials in the table.
NEXT = (
    "The same command only prints this answer again: give a longer --minutes, which continues the "
    "search, or another --seed, which begins a new one."
)
# Why there is no tuned.yaml beside a static.json, and what to do
ONLY_WITH_MONITOR = (
    "There is no tuned.yaml for your own move_base alone, because the set is not clearly better "
    "without the collision monitor: start jackal_applr.launch with move_base:=cpp, which adds the "
    "monitor and static.json to your move_base, or give a longer --minutes."
)
HEAD = """# Parameters of move_base for {robot}, to be loaded after the robot's own files:
#   <rosparam file="{file}" command="load" ns="move_base"/>
# The distance biases below are per {unit}.
"""
UNITS = {
    TRAJECTORY: "costmap cell, as in C++\n"
    "# with `meter_scoring: false` (docs/howto/cpp_move_base.md)",
    "DWAPlannerROS": "metre, as in C++",
}


class Judgement(NamedTuple):
    """Verdict on one of the files of a tuned set.

    Attributes:
        file: Name of the file.
        monitor: "with" or "without" the collision monitor; also the name of the trials' folder.
        lines: Lines of the verdict.
        is_better: Whether the set is clearly better than the defaults.
        path: Where the file is.
    """

    file: str
    monitor: str
    lines: Sequence[str]
    is_better: bool
    path: Path


def write_set(robot: Robot, values: Mapping[str, Any], as_json: Path, as_yaml: Path) -> None:
    """Write a parameter set {name: value} as JSON for this package and as YAML for move_base.

    An obstacle range among the values is no live parameter: it stands beside them in the JSON file.
    """
    parameters = dict(values)
    set_content: Dict[str, Any] = {}
    needed_range = parameters.pop(obstacle_range.NAME, None)
    if needed_range is not None:
        set_content[obstacle_range.NAME] = needed_range
    write_json(as_json, {**set_content, "parameters": parameters})
    file_head = HEAD.format(robot=robot.name, file=as_yaml.name, unit=UNITS[robot.local_planner])
    start_up = move_base_parameters(robot, parameters, needed_range)
    write_bytes(as_yaml, (file_head + yaml.safe_dump(start_up)).encode())


def judged(options: TuneOptions, worlds: str, drives: Path, monitor: str) -> ComparisonVerdict:
    """Drive the default parameters and the tuned parameter set in `worlds`, and compare them.

    Args:
        options: Options of the command.
        worlds: Worlds that the search did not use.
        drives: Folder with static.json, the tuned parameter set.
        monitor: "with" or "without" the collision monitor; also the name of the trials' folder in
            `drives`.
    """
    robot = options.robot
    aim = AIMS[options.for_]
    rules: Dict[str, Any] = {"protocol": CHALLENGE, "planner": CPP_LIKE}
    evaluation = EvaluationOptions(
        **rules,
        robot=robot,
        workers=options.workers,
        seed=options.seed,
        monitor=monitor == "with",
        loaded=True,
        trials=1,
        worlds=worlds,
        methods=f"{BASELINE},{drives / 'static.json'}",
        out=str(drives / monitor),
    )
    results = evaluate(evaluation)
    # The costs of both methods are relative to the drives with the default parameters.
    by_default = []
    for trial, result in results.items():
        if trial.method == BASELINE:
            by_default.append(result)
    cost = partial(aim.cost, robot=robot, baseline=Baseline.of(by_default, robot))
    return verdict(paired_trials(results, (BASELINE, SET), cost), aim.rule)


def scope(
    options: TuneOptions, searched: Sequence[TrialWorld], unseen: Sequence[TrialWorld]
) -> str:
    """Return a line: in which worlds the set was searched and is judged, and how narrow they are.

    Args:
        options: Options of the command.
        searched: Worlds of the search, from world_list().
        unseen: Worlds of the verdicts.
    """
    robot = options.robot
    footprint = MoveBase(robot.parameters()).local_costmap.footprint
    _, footprint_width = np.ptp(footprint, axis=0)
    scope_line = (
        f"searched on {len(searched)} courses of {options.worlds}, {_nearest(searched)}; judged "
        f"on {len(unseen)} others, {_nearest(unseen)}; "
        f"half of the padded footprint's width is {footprint_width / 2:.2f} m"
    )
    if ".yaml" in options.worlds:
        return scope_line
    command = f"./applr tune {robot_name(robot)} --worlds MAP.yaml"
    return f"{scope_line}\nfor a building and its doors: {command}"


def _nearest(worlds: Sequence[TrialWorld]) -> str:
    """Return in words how near [m] obstacles come to the middle of the reference paths.

    A path need not lead through the middle of a passage, whose width ./applr check reports.
    """
    distances = [clearance(world, world.course.path).min() for _, _, world in worlds]
    return f"with obstacles {min(distances):.2f} to {max(distances):.2f} m beside the path"


def changes(
    robot: Robot, values: Mapping[str, float], effects: Mapping[str, Effect]
) -> pd.DataFrame:
    """Return a table of the changed parameters: both values, effect on the cost, and meaning.

    Args:
        robot: Robot that was tuned.
        values: Tuned parameter set {name: value}.
        effects: Effects of the parameters (prune_parameters). One is called a saving only if its
            interval lies above 0.
    """
    import pandas as pd

    space = search_space(robot)
    defaults = space.as_dict(space.theta0)
    rows = []
    for parameter_name, tuned_value in values.items():
        declared = obstacle_range.DECLARED
        if parameter_name != obstacle_range.NAME:
            declared = declaration(robot, parameter_name)
        effect = effects[parameter_name]
        row = {
            "parameter": parameter_name,
            "default": f"{defaults[parameter_name]:.4g} {declared.unit}".rstrip(),
            "tuned": f"{tuned_value:.4g} {declared.unit}".rstrip(),
            "without it [s]": round(effect.mean, 1),
            "95 % low": round(effect.low, 1),
            "95 % high": round(effect.high, 1),
            "median [s]": round(effect.median, 1),
            "effect": "saves" if effect.is_saving else "unclear",
            "meaning": declared.doc,
        }
        rows.append(row)
    return pd.DataFrame(rows)
