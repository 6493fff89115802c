"""An evaluation: its options, the settings stored in its folder, and the trials still to be driven."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Dict, Literal, Sequence, Tuple

from pydantic import ConfigDict
from tqdm import tqdm

from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots.geometry import radius
from training.common.command_line import RayAddress, Seed, SimulatorName, Workers
from training.common.options import option
from training.common.provenance import provenance
from training.env.settings import PAPER, DriveSettings, TrialSettings
from training.evaluate.drive import drive
from training.evaluate.runner import content, content_of_worlds, run, world_list
from training.evaluate.table import Trials
from training.evaluate.trial import Result, Trial, plan_trials
from training.workers.pool import Pool
from worlds import World
from worlds.loading import SPECIFICATIONS


class EvaluationOptions(DriveSettings):
    """Options of an evaluation."""

    model_config = ConfigDict(title=None)

    # fmt: off
    worlds: str = option("generated:test", f"Worlds to drive in: {SPECIFICATIONS}; several are separated by commas.")
    methods: str = option("dwa,applr", f"Methods to compare, separated by commas: {methods.SPECIFICATIONS}.")
    trials: int = option(20, "Number of trials of each method in each world.", ge=1, le=100_000)
    simulator: SimulatorName = "pybullet"
    protocol: Literal["paper", "barn-challenge"] = option(PAPER,
        "Course and rules of a trial. paper: the paper's course; a contact does not end the trial. barn-challenge: "
        "the BARN Challenge's course of 10 m; a contact ends the trial.")
    loaded: bool = option(False,
        "Start move_base with the parameter set of a static method, as with a parameter file on a robot, instead of "
        "setting it by reconfigure.")
    workers: Workers
    ray_address: RayAddress
    out: str = option("results",
        "Folder for trials.csv, tables and figures. An existing evaluation in it is continued.")
    seed: Seed
    traces: int = option(1,
        "Number of trials per method and world whose driven path is stored.", ge=0, le=1000)
    report: bool = option(True, "Write tables and figures of the trials.")
    # fmt: on


def evaluate(options: EvaluationOptions) -> Dict[Trial, Result]:
    """Drive the planned trials that the folder options.out does not hold, and return all planned results.

    Raises:
        ApplrError: A trial raised an error, or the folder cannot be used. Trials driven so far are kept.
    """
    began = time.monotonic()
    worlds = world_list(options.worlds, options.protocol, options.robot)
    chosen = methods.parse(options.methods)
    names = [world[:2] for world in worlds]
    plan = plan_trials(names, chosen, options.trials, options.seed, options.traces)
    driven_with = {name: getattr(options, name) for name in (*DriveSettings.model_fields, "loaded")}
    runner = partial(run, TrialSettings(**driven_with))

    def show(trial: Trial, result: Result) -> None:
        bar.update()
        how = f"{result.time_s:.1f} s" if result.success else result.reason
        bar.set_postfix_str(f"{trial.world} {trial.method} {how}", refresh=False)

    with Trials(options.out, settings(options, worlds, chosen)) as table:
        done = sum(table.find(trial) is not None for trial in plan)
        workers = min(options.workers, len(plan) - done)
        bar = tqdm(total=len(plan), initial=done, unit="trial", dynamic_ncols=True, smoothing=0.05)
        try:
            with bar, Pool(workers, options.ray_address) as pool:
                return drive(pool, runner, table, plan, show)
        finally:
            if done < len(plan):
                seconds = time.monotonic() - began
                session = dict(
                    provenance(options.seed), trials=table.added, wall_s=round(seconds, 1)
                )
                table.note(
                    wall_s=round(table.notes.get("wall_s", 0.0) + seconds, 1),
                    provenance=[*table.notes.get("provenance", []), session],
                )
            table.order(plan)


def settings(
    options: EvaluationOptions,
    worlds: Sequence[Tuple[str, str, World]],
    chosen: Sequence[Tuple[str, str]],
) -> Dict[str, Any]:
    """Return the settings in evaluation.json. They must not change when an evaluation is continued."""
    robot = options.robot
    made = {name: methods.make(spec, robot) for name, spec in chosen}
    return {
        "worlds": [name for name, _, _ in worlds],
        "worlds_with_movers": [name for name, _, world in worlds if world.movers],
        "worlds_sha256": content_of_worlds(worlds),
        "world_specs": [spec for _, spec, _ in worlds],
        "methods": {
            name: {**method.describe(), "period_s": method.period} for name, method in made.items()
        },
        "robot": {
            "name": robot.name,
            "body": list(robot.body.size[:2]),  # length and width [m]
            "radius": radius(robot),
            "world_scale": robot.world_scale,
            "space": space_of(robot).to_dict(),
            "sha256": content(robot),
        },
        **{name: getattr(options, name) for name in ("simulator", "protocol", "monitor", "movers")},
        "planner": options.planner + ", started with the sets" * options.loaded,
        "ground": robot.simulation.ground,
        "seed": options.seed,
    }
