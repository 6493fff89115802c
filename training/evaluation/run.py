"""Drives methods x worlds x trials in a pool of workers, into a folder that can be continued. evaluate.py calls it."""

from __future__ import annotations

import hashlib
import time
from contextlib import closing
from functools import partial
from pkgutil import resolve_name
from typing import Any, Callable, Dict, Iterable, Literal, Optional, Sequence, Tuple

from tqdm import tqdm

from applr_ros1.policy import methods
from applr_ros1.robots import on_ground
from training.actors.pool import make_pool
from training.common import command_line
from training.common.options import Options, option
from training.common.provenance import provenance
from training.env.settings import TrialSettings
from training.evaluation.plan import Trial, TrialResult, plan_trials
from training.evaluation.store import TrialStore
from training.evaluation.trials import TRIAL_RUNNER, described, drive_missing, world_list
from worlds import World


class EvaluationOptions(Options):
    """What to evaluate."""

    # fmt: off
    worlds: command_line.WorldNames = "generated:test"
    robot: command_line.AnyRobot
    methods: str = option("dwa,applr", f"Methods to compare, separated by commas: {methods.FORMS}.")
    trials: int = option(20, "Number of trials of each method in each world.", ge=1, le=100_000)
    simulator: command_line.SimulatorName = "pybullet"
    protocol: command_line.ProtocolName
    planner: command_line.Planner
    monitor: command_line.Monitor
    movers: command_line.Movers
    ground: Literal["", "plain", "gazebo"] = option("",
        "Simulated ground: plain, where tyres grip equally in all directions, or gazebo, with the friction of Gazebo's "
        "Jackal. Default: the robot's own.")
    workers: command_line.Workers = option(2,
        "Number of trials that are driven at the same time, in processes or Ray actors; 0 drives them in this process.")
    ray_address: command_line.RayAddress
    out: str = option("results",
        "Folder for trials.csv, tables and figures. An existing evaluation in it is continued.")
    seed: command_line.Seed
    traces: int = option(1,
        "Number of trials of each method in each world whose driven path is stored.", ge=0, le=1000)
    report: bool = option(True, "Write tables and figures of the trials.")
    runner: str = option(TRIAL_RUNNER, "")  # tests give a toy
    # fmt: on


def evaluate(
    options: EvaluationOptions, blocks: Optional[Callable[[TrialStore], Iterable[Sequence[Trial]]]] = None
) -> TrialStore:
    """Drives trials that the folder options.out does not hold, and returns it, closed.

    Args:
        options: what to drive, and how.
        blocks: of trials of the store's plan, each asked for when the last one is done; None: one, the whole plan.

    Raises:
        ApplrError: with one line; what was driven so far is kept.
    """
    began = time.monotonic()
    worlds = world_list(options.worlds, options.protocol, options.robot)
    chosen = methods.parse(options.methods, options.robot)
    names = [world[:2] for world in worlds]
    plan = plan_trials(names, chosen, options.trials, options.seed, options.traces, options.planner)
    if options.ground:
        on_ground(options.robot, options.ground)  # refused here, not by every worker
    driven_with = {name: getattr(options, name) for name in ("simulator", "protocol", "monitor", "movers", "ground")}
    runner = partial(resolve_name(options.runner), TrialSettings(robot=options.robot.folder, **driven_with))

    def show(trial: Trial, result: TrialResult) -> None:
        bar.update()
        how = f"{result.time_s:.1f} s" if result.success else result.reason
        bar.set_postfix_str(f"{trial.world} {trial.method} {how}", refresh=False)

    with closing(TrialStore(options.out, settings(options, worlds, chosen), plan)) as store:
        missing = len(plan) - len(store.results)
        workers, total = min(options.workers, missing), None if blocks else len(plan)
        bar = tqdm(total=total, initial=len(store.results), unit="trial", dynamic_ncols=True, smoothing=0.05)
        with bar, make_pool(workers, options.ray_address) as pool:
            try:
                for block in (blocks(store) if blocks else [plan]) if missing else []:
                    drive_missing(pool, runner, block, store, show)
            finally:
                if missing:
                    seconds = time.monotonic() - began
                    store.finish(seconds, provenance(options.seed), workers=workers, trials=options.trials)
        return store


def settings(
    options: EvaluationOptions, worlds: Sequence[Tuple[str, str, World]], chosen: Sequence[Tuple[str, str]]
) -> Dict[str, Any]:
    """What must not change when an evaluation is continued: goes into evaluation.json."""
    digest = hashlib.sha256()
    for name, _, world in worlds:
        for part in (world.cylinders, world.boxes, world.course.path):
            digest.update(part.tobytes())
        digest.update(repr((name, world.course.start, world.course.goal, world.movers)).encode())
    made = {name: methods.make(spec, options.robot) for name, spec in chosen}
    return {
        "worlds": [name for name, _, _ in worlds],
        "worlds_with_movers": [name for name, _, world in worlds if world.movers],
        "worlds_sha256": digest.hexdigest(),
        "world_specs": [spec for _, spec, _ in worlds],
        "methods": {name: {**method.describe(), "period_s": method.period} for name, method in made.items()},
        "robot": described(options.robot),
        **{name: getattr(options, name) for name in ("simulator", "protocol", "planner", "monitor", "movers")},
        "ground": options.ground or options.robot.simulation.ground,
        "seed": options.seed,
    }
