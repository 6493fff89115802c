"""An evaluation: its options, the settings in its folder, and the trials still to be driven."""

from __future__ import annotations

import inspect
import logging
import time
from functools import partial
from typing import Any, Dict, Literal, Sequence, Tuple

import numpy as np
from pydantic import ConfigDict
from tqdm import tqdm

from applr_ros1.common.files import read_bytes, sha256
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots.geometry import outline, radius
from training.common.command_line import RayAddress, Seed, SimulatorName, Workers
from training.common.options import option
from training.common.provenance import provenance
from training.env.settings import PAPER, DriveSettings, TrialSettings
from training.evaluate.drive import drive
from training.evaluate.runner import TrialWorld, content, content_of_worlds, run, world_list
from training.evaluate.table import TrialTable
from training.evaluate.trial import Result, Trial, plan_trials
from training.workers.pool import Pool
from worlds.loading import SPECIFICATIONS

# Options that a continued evaluation must have again
CONDITIONS = {
    "simulator",
    "protocol",
    "planner",
    "loaded",
    "monitor",
    "matched",
    "movers",
    "seed",
}
_LOGGER = logging.getLogger(__name__)


class EvaluationOptions(DriveSettings):
    """Options of an evaluation."""

    model_config = ConfigDict(title=None)

    # fmt: off
    worlds: str = option("generated:test",
        f"Worlds to drive in: {SPECIFICATIONS}; several are separated by commas.")
    methods: str = option("dwa,applr",
        f"Methods to compare, separated by commas: {methods.SPECIFICATIONS}.")
    trials: int = option(20,
        "Number of trials of each method in each world.", ge=1, le=100_000)
    simulator: SimulatorName = "pybullet"
    protocol: Literal["paper", "barn-challenge"] = option(PAPER,
        "Course and rules of a trial. paper: the paper's course; a contact does not end the "
        "trial. barn-challenge: the BARN Challenge's course of 10 m; a contact ends the trial.")
    planner: Literal["ours", "cpp-like"] = option("ours",
        "Planner fidelity. ours: this package's planner. cpp-like: with the defects of the C++ "
        "move_base that affect success.")
    loaded: bool = option(False,
        "Start move_base with the parameter set of a static method, as with a parameter file on a "
        "robot, instead of setting it by reconfigure.")
    workers: Workers
    ray_address: RayAddress
    out: str = option("results",
        "Folder for trials.csv, tables and figures. An existing evaluation in it is continued.")
    seed: Seed
    traces: int = option(1,
        "Number of trials per method and world whose driven path is stored when they are driven.",
        ge=0, le=1000)
    report: bool = option(True, "Write tables and figures of the trials.")
    # fmt: on


def evaluate(options: EvaluationOptions) -> Dict[Trial, Result]:
    """Drive the planned trials that the folder options.out lacks, and return all planned results.

    Raises:
        ApplrError: A trial raised an error, or the folder cannot be used. Trials driven so far are
            kept.
    """
    began = time.monotonic()
    worlds = world_list(options.worlds, options.protocol, options.robot)
    chosen = methods.parse(options.methods)
    plan = plan_trials(worlds, chosen, options.trials, options.seed, options.traces)
    common = {*DriveSettings.model_fields, "loaded"}
    runner = partial(run, TrialSettings(**options.model_dump(include=common)))

    def show(trial: Trial, result: Result) -> None:
        bar.update()
        end = f"{result.time_s:.1f} s" if result.success else result.reason
        bar.set_postfix_str(f"{trial.world} {trial.method} {end}", refresh=False)

    with TrialTable(options.out, settings(options, worlds, chosen)) as table:
        missing = len(table.missing(plan))
        done = len(plan) - missing
        _LOGGER.info("%d trials to drive, %d left out: in the table", missing, done)
        if not missing:
            table.order(plan)
            return {trial: table.result(trial) for trial in plan}
        bar = tqdm(total=len(plan), initial=done, unit="trial", dynamic_ncols=True, smoothing=0.05)
        try:
            with bar, Pool(min(options.workers, missing), options.ray_address) as pool:
                return drive(pool, runner, table, plan, show)
        finally:
            # Also after Ctrl-C: the report adds up the time of all sessions.
            session = provenance(options.seed)
            session["trials"] = table.added
            session["wall_s"] = round(time.monotonic() - began, 1)
            table.note(
                wall_s=round(table.notes.get("wall_s", 0.0) + session["wall_s"], 1),
                provenance=[*table.notes.get("provenance", []), session],
            )
            table.order(plan)


def settings(
    options: EvaluationOptions,
    worlds: Sequence[TrialWorld],
    chosen: Sequence[Tuple[str, str]],
) -> Dict[str, Any]:
    """Return the settings in evaluation.json.

    A continued evaluation must have the same ones.
    """
    robot = options.robot
    described = {}
    for name, specification in chosen:
        method = methods.make(specification, robot)
        is_loaded = options.loaded and method.static
        described[name] = {
            **method.describe(),
            "period_s": method.period,
            "obstacle_range": method.obstacle_range,
            "redraws_stalled": method.redraws_stalled and not is_loaded,
        }
        if methods.USER_METHOD.match(specification):
            source = inspect.getsourcefile(type(method))
            described[name]["source_sha256"] = sha256(read_bytes(source)) if source else ""
    # The worlds depend on the robot and the protocol: those are named first if they differ.
    return {
        "robot": {
            "name": robot.name,
            "outline": np.round(outline(robot), 3).tolist(),  # corners [m]
            "radius": radius(robot),
            "world_scale": robot.world_scale,
            "space": space_of(robot).to_dict(),
            "sha256": content(robot),
        },
        **options.model_dump(include=CONDITIONS),
        "ground": robot.simulation.ground,
        "worlds": [listed.name for listed in worlds],
        "world_specs": [listed.specification for listed in worlds],
        "worlds_with_movers": [listed.name for listed in worlds if listed.world.movers],
        "worlds_sha256": content_of_worlds(worlds),
        "methods": described,
    }
